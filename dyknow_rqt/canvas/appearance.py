# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The looks of vertices and arrows: colours, fonts, signs."""

from __future__ import annotations

import enum
from functools import lru_cache
from typing import TYPE_CHECKING, Dict, FrozenSet, Mapping, NamedTuple, Optional, Sequence

from python_qt_binding.QtGui import QColor, QFont, QFontMetricsF, QPalette

from dyknow.formulas import Truth
from dyknow.model.graph import PortRef, State
from dyknow.model.transformation import IN
from dyknow_rqt.graph.figure import Figure, Vertex, VertexKind, key_of
from dyknow_rqt.graph.geometry import Size
from dyknow_rqt.graph.rates import PortRate
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph.verdicts import PortVerdict


class Tone(enum.Enum):
    """The relation of an item to the one under the pointer, or to the plan that is shown."""

    NONE = "none"
    SELF = "self"
    IN = "in"
    OUT = "out"
    BOTH = "both"
    KEPT = "kept"
    DROPPED = "dropped"


class Colours(NamedTuple):
    """The colours of the items."""

    line: QColor
    text: QColor
    nodelet: QColor
    topic: QColor
    box: QColor
    box_line: QColor
    muted: QColor
    alarm: QColor
    chosen: QColor
    paper: QColor
    self_: QColor
    in_: QColor
    out: QColor
    both: QColor
    kept: QColor
    true: QColor
    false: QColor

    def of_truth(self, truth: Truth) -> QColor:
        """The colour of a verdict."""
        return {Truth.TRUE: self.true, Truth.FALSE: self.false}.get(truth, self.line)

    def of(self, tone: Tone) -> QColor:
        """The colour of a highlighted item."""
        return {
            Tone.SELF: self.self_,
            Tone.IN: self.in_,
            Tone.OUT: self.out,
            Tone.BOTH: self.both,
            Tone.KEPT: self.out,
            Tone.DROPPED: self.muted,
        }.get(tone, self.line)


def colours_of(palette: QPalette) -> Colours:
    """Derive the colours from a palette."""
    paper, text = palette.color(QPalette.Base), palette.color(QPalette.Text)
    dark = paper.lightness() < text.lightness()
    chosen = palette.color(QPalette.Highlight)
    red = QColor("#e76129") if dark else QColor("#d52401")
    green = QColor("#3cd380") if dark else QColor("#1a8060")
    return Colours(
        line=_mix(text, paper, 0.25),
        text=text,
        nodelet=_mix(paper, chosen, 0.10),
        topic=_mix(paper, text, 0.05),
        box=_mix(paper, text, 0.025),
        box_line=_mix(paper, text, 0.35),
        muted=_mix(text, paper, 0.38),
        alarm=QColor("#ff6b61") if dark else QColor("#c62015"),
        chosen=chosen,
        paper=paper,
        # These differ for every kind of colour blindness, also from the line.
        self_=red,
        in_=QColor("#6d7ef7") if dark else QColor("#0018c8"),
        out=green,
        both=QColor("#c983c8") if dark else QColor("#c906b3"),
        kept=_mix(paper, green, 0.25),
        true=green,
        false=red,
    )


def greys_of(palette: QPalette) -> Colours:
    """The colours of a drawing that may no longer be true."""
    colours = colours_of(palette)
    muted, line, paper = colours.muted, colours.box_line, colours.paper
    return colours._replace(
        line=line,
        text=muted,
        nodelet=paper,
        topic=paper,
        box=paper,
        alarm=muted,
        true=muted,
        false=muted,
    )


def _mix(one: QColor, other: QColor, share: float) -> QColor:
    """A colour between two, ``share`` of the way to the other."""
    parts = zip(one.getRgb()[:3], other.getRgb()[:3])
    return QColor(*(int(a + (b - a) * share) for a, b in parts))


if TYPE_CHECKING:
    from dyknow.model.graph import NodeletStatus

_PORT_PITCH = 15.0
#: Font size on arrows, relative to that of vertices.
RATE_SCALE = 0.78


class Appearance(NamedTuple):
    """The text of a vertex besides its name."""

    state: State = State.RUNNING
    is_protected: bool = False
    is_cpp: bool = False


def sizes_of(figure: Figure, font: QFont) -> Dict[str, Size]:
    """Sizes of vertices with room for their names and ports."""
    key, sizes = font.key(), {}
    for vertex in figure.vertices:
        width, height = _size_of_text(key, vertex.label)
        if vertex.kind.is_square:
            sizes[vertex.key] = Size(width + 16, height + 8)
        else:
            room = _PORT_PITCH * (max(len(vertex.inputs), len(vertex.outputs)) + 1)
            wide, tall = width * 1.15 + 26, height + 26
            sizes[vertex.key] = (
                Size(max(wide, room), tall) if figure.is_downwards else Size(wide, max(tall, room))
            )
    return sizes


@lru_cache(maxsize=20_000)
def _size_of_text(font_key: str, text: str) -> Size:
    font = QFont()
    font.fromString(font_key)
    metrics, lines = QFontMetricsF(font), text.split("\n")
    width = max(metrics.horizontalAdvance(line) for line in lines)
    return Size(width, metrics.height() * len(lines))


def gap_of(font: QFont) -> float:
    """Room for a rate on an arrow, in pixels."""
    small = QFont(font)
    small.setPointSizeF(font.pointSizeF() * RATE_SCALE)
    return float(QFontMetricsF(small).horizontalAdvance("000.0 Hz")) + 10


def appearance_of(nodelet: NodeletStatus) -> Appearance:
    is_cpp = not nodelet.kind.is_written_for_dyknow
    return Appearance(nodelet.state, nodelet.is_protected, is_cpp)


def dead_keys(snapshot: Snapshot) -> FrozenSet[str]:
    """Vertices through which nothing can come: lost nodelets, and topics without live sources.

    A topic that nobody is known to publish lives as long as one of its receivers.
    """
    lost = {n.name for n in snapshot.nodelets if n.state in (State.LOST, State.FAILED)}
    published = {topic for node in snapshot.nodes for topic in node.publishes}
    dead = {key_of(VertexKind.NODELET, name) for name in lost}
    for topic in snapshot.topics().values() if lost else ():
        ends = topic.sources or topic.targets
        if topic.name not in published and all(ref.nodelet in lost for ref in ends):
            dead.add(key_of(VertexKind.TOPIC, topic.name))
    return frozenset(dead)


def vertex_tip(snapshot: Snapshot, vertex: Vertex, verdicts: Mapping[PortRef, PortVerdict]) -> str:
    nodelet, topic = snapshot.nodelet(vertex.name), snapshot.topics().get(vertex.name)
    if vertex.kind is VertexKind.TOPIC and topic is not None:
        said = [verdicts[ref].text for ref in topic.sources if ref in verdicts]
        return _tip(vertex.name, topic.datatype or "type not known yet", *(said or topic.tags))
    if vertex.kind is VertexKind.NODELET and nodelet is not None:
        return _nodelet_tip(nodelet)
    what = {
        VertexKind.BOX: "a collapsed box; double-click to open it",
        VertexKind.GHOST: f"a nodelet of the plan that is shown: {vertex.note}",
        VertexKind.CLAIM: f"a stream that waits until it can be made: {vertex.note}",
    }
    return _tip(vertex.name, what.get(vertex.kind, "ordinary ROS node"))


def port_tip(
    snapshot: Snapshot,
    ref: PortRef,
    traffic: Optional[PortRate],
    verdict: Optional[PortVerdict],
) -> str:
    port = snapshot.port(ref)
    if port is None:
        return ""
    lines = [
        f"{'in' if port.direction == IN else 'out'}-port {port.name}",
        port.datatype or "type not known yet",
        port.topic or "not connected",
        *(port.tags if verdict is None else [verdict.text]),
    ]
    if traffic is not None:
        verb = "received" if port.direction == IN else "sent"
        rates = traffic.text.replace("\n", ", ")
        lines.append(f"{rates} ({traffic.messages} {verb}, {traffic.dropped} dropped)")
    return _tip(*lines)


def edge_traffic(
    refs: Sequence[PortRef], traffic: Mapping[PortRef, PortRate]
) -> Optional[PortRate]:
    """The rate of an arrow, counted by its source or else its sink; None if unknown.

    One that its sink cannot follow has that of the sink.
    """
    found = [traffic[ref] for ref in refs if ref in traffic]
    return found[0 if found[0].drop_rate > 0 else -1] if found else None


def edge_verdict(
    refs: Sequence[PortRef], verdicts: Mapping[PortRef, PortVerdict]
) -> Optional[PortVerdict]:
    """The last verdict that came along an arrow from an out-port; None if it carries none."""
    return next((verdicts[ref] for ref in refs if ref in verdicts), None)


def _nodelet_tip(nodelet: NodeletStatus) -> str:
    inputs = sum(port.direction == IN for port in nodelet.ports)
    facts = [
        word
        for word, holds in (
            ("protected", nodelet.is_protected),
            ("in a process of its own", nodelet.isolated),
            ("its topics are fixed", nodelet.is_fixed),
        )
        if holds
    ]
    state = nodelet.state.name.lower()
    return _tip(
        nodelet.name,
        nodelet.origin,
        nodelet.kind.title + (f" in {nodelet.manager}" if nodelet.manager else ""),
        f"on {nodelet.host}" if nodelet.host else "",
        " ".join(f"{each.name}={each.text}" for each in nodelet.parameters),
        f"in-ports: {inputs}, out-ports: {len(nodelet.ports) - inputs}",
        *facts,
        state + (f": {nodelet.detail}" if nodelet.detail else ""),
    )


def _tip(*lines: str) -> str:
    return "\n".join(line for line in lines if line)
