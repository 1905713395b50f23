# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Wirings in files, in the format of ``dyknow save`` and ``dyknow load``."""

from __future__ import annotations

from typing import List, Tuple

from python_qt_binding.QtWidgets import QFileDialog, QWidget

from dyknow.model.client import BaseManagerClient
from dyknow.wiring.reader import read_wiring
from dyknow.wiring.wiring import wiring_of
from dyknow_rqt.graph.wiring_changes import LoadWiring
from dyknow_rqt.monitor import Monitor
from dyknow_rqt.qt_slot import qt_slot

_FILES = "Wirings (*.xml);;All files (*)"


class WiringFiles:
    """Saves the wiring and loads it."""

    def __init__(self, monitor: Monitor, window: QWidget) -> None:
        self._monitor, self._window = monitor, window
        self.report = monitor.report

    def save(self, path: str) -> None:
        """Write the nodelets, their connections and their transformations to a file."""

        def write(client: BaseManagerClient) -> Tuple[int, List[str]]:
            wiring, left_out = wiring_of(client.get_model())
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
            SpecificationError: it is no wiring; with all problems.
        """
        with open(path, "rb") as file:
            wiring = read_wiring(file.read(), path.rpartition("/")[2])
        self._monitor.do(LoadWiring(wiring, path.rpartition("/")[2]))

    @qt_slot
    def ask_where_to_save(self) -> None:
        """Ask for a file, then save."""
        path, _ = QFileDialog.getSaveFileName(
            self._window, "Save the wiring", "wiring.xml", _FILES
        )
        if path:
            self.save(path)

    @qt_slot
    def ask_what_to_load(self) -> None:
        """Ask for a file, then load."""
        path, _ = QFileDialog.getOpenFileName(self._window, "Load a wiring", "", _FILES)
        if path:
            self.load(path)
