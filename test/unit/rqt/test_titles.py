# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Titles of boxes: large enough to be read, and not so large that they cover nodelets."""

from __future__ import annotations

import pytest
from python_qt_binding.QtCore import QRectF
from python_qt_binding.QtGui import QColor, QFont, QFontMetricsF, QImage, QPainter, QPalette

from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.canvas.overview import FAR, paint_titles
from dyknow_rqt.graph.geometry import Point, Size, boxes_around

_FONT = QFont("DejaVu Sans", 9)
_NODELET = Size(80.0, 30.0)


def painted_rows(zoom):
    """Rows of pixels that the title of a box takes, and how many are above its nodelet."""
    group = ("/nao1",)
    box = boxes_around({"a": group}, {"a": Point(0.0, 0.0)}, {"a": _NODELET})[group]
    image = QImage(400, 400, QImage.Format_RGB32)
    white = QColor("white")
    image.fill(white)
    painter = QPainter(image)
    painter.scale(zoom, zoom)
    painter.translate(-box.left, -box.top)
    owner = QRectF(box.left, box.top, box.right - box.left, box.bottom - box.top)
    paint_titles(painter, [(owner, "/nao1")], _FONT, colours_of(QPalette()))
    painter.end()
    rows = [
        y for y in range(400) if any(image.pixelColor(x, y) != white for x in range(0, 400, 2))
    ]
    return rows, (-_NODELET.height / 2 - box.top) * zoom


@pytest.mark.parametrize("zoom", [0.55, 0.7, 0.85, 1.0, 2.0])
def test_beside_names_that_can_be_read_they_cover_no_nodelet(qapp, zoom):
    rows, room = painted_rows(zoom)
    assert rows and max(rows) < room


@pytest.mark.parametrize("zoom", [0.05, 0.1, 0.9 * FAR])
def test_from_far_away_they_are_as_large_as_texts_elsewhere(qapp, zoom):
    rows, _ = painted_rows(zoom)
    assert len(rows) >= QFontMetricsF(_FONT).height() - 1
