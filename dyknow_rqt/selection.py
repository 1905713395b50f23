# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The selection of the window: one thing for graph, tables, menus and keys."""

from __future__ import annotations

from typing import Iterable, Union

from python_qt_binding.QtCore import QObject, Signal

from dyknow_rqt.graph.figure import Edge, Figure, VertexKind, key_of
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.monitoring.monitor import GraphMonitor

#: The key of a vertex, or an arrow.
Key = Union[str, Edge]


class Selection(QObject):
    """Selected vertices and arrows, by their keys, and claims.

    With a claim its nodelets are selected, after each repair those that it has then. Nodelets that
    are not drawn, but are in a table, stay selected; all else has to be seen. There are no claims
    if something else than rows of streams was selected last.
    """

    #: Something else is selected now.
    changed = Signal()

    def __init__(self, monitor: GraphMonitor) -> None:
        super().__init__()
        self._monitor = monitor
        self.keys: frozenset[Key] = frozenset()
        self.claims: frozenset[str] = frozenset()
        monitor.changed.connect(self._follow_graph)
        monitor.streams_changed.connect(self._follow_streams)

    @property
    def nodelets(self) -> list[str]:
        return self.names(VertexKind.NODELET)

    def names(self, kind: VertexKind) -> list[str]:
        """Names of the selected vertices of a kind, sorted."""
        start = key_of(kind, "")
        texts = (key for key in self.keys if not isinstance(key, Edge))
        return sorted(key[len(start) :] for key in texts if key.startswith(start))

    @property
    def edges(self) -> list[Edge]:
        return sorted(key for key in self.keys if isinstance(key, Edge))

    def choose(self, keys: Iterable[Key], claims: Iterable[str] = ()) -> None:
        chosen = frozenset(keys), frozenset(claims)
        if chosen != (self.keys, self.claims):
            self.keys, self.claims = chosen
            self.changed.emit()

    def choose_nodelets(self, names: Iterable[str]) -> None:
        self.choose(key_of(VertexKind.NODELET, name) for name in names)

    def choose_claims(self, claims: Iterable[str]) -> None:
        """Select claims with their nodelets, and nothing else."""
        streams = [stream for stream in map(self._monitor.stream, claims) if stream is not None]
        self.choose(
            (key_of(VertexKind.NODELET, name) for each in streams for name in each.nodelets),
            (each.claim_id for each in streams),
        )

    def keep_drawn(self, figure: Figure) -> None:
        """Forget arrows, topics and ordinary nodes that are drawn no longer."""
        nodelet = key_of(VertexKind.NODELET, "")
        drawn = {*figure.edges, *(vertex.key for vertex in figure.vertices)}
        self.choose(
            (k for k in self.keys if k in drawn or str(k).startswith(nodelet)), self.claims
        )

    def _follow_graph(self, snapshot: Snapshot) -> None:
        if not self.claims:
            gone = {
                key_of(VertexKind.NODELET, name)
                for name in self.nodelets
                if snapshot.nodelet(name) is None
            }
            self.choose(self.keys - gone)

    def _follow_streams(self) -> None:
        if self.claims:
            self.choose_claims(self.claims)
