# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The files of the graph: wirings that are saved and loaded, and pictures."""

from __future__ import annotations

from functools import partial
from typing import List, Tuple

from python_qt_binding.QtWidgets import QFileDialog, QWidget

from dyknow.model.client import BaseManagerClient
from dyknow.model.hosts import pins
from dyknow.wiring.wiring import read_wiring, wiring_of
from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.canvas.pictures import save
from dyknow_rqt.canvas.scene import GraphScene
from dyknow_rqt.graph.changes import load_wiring
from dyknow_rqt.graph_bar import GraphBar
from dyknow_rqt.monitor import GraphMonitor

_KINDS = ("DOT (*.dot)", "SVG (*.svg)", "PNG (*.png)")
_FILES = "Wirings (*.xml);;All files (*)"


class GraphFiles:
    """Saves the wiring and the drawing, and loads a wiring."""

    def __init__(
        self, monitor: GraphMonitor, scene: GraphScene, bar: GraphBar, window: QWidget
    ) -> None:
        self._monitor, self._scene, self._window = monitor, scene, window
        self.report = monitor.report
        bar.load.triggered.connect(self.ask_what_to_load)
        bar.save_menu.addAction("&Wiring …").triggered.connect(self.ask_where_to_save)
        bar.save_menu.addSeparator()
        for kind in _KINDS:
            ask = partial(self.ask_where_to_draw, kind)
            bar.save_menu.addAction(f"&{kind.split()[0]} …").triggered.connect(ask)

    def save(self, path: str) -> None:
        """Write the nodelets, their connections and their transformations to a file."""

        def write(client: BaseManagerClient) -> Tuple[int, List[str]]:
            wiring, left_out = wiring_of(client.get_model(), pins(client.list_hosts()))
            with open(path, "w", encoding="utf-8") as file:
                file.write(wiring.to_xml())
            return len(wiring.nodelets), [each.name for each in left_out]

        def say(written: Tuple[int, List[str]]) -> None:
            count, left_out = written
            text = f"{count} nodelet{'' if count == 1 else 's'} saved in {path}"
            if left_out:
                text += f"; without {', '.join(left_out)}, which others have loaded"
            self._monitor.done.emit(text)

        self._monitor.ask(write, say)

    def load(self, path: str) -> None:
        """Load the wiring of a file; nodelets that it does not name are left alone.

        Raises:
            OSError: the file cannot be read.
            SpecificationError: it is not a wiring; with all problems.
        """
        with open(path, "rb") as file:
            wiring = read_wiring(file.read(), path.rpartition("/")[2])
        self._monitor.do(load_wiring(wiring, path.rpartition("/")[2]))

    @qt_slot
    def ask_where_to_save(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self._window, "Save the wiring", "wiring.xml", _FILES
        )
        if path:
            self.save(path)

    @qt_slot
    def ask_what_to_load(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self._window, "Load a wiring", "", _FILES)
        if path:
            self.load(path)

    @qt_slot
    def ask_where_to_draw(self, kind: str) -> None:
        suffix = kind.rpartition(".")[2].rstrip(")")
        dialog = QFileDialog(self._window, "Save the graph", "", kind)
        dialog.setAcceptMode(QFileDialog.AcceptSave)
        dialog.setDefaultSuffix(suffix)  # set before it asks whether to overwrite a file
        dialog.selectFile(f"dyknow.{suffix}")
        dialog.finished.connect(dialog.deleteLater)
        if dialog.exec_():
            save(self._scene, dialog.selectedFiles()[0])
