# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Figures: the vertices, edges and boxes to draw, as values that know no coordinates."""

from __future__ import annotations

import enum
import os
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import AbstractSet, Iterable, Iterator, Mapping, NamedTuple, Sequence, Tuple

from dyknow.model.graph import NodeletStatus, PortRef
from dyknow.model.transformation import IN
from dyknow.wiring.ports import Topic
from dyknow_rqt.graph.filters import Filter, with_namespaces
from dyknow_rqt.graph.snapshot import Snapshot

#: Names that are in every graph and seldom of interest.
_QUIET = Filter(
    (
        lambda name: name
        in ("/clock", "/diagnostics", "/diagnostics_agg", "/rosout", "/rosout_agg", "/statistics"),
        lambda name: name.startswith(
            ("/rqt", "/dyknow_rqt", "/rviz", "/rosapi", "/rosbag", "/record_", "/rostopic_")
        ),
        lambda name: name.endswith(("/parameter_updates", "/parameter_descriptions", "/bond")),
    )
)

#: The most characters in a line of a label.
_LONG = 15


class VertexKind(enum.Enum):
    """The kind of a vertex; its value begins the vertex's key."""

    NODELET = "n"
    TOPIC = "t"
    NODE = "p"
    BOX = "b"
    CLAIM = "c"
    GHOST = "g"

    @property
    def is_square(self) -> bool:
        return self in (VertexKind.TOPIC, VertexKind.BOX, VertexKind.CLAIM)


class Boxes(enum.Enum):
    """The grouping of boxes; the values are shown to the user."""

    NAMESPACES = "namespaces"
    MANAGERS = "nodelet managers"
    HOSTS = "hosts"


#: Titles of a box and of those around it, the outermost first.
Group = Tuple[str, ...]


@dataclass(frozen=True)
class Vertex:
    """An oval or a rectangle in the innermost of a group of boxes, with a note below its name.

    The key is unique in the figure, and the same for the same thing in every figure. Ports are in
    the order of declaration. Members are keys of the nodelets in a collapsed box.
    """

    key: str
    kind: VertexKind
    name: str
    group: Group = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    note: str = ""
    members: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The name as it is drawn: without the namespace of its box; a long one in two lines."""
        space = f"{self.group[-1]}/" if self.group else ""
        return _label(self.name[len(space) :] if self.name.startswith(space) else self.name)

    @property
    def label(self) -> str:
        return self.title + (f"\n{self.note}" if self.note else "")


@lru_cache(maxsize=20_000)
def _label(text: str) -> str:
    for mark in "/_":
        breaks = [place for place, letter in enumerate(text) if letter == mark and place]
        if breaks:
            break
    if len(text) <= _LONG or not breaks:
        return text
    place = min(breaks, key=lambda place: abs(place + 1 - len(text) / 2))
    return f"{text[: place + 1]}\n{text[place + 1 :]}"


class Edge(NamedTuple):
    """An arrow. Ports are empty at topics and at ordinary nodes."""

    tail: str
    tail_port: str
    head: str
    head_port: str
    topic: str


@dataclass(frozen=True)
class Options:
    """The options of the view.

    Without ``topics`` arrows lead from nodelet to nodelet. Dead sinks are topics without a
    receiver, leaf topics those with one end only; ``nodes`` are ordinary ones. The depth says how
    many parts of a namespace make boxes, or of a host and a nodelet manager; of collapsed boxes
    each is one vertex.
    """

    topics: bool = True
    nodelet_filter: Filter = field(default_factory=Filter)
    topic_filter: Filter = field(default_factory=Filter)
    hide_dead_sinks: bool = False
    hide_leaf_topics: bool = False
    hide_debug: bool = True
    show_nodes: bool = False
    boxes: Boxes = Boxes.NAMESPACES
    depth: int = 2
    collapsed: frozenset[Group] = frozenset()
    is_downwards: bool = False


@dataclass(frozen=True)
class Figure:
    """The things to draw; vertices and edges are sorted, so that equal figures look the same."""

    vertices: tuple[Vertex, ...] = ()
    edges: tuple[Edge, ...] = ()
    is_downwards: bool = False

    def groups(self) -> list[Group]:
        """Boxes, outer ones before those in them."""
        found = {v.group[:size] for v in self.vertices for size in range(1, len(v.group) + 1)}
        return sorted(found)

    def neighbours(self) -> dict[str, set[str]]:
        """Keys of the vertices that each vertex has an arrow to or from."""
        found: dict[str, set[str]] = {vertex.key: set() for vertex in self.vertices}
        for edge in self.edges:
            found[edge.tail].add(edge.head)
            found[edge.head].add(edge.tail)
        return found


def key_of(kind: VertexKind, name: str) -> str:
    return f"{kind.value}_{name}"


def edge_refs(edge: Edge) -> list[PortRef]:
    """The ports at the ends of an arrow, the in-port first."""
    nodelet = VertexKind.NODELET.value + "_"
    ends = ((edge.head, edge.head_port), (edge.tail, edge.tail_port))
    return [PortRef(key[len(nodelet) :], port) for key, port in ends if key.startswith(nodelet)]


def unboxed_figure_of(snapshot: Snapshot, options: Options) -> Figure:
    """Make the figure of a snapshot, all but its boxes."""
    ends = _Ends(snapshot, options)
    vertices: list[Vertex] = []
    for name, nodelet in ends.nodelets.items():
        inputs = tuple(port.name for port in nodelet.ports if port.direction == IN)
        outputs = tuple(port.name for port in nodelet.ports if port.direction != IN)
        key = key_of(VertexKind.NODELET, name)
        vertices.append(Vertex(key, VertexKind.NODELET, name, (), inputs, outputs))
    edges: list[Edge] = []
    for name, topic in snapshot.topics().items():
        if not (_wanted(name, options.topic_filter, options) and ends.shown(topic)):
            continue
        if options.topics:
            vertices.append(Vertex(key_of(VertexKind.TOPIC, name), VertexKind.TOPIC, name))
            edges += ends.through(topic)
        else:
            edges += ends.past(topic)
    used = {key for edge in edges for key in (edge.tail, edge.head)}
    for node in ends.nodes:
        key = key_of(VertexKind.NODE, node.name)
        if key in used:
            vertices.append(Vertex(key, VertexKind.NODE, node.name))
    vertices.sort(key=lambda v: v.key)
    return Figure(tuple(vertices), tuple(sorted(edges)), options.is_downwards)


def _wanted(name: str, chosen: Filter, options: Options) -> bool:
    return chosen(name) and not (options.hide_debug and _QUIET(name))


class _Ends:
    """The ends of topics, among the vertices that are shown."""

    def __init__(self, snapshot: Snapshot, options: Options) -> None:
        wanted = options.nodelet_filter
        self._snapshot, self._options = snapshot, options
        self.nodelets = {n.name: n for n in snapshot.nodelets if _wanted(n.name, wanted, options)}
        nodes = snapshot.nodes if options.show_nodes else ()
        self.nodes = [n for n in nodes if _wanted(n.name, wanted, options)]

    def shown(self, topic: Topic) -> bool:
        """Whether the topic has a nodelet, and as many ends as the options ask for."""
        if not any(ref.nodelet in self.nodelets for ref in topic.sources + topic.targets):
            return False
        nodes = self._snapshot.nodes
        readers = len(topic.targets) + sum(topic.name in node.subscribes for node in nodes)
        writers = len(topic.sources) + sum(topic.name in node.publishes for node in nodes)
        if self._options.hide_dead_sinks and readers == 0:
            return False
        return not (self._options.hide_leaf_topics and readers + writers < 2)

    def through(self, topic: Topic) -> Iterator[Edge]:
        """Arrows to and from the rectangle of a topic."""
        middle = key_of(VertexKind.TOPIC, topic.name)
        for key, port in self._sources(topic):
            yield Edge(key, port, middle, "", topic.name)
        for key, port in self._sinks(topic):
            yield Edge(middle, "", key, port, topic.name)

    def past(self, topic: Topic) -> Iterator[Edge]:
        """Arrows from each source to each sink."""
        sinks = self._sinks(topic)
        for tail, tail_port in self._sources(topic):
            for head, head_port in sinks:
                yield Edge(tail, tail_port, head, head_port, topic.name)

    def _sources(self, topic: Topic) -> list[tuple[str, str]]:
        nodes = (node.name for node in self.nodes if topic.name in node.publishes)
        return self._keys(topic.sources, nodes)

    def _sinks(self, topic: Topic) -> list[tuple[str, str]]:
        nodes = (node.name for node in self.nodes if topic.name in node.subscribes)
        return self._keys(topic.targets, nodes)

    def _keys(self, refs: Iterable[PortRef], nodes: Iterable[str]) -> list[tuple[str, str]]:
        """The vertices of shown nodelets and nodes, with the ports of the nodelets."""
        ports = [ref for ref in refs if ref.nodelet in self.nodelets]
        keys = [(key_of(VertexKind.NODELET, ref.nodelet), ref.port) for ref in ports]
        return keys + [(key_of(VertexKind.NODE, name), "") for name in nodes]


def figure_of(snapshot: Snapshot, options: Options) -> Figure:
    figure = unboxed_figure_of(snapshot, options)
    if options.boxes is Boxes.NAMESPACES:
        figure = _boxed(figure, options.depth)
    else:
        homes = {
            each.name: _home(each, options.boxes)[: options.depth] for each in snapshot.nodelets
        }
        figure = _boxed_by_home(figure, homes)
    figure = _collapsed(figure, options.collapsed)
    claims = [
        Vertex(key_of(VertexKind.CLAIM, tag), VertexKind.CLAIM, tag, note=why)
        for tag, why in snapshot.pending
        if _wanted(tag, options.nodelet_filter, options)
    ]
    return replace(figure, vertices=(*claims, *figure.vertices)) if claims else figure


def _boxed(figure: Figure, depth: int) -> Figure:
    """Assign vertices to the boxes of their namespaces; topics alone make no box."""
    spaces = {v.key: tuple(with_namespaces(v.name)[:-1][:depth]) for v in figure.vertices}
    homes: set[Group] = set()
    for vertex in figure.vertices:
        if vertex.kind is not VertexKind.TOPIC:
            homes.update(spaces[vertex.key][:size] for size in range(depth + 1))

    def home(vertex: Vertex) -> Group:
        group = spaces[vertex.key]
        while group and group not in homes:
            group = group[:-1]
        return group

    return replace(figure, vertices=tuple(replace(v, group=home(v)) for v in figure.vertices))


def _home(nodelet: NodeletStatus, boxes: Boxes) -> Group:
    """The box of a nodelet's host, in it that of its nodelet manager; or that alone."""
    parts = (nodelet.host, nodelet.manager) if boxes is Boxes.HOSTS else (nodelet.manager,)
    return tuple(part for part in parts if part)


def _boxed_by_home(figure: Figure, homes: Mapping[str, Group]) -> Figure:
    """Assign nodelets to their boxes, and topics to the innermost around all of their ends."""
    groups = {
        vertex.key: homes.get(vertex.name, ())
        for vertex in figure.vertices
        if vertex.kind is VertexKind.NODELET
    }
    neighbours = figure.neighbours()
    for vertex in figure.vertices:
        ends = [groups.get(key, ()) for key in neighbours[vertex.key]]
        if vertex.kind is VertexKind.TOPIC:
            groups[vertex.key] = tuple(os.path.commonprefix(ends))
    vertices = (replace(v, group=groups.get(v.key, ())) for v in figure.vertices)
    return replace(figure, vertices=tuple(vertices))


def _collapsed(figure: Figure, groups: AbstractSet[Group]) -> Figure:
    """Draw some boxes as one vertex each, with the arrows of all that is in them."""
    if not groups:
        return figure
    homes = {v.key: _outermost(v.group, groups) for v in figure.vertices}
    members: dict[Group, list[str]] = {}
    for vertex in figure.vertices:
        home = homes[vertex.key]
        if home is not None:
            nodelets = members.setdefault(home, [])
            nodelets += [vertex.key] * (vertex.kind is VertexKind.NODELET)
    boxes = [_box(group, keys) for group, keys in members.items()]
    others = [v for v in figure.vertices if homes[v.key] is None]
    edges: dict[object, Edge] = {}
    for edge in _led(figure.edges, homes):
        is_between_boxes = edge.tail_port == edge.head_port == ""
        edges.setdefault(edge[:4] if is_between_boxes else edge, edge)
    return replace(
        figure,
        vertices=tuple(sorted([*others, *boxes], key=lambda v: v.key)),
        edges=tuple(sorted(edges.values())),
    )


def _box(group: Group, members: Sequence[str]) -> Vertex:
    note = f"{len(members)} nodelet{'s' * (len(members) != 1)}"
    key, kind = _key(group), VertexKind.BOX
    return Vertex(key, kind, group[-1], group[:-1], note=note, members=tuple(members))


def _led(edges: Iterable[Edge], homes: Mapping[str, Group | None]) -> Iterator[Edge]:
    """Lead arrows to the boxes that hold their ends."""
    for edge in edges:
        tail, head = homes[edge.tail], homes[edge.head]
        if tail is not None:
            edge = edge._replace(tail=_key(tail), tail_port="")
        if head is not None:
            edge = edge._replace(head=_key(head), head_port="")
        if edge.tail != edge.head:
            yield edge


def _outermost(group: Group, groups: AbstractSet[Group]) -> Group | None:
    prefixes = (group[:size] for size in range(1, len(group) + 1))
    return next((prefix for prefix in prefixes if prefix in groups), None)


def _key(group: Group) -> str:
    return key_of(VertexKind.BOX, " ".join(group))
