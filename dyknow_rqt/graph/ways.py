# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ways to make a stream: as planned, the next best ones, and as it is made now.

A plan is drawn over the graph: the parts that it would bring, keep and drop.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from typing import Callable, Iterable, Iterator, Mapping, NamedTuple, Sequence, Tuple

from dyknow.errors import Refused
from dyknow.manager.planning.explanation import Entry, read_tree
from dyknow.model.graph import NodeletStatus, PortRef, State
from dyknow.model.streams import Acquisition, Replanned, StreamStatus
from dyknow.model.transformation import IN
from dyknow_rqt.graph.figure import Edge, Figure, Vertex, VertexKind, key_of
from dyknow_rqt.graph.snapshot import Snapshot

_TITLE = re.compile(r"(?P<what>.*): cost (?P<cost>\S+) \((?P<how>.*?)\)(?P<more>.*)\Z")
_NEW = ("new", "at no cost")
#: Transformations of a plan without which is planned, to find the next best one.
_TRIED = 6


class WayPart(NamedTuple):
    """A line of a way: a supplier, below the one that it supplies; at depth 0 the whole way.

    ``port`` is the in-port that it supplies, empty at the whole and the last supplier; ``what`` a
    transformation with its out-port, or a topic; ``how`` such as ``new`` or ``runs as /tracker``.
    """

    depth: int
    port: str
    what: str
    how: str = ""
    cost: str = ""
    bindings: str = ""

    @property
    def nodelet(self) -> str:
        """Name of the nodelet that runs; empty for none."""
        return self.how.partition(" as ")[2]

    @property
    def label(self) -> str:
        """Label of the transformation; empty for a topic, and for a line of another text."""
        return "" if self.how in ("", "topic") else self.what.rpartition(".")[0]

    @property
    def is_new(self) -> bool:
        return self.how in _NEW

    @property
    def cells(self) -> tuple[str, str, str, str]:
        what = f"{self.port} ← {self.what}" if self.port else self.what
        return what, self.cost, self.how, self.bindings


Way = Tuple[WayPart, ...]


def read_way(text: str) -> Way:
    """Read a plan; of another text, such as a refusal, each line is a part."""
    try:
        title, entries = read_tree(text)
    except ValueError:
        title, *lines = text.strip().split("\n")
        return (WayPart(0, "", title), *(WayPart(1, "", line.lstrip("├└─│ ")) for line in lines))
    found = _TITLE.match(title)
    whole = WayPart(0, "", title)
    if found is not None:
        whole = WayPart(0, "", found["what"], found["how"] + found["more"], found["cost"])
    return (whole, *map(_part_of, entries))


def next_ways(plan: Callable[[str], Acquisition | Replanned], way: Way) -> list[Way]:
    """Plan without each transformation of a way: the ways that differ, the cheapest first.

    ``plan`` plans without a label, or raises Refused.
    """
    labels = dict.fromkeys(part.label for part in way[1:] if part.label)
    found: dict[str, tuple[float, str]] = {}
    for label in list(labels)[:_TRIED]:
        with suppress(Refused):
            answer = plan(label)
            found.setdefault(answer.plan, (answer.cost, f"without {label}"))
    ways = [(read_way(plan), how) for plan, (_, how) in sorted(found.items(), key=lambda e: e[1])]
    return [(way[0]._replace(what=how), *way[1:]) for way, how in ways]


def dropped_by(way: Way, found: Replanned, stream: StreamStatus, snapshot: Snapshot) -> Way:
    """The nodelets that a stream uses no longer when it is made in another way; empty for none.

    Nodelets at the way's ends stay connected as they are, so that those behind them stay too.
    """
    kept, running = set(found.reused), _Running(stream, snapshot)
    for part, following in zip(way, (*way[1:], way[0])):
        nodelet = snapshot.nodelet(part.nodelet)
        if nodelet is not None and following.depth <= part.depth:
            kept.update(each.nodelet for each in running.inputs(nodelet, 1))
    names = sorted(set(stream.nodelets) - kept)
    parts = tuple(WayPart(1, "", name, f"dropped as {name}") for name in names)
    return (WayPart(0, "", "Used no longer"), *parts) if parts else ()


def present_way(stream: StreamStatus, snapshot: Snapshot) -> Way:
    """The nodelets of a claim behind each other, from its topic to its sources."""
    words = [f"on {stream.topic}" if stream.topic else "", stream.state.name.lower()]
    state = ", ".join(filter(None, words)) + (f": {stream.detail}" if stream.detail else "")
    whole = WayPart(0, "", stream.tag, state, bindings=" ".join(stream.bindings))
    return (whole, *_Running(stream, snapshot).sources(stream.topic, "", 1))


class _Running:
    """The nodelets of a claim: those behind a topic or a nodelet, each topic followed once."""

    def __init__(self, stream: StreamStatus, snapshot: Snapshot) -> None:
        self._members, self._snapshot = stream.nodelets, snapshot

    def sources(
        self, topic: str, port: str, depth: int, seen: frozenset[str] = frozenset()
    ) -> Iterator[WayPart]:
        """Those that publish a topic, which feeds a port, with all behind them."""
        found = self._snapshot.topics().get(topic)
        for ref in found.sources if found is not None else ():
            nodelet = self._snapshot.nodelet(ref.nodelet)
            if nodelet is None or ref.nodelet not in self._members:
                continue
            verb = "runs" if nodelet.state is State.RUNNING else nodelet.state.name.lower()
            given = (f"{each.name}={each.text}" for each in nodelet.parameters)
            what, how = f"{nodelet.transformation}.{ref.port}", f"{verb} as {ref.nodelet}"
            bindings = " ".join(each for each in given if each.startswith("?"))
            yield WayPart(depth, port, what, how, bindings=bindings)
            yield from self.inputs(nodelet, depth + 1, seen | {topic})

    def inputs(
        self, nodelet: NodeletStatus, depth: int, seen: frozenset[str] = frozenset()
    ) -> Iterator[WayPart]:
        for each in nodelet.ports:
            if each.direction == IN and each.topic and each.topic not in seen:
                yield from self.sources(each.topic, each.name, depth, seen | {each.topic})


def _part_of(entry: Entry) -> WayPart:
    what, bindings = entry.parts
    how, *costs = (word for word in entry.how.split(", ") if word)
    cost = " + ".join(word.partition(" ")[2] for word in costs if word[:4] in ("cost", "char"))
    rest = [word for word in costs if word[:4] not in ("cost", "char")]
    return WayPart(entry.depth + 1, entry.port, what, ", ".join([how, *rest]), cost, bindings)


def fates_of(parts: Iterable[WayPart]) -> Mapping[str, bool]:
    """Keys of the nodelets that a plan uses on (True), or drops."""
    return {
        key_of(VertexKind.NODELET, part.nodelet): not part.how.startswith("dropped")
        for part in parts
        if part.nodelet
    }


def with_ghosts(figure: Figure, snapshot: Snapshot, parts: Sequence[WayPart]) -> Figure:
    """Add the nodelets that a plan would bring, with arrows from their sources."""
    drawn = {vertex.key for vertex in figure.vertices}
    ghosts: dict[str, Vertex] = {}
    edges: set[Edge] = set()
    above: list[str] = []
    for part in parts:
        key = _key_of_part(part, snapshot, drawn)
        if part.is_new:
            note = "\n".join(filter(None, (part.bindings, f"cost {part.cost or 0}")))
            ghosts[key] = Vertex(key, VertexKind.GHOST, part.label, note=note)
        del above[part.depth :]
        if part.port and {key, above[-1]} <= drawn | set(ghosts):
            edges.add(Edge(key, "", above[-1], "", part.port))
        above.append(key)
    vertices = sorted([*figure.vertices, *ghosts.values()], key=lambda vertex: vertex.key)
    return replace(figure, vertices=tuple(vertices), edges=tuple(sorted({*figure.edges, *edges})))


def _key_of_part(part: WayPart, snapshot: Snapshot, drawn: set[str]) -> str:
    """The vertex of a part: of one that runs its topic, if it is drawn."""
    topic = part.what
    if part.nodelet:
        port = snapshot.port(PortRef(part.nodelet, part.what.rpartition(".")[2]))
        topic = port.topic if port is not None else ""
    elif part.label:
        return key_of(VertexKind.GHOST, f"{part.label} {part.bindings}".strip())
    key = key_of(VertexKind.TOPIC, topic)
    return key if key in drawn else key_of(VertexKind.NODELET, part.nodelet)
