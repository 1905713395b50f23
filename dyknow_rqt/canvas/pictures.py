# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Writes the drawing to files."""

from __future__ import annotations

from python_qt_binding.QtCore import QRectF
from python_qt_binding.QtGui import QImage, QPainter
from python_qt_binding.QtSvg import QSvgGenerator

from dyknow_rqt.canvas.appearance import sizes_of
from dyknow_rqt.canvas.scene import GraphScene
from dyknow_rqt.graph.layout import to_dot

#: Pixels around the drawing, and those of the largest image, which is else twice the drawing.
_FRAME, _MOST_PIXELS = 16.0, 16_000_000.0
_SCALE = 2.0
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp")


def save(scene: GraphScene, path: str) -> None:
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
