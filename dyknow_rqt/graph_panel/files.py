# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The files of the graph: wirings that are saved and loaded, and pictures."""

from __future__ import annotations

from functools import partial

from python_qt_binding.QtCore import QRectF
from python_qt_binding.QtGui import QImage, QPainter
from python_qt_binding.QtSvg import QSvgGenerator
from python_qt_binding.QtWidgets import QFileDialog, QWidget

from dyknow.model.client import BaseManagerClient
from dyknow.model.hosts import pins
from dyknow.wiring.wiring import read_wiring, wiring_of
from dyknow_rqt.canvas.appearance import sizes_of
from dyknow_rqt.canvas.scene import GraphScene
from dyknow_rqt.graph.changes import load_wiring
from dyknow_rqt.graph.layout import to_dot
from dyknow_rqt.graph_panel.bar import GraphBar
from dyknow_rqt.monitoring.monitor import GraphMonitor

_KINDS = ("DOT (*.dot)", "SVG (*.svg)", "PNG (*.png)")
_FILES = "Wirings (*.xml);;All files (*)"
#: Pixels around the drawing, and those of the largest image, which is else twice the drawing.
_FRAME, _MOST_PIXELS = 16.0, 16_000_000.0
_SCALE = 2.0
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp")


class GraphFiles:
    """Saves the wiring and the drawing, and loads a wiring."""

    def __init__(
        self, monitor: GraphMonitor, scene: GraphScene, bar: GraphBar, window: QWidget
    ) -> None:
        self._monitor, self._scene, self._window = monitor, scene, window
        bar.load.triggered.connect(self.ask_what_to_load)
        bar.save_menu.addAction("&Wiring …").triggered.connect(self.ask_where_to_save)
        bar.save_menu.addSeparator()
        for kind in _KINDS:
            ask = partial(self.ask_where_to_draw, kind)
            bar.save_menu.addAction(f"&{kind.split()[0]} …").triggered.connect(ask)

    def save(self, path: str) -> None:
        """Write the nodelets, their connections and their transformations to a file."""

        def write(client: BaseManagerClient) -> tuple[int, list[str]]:
            wiring, left_out = wiring_of(client.get_model(), pins(client.list_hosts()))
            with open(path, "w", encoding="utf-8") as file:
                file.write(wiring.to_xml())
            return len(wiring.nodelets), [each.name for each in left_out]

        def say(written: tuple[int, list[str]]) -> None:
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

    def ask_where_to_save(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self._window, "Save the wiring", "wiring.xml", _FILES
        )
        if path:
            self.save(path)

    def ask_what_to_load(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self._window, "Load a wiring", "", _FILES)
        if path:
            self.load(path)

    def ask_where_to_draw(self, kind: str) -> None:
        suffix = kind.rpartition(".")[2].rstrip(")")
        dialog = QFileDialog(self._window, "Save the graph", "", kind)
        dialog.setAcceptMode(QFileDialog.AcceptSave)
        dialog.setDefaultSuffix(suffix)  # set before it asks whether to overwrite a file
        dialog.selectFile(f"dyknow.{suffix}")
        dialog.finished.connect(dialog.deleteLater)
        if dialog.exec_():
            save_drawing(self._scene, dialog.selectedFiles()[0])


def save_drawing(scene: GraphScene, path: str) -> None:
    """Write the drawing in the format of the file's extension, DOT by default; raises OSError."""
    name = path.lower()
    if name.endswith(".svg"):
        _save_svg(scene, path)
    elif name.endswith(_IMAGES):
        _save_image(scene, path)
    else:
        with open(path, "w", encoding="utf-8") as file:
            file.write(to_dot(scene.figure, sizes_of(scene.figure, scene.typeface)))


def _save_svg(scene: GraphScene, path: str) -> None:
    area = _area(scene)
    with open(path, "wb"):
        pass  # the generator ignores files that it cannot write
    generator = QSvgGenerator()
    generator.setFileName(path)
    generator.setSize(area.size().toSize())
    generator.setViewBox(QRectF(0, 0, area.width(), area.height()))
    generator.setTitle("DyKnow computation graph")
    _render(scene, generator, area)


def _save_image(scene: GraphScene, path: str) -> None:
    area = _area(scene)
    scale = min(_SCALE, (_MOST_PIXELS / (area.width() * area.height())) ** 0.5)
    image = QImage((area.size() * scale).toSize(), QImage.Format_ARGB32)
    image.fill(scene.colours.paper)
    _render(scene, image, area)
    if not image.save(path):
        raise OSError(f"cannot write an image to '{path}'")


def _area(scene: GraphScene) -> QRectF:
    return scene.drawing_area().adjusted(-_FRAME, -_FRAME, _FRAME, _FRAME)


def _render(scene: GraphScene, device: object, area: QRectF) -> None:
    zoom = scene.zoom
    scene.set_zoom(1.0)
    scene.labels.place_now()
    painter = QPainter(device)
    painter.setRenderHint(QPainter.Antialiasing)
    scene.render(painter, QRectF(), area)
    painter.end()
    scene.set_zoom(zoom)
