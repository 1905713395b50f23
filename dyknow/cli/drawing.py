# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The computation graph in graphviz's DOT language.

Everything is written in sorted order, so that equal graphs have equal drawings, and a small
change a small effect.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict, Iterator, List, Sequence, Set

from dyknow import names
from dyknow.cli.views import state_of
from dyknow.graphviz import quote
from dyknow.wiring.topics import topics_of

if TYPE_CHECKING:
    from dyknow.model.graph import Model, NodeletStatus

_TROUBLED = {"starting": "gray50", "lost": "red3", "failed": "red3"}


def to_dot(snapshot: Model) -> str:
    """Write the graph: ovals for nodelets, rectangles for topics, boxes for namespaces.

    The names of nodes are `n` or `t` followed by the name of the nodelet or topic.
    """
    inside: Dict[str, List[str]] = {}
    nodelets = sorted(snapshot.nodelets, key=lambda nodelet: nodelet.name)
    spaces = _with_parents(names.parent(nodelet.name) for nodelet in nodelets)
    for nodelet in nodelets:
        inside.setdefault(names.parent(nodelet.name), []).append(_oval(nodelet))
    topics = topics_of(snapshot.nodelets)
    known = {nodelet.name for nodelet in nodelets}
    for topic in topics:
        # /camera/image is drawn beside /camera, not in a box of its own.
        space = names.parent(topic.name)
        while space not in spaces or space in known:
            space = names.parent(space)
        label = [topic.name, *([topic.datatype] if topic.datatype else [])]
        rectangle = f"{_id('t', topic.name)} [shape=box, label={quote(*label)}];"
        inside.setdefault(space, []).append(rectangle)
    lines = ["digraph dyknow {", "  rankdir=LR;", '  node [fontname="sans-serif", fontsize=11];']
    lines.append('  edge [fontname="sans-serif", fontsize=9];')
    lines.extend("  " + line for line in _boxes("/", sorted(spaces), inside))
    for topic in topics:
        for source in topic.sources:
            ends = f"{_id('n', source.nodelet)} -> {_id('t', topic.name)}"
            lines.append(f"  {ends} [label={quote(source.port)}];")
        for target in topic.targets:
            ends = f"{_id('t', topic.name)} -> {_id('n', target.nodelet)}"
            lines.append(f"  {ends} [label={quote(target.port)}];")
    lines.append("}")
    return "\n".join(lines) + "\n"


def _with_parents(spaces: Iterator[str]) -> Set[str]:
    found = {"/"}
    for space in spaces:
        while space not in found:
            found.add(space)
            space = names.parent(space)
    return found


def _oval(nodelet: NodeletStatus) -> str:
    label = [nodelet.name, *([nodelet.transformation] if nodelet.transformation else [])]
    more = ""
    state = state_of(nodelet)
    if state in _TROUBLED:
        label.append(state)
        more = f", style=dashed, color={_TROUBLED[state]}"
    elif nodelet.is_protected:
        more = ", style=bold"
    return f"{_id('n', nodelet.name)} [shape=ellipse, label={quote(*label)}{more}];"


def _boxes(space: str, spaces: Sequence[str], inside: Dict[str, List[str]]) -> Iterator[str]:
    yield from inside.get(space, ())
    for child in spaces:
        if child != "/" and names.parent(child) == space:
            yield f"subgraph {quote('cluster ' + child)} {{"
            yield f"  label={quote(child)};"
            for line in _boxes(child, spaces, inside):
                yield "  " + line
            yield "}"


def _id(kind: str, name: str) -> str:
    return quote(kind + name)
