# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Places the labels of arrows, in a thread."""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable, Mapping

from python_qt_binding.QtCore import QObject, QTimer

from dyknow_rqt.background_calls import BackgroundCalls, qt_slot
from dyknow_rqt.graph.figure import Edge
from dyknow_rqt.graph.geometry import Rectangle, place_labels

if TYPE_CHECKING:
    from dyknow_rqt.canvas.scene import GraphScene


class ArrowLabels(QObject):
    """Places labels where they cover nothing, once they are large enough to be read."""

    def __init__(self, scene: GraphScene) -> None:
        super().__init__(scene)
        self._scene = scene
        self.report = scene.report
        self._calls = BackgroundCalls(1)
        #: Whether some are to be placed again, when they can be read.
        self.are_wanted = False
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self._place)

    def close(self) -> None:
        self._soon.stop()
        self._calls.close()

    @property
    def are_placed(self) -> bool:
        """Whether all that can be read are where they belong."""
        return not (self._calls.is_calling or self._soon.isActive())

    def place(self) -> None:
        """Place all labels again, soon."""
        self._soon.start()

    def place_now(self) -> None:
        self._take(self._search()())

    @qt_slot
    def _place(self) -> None:
        self.are_wanted = self._scene.is_far
        if not self.are_wanted:
            self._calls.run_once("labels", self._search(), self._take, again=True)

    def _search(self) -> Callable[[], Mapping[Edge, Rectangle]]:
        """Return a function that finds places for the labels, in any thread."""
        edges, boxes = self._scene.edges, self._scene.boxes.values()
        areas = [area for item in self._scene.vertices.values() for area in item.inked]
        areas += [box.title_area for box in boxes]
        curves = {edge: item.curve for edge, item in edges.items()}
        sizes = {edge: item.label_sizes for edge, item in edges.items()}
        obstacles = [Rectangle(*area.getCoords()) for area in areas]
        obstacles += [side for box in boxes for side in Rectangle(*box.area.getCoords()).sides]
        return lambda: place_labels(curves, sizes, obstacles)

    def _take(self, places: Mapping[Edge, Rectangle]) -> None:
        for edge, item in self._scene.edges.items():
            item.place_label(places.get(edge))
        self._scene.measure()
