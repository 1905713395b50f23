# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Icons of the desktop's theme; where it has none, they are drawn in the colour of the text."""

from __future__ import annotations

from python_qt_binding.QtCore import QByteArray, Qt
from python_qt_binding.QtGui import QIcon, QPainter, QPalette, QPixmap
from python_qt_binding.QtSvg import QSvgRenderer

#: Pixels of a drawn icon; smaller ones are made from it.
_SIZE = 96
_SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 24"><path d="{}" fill="none" '
    'stroke="{}" stroke-width="1.8" stroke-linecap="round" stroke-linejoin="round"/></svg>'
)
#: Lines in a square of 24, by the names of freedesktop.org or of common themes.
_LINES = {
    "configure": "M4 7H12M18 7H20M4 17H6M12 17H20M15 4V10M9 14V20",
    "distribute-graph-directed": "M3 9H9V15H3ZM15 3H21V9H15ZM15 15H21V21H15ZM9 11L15 6M9 13L15 18",
    "document-open": "M3 19V5H9L11 8H19V11M3 19L6 11H22L19 19Z",
    "document-save": "M12 3V14M7 9.5L12 14.5L17 9.5M4 15V20H20V15",
    "edit-redo": "M16 4L21 9L16 14M21 9H10C2 9 2 20 10 20H13",
    "edit-undo": "M8 4L3 9L8 14M3 9H14C22 9 22 20 14 20H11",
    "go-next": "M8 5L15 12L8 19",
    "view-filter": "M3 4H21L14 13V20L10 17V13Z",
    "view-history": "M12 3C24 3 24 21 12 21C0 21 0 3 12 3M12 8V12L15.5 14",
    "view-refresh": "M20 4V9H15M20 9C17 2 4 3 4 12C4 21 17 22 20 15",
    "view-sidetree": "M3 4H21V20H3ZM9 4V20M5 8H7M5 12H7",
    "zoom-fit-best": "M3 8V3H8M16 3H21V8M21 16V21H16M8 21H3V16M8 8H16V16H8Z",
}


def icon_of(name: str, palette: QPalette) -> QIcon:
    """The icon of a name; one that is drawn has the colour of the palette's text."""
    drawn = QPixmap(_SIZE, _SIZE)
    drawn.fill(Qt.transparent)
    colour = palette.color(QPalette.Active, QPalette.ButtonText).name()
    painter = QPainter(drawn)
    QSvgRenderer(QByteArray(_SVG.format(_LINES[name], colour).encode())).render(painter)
    painter.end()
    return QIcon.fromTheme(name, QIcon(drawn))
