# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`graph`: the computation graph as text, or as a drawing in graphviz's DOT language.

Everything is written in sorted order: equal graphs have equal drawings.
"""

from __future__ import annotations

import argparse
from typing import Iterator, Sequence

from dyknow import names
from dyknow.cli.arguments import argument, flag, group
from dyknow.cli.output import STDIO, nodelet_json, picked, state_of, write_file
from dyknow.cli.shell import Shell, command
from dyknow.graphviz import CannotDraw, quote, render
from dyknow.model.graph import Model, NodeletStatus, PortRef
from dyknow.wiring.ports import Topic, by_name, topics_of

_TIMEOUT = 120.0  # seconds that graphviz may take


@command(
    "Show which ports are connected by which topics, or draw it: nodelets as ovals, topics as "
    "rectangles, from left to right, with boxes around namespaces. SVG and PNG need graphviz.",
    "dyknow graph\ndyknow graph --svg graph.svg\ndyknow graph --namespace /robot --dot | "
    "dot -Tpdf -o robot.pdf",
    group(
        flag("--dot", "print it in graphviz's DOT language"),
        argument("--svg", "FILE", f"draw it into a file (svg); {STDIO} for standard output"),
        argument("--png", "FILE", f"draw it into a file (png); {STDIO} for standard output"),
    ),
    argument(
        "--namespace",
        "NS",
        "only nodelets of this namespace, with the topics that they are connected to",
    ),
)
def _graph(arguments: argparse.Namespace, shell: Shell) -> None:
    snapshot = shell.graph(arguments.namespace)
    drawing = arguments.svg or arguments.png
    if drawing:
        kind = "svg" if arguments.svg else "png"
        try:
            picture = render(to_dot(snapshot), kind, _TIMEOUT)
        except CannotDraw as error:
            raise CannotDraw(
                f"{error}, or use --dot, which draws nothing, or --namespace, which draws less"
            ) from error
        write_file(drawing, picture)
        if drawing != STDIO:
            shell.show({"file": drawing}, [f"drew {drawing}"])
    elif arguments.dot:
        dot = to_dot(snapshot)
        shell.show({"dot": dot}, [dot.rstrip("\n")])
    else:
        topics = topics_of(snapshot.nodelets)
        shell.show(
            {
                "revision": snapshot.revision,
                "nodelets": [nodelet_json(each) for each in snapshot.nodelets],
                "topics": [
                    picked(topic, "topic=name datatype out=sources in=targets") for topic in topics
                ],
            },
            _list_topics(snapshot, topics),
        )


def _list_topics(snapshot: Model, topics: Sequence[Topic]) -> Iterator[str]:
    """Write the graph as lines: each topic with its ports, then the disconnected ports."""
    for topic in topics:
        yield f"{topic.name} [{topic.datatype or 'unknown type'}]"
        for source in topic.sources:
            yield f"    from {source}"
        for target in topic.targets:
            yield f"    to   {target}"
    loose = []
    for nodelet in snapshot.nodelets:
        for port in by_name(nodelet.ports):
            if not port.topic:
                loose.append(f"    {port.direction:<4} {PortRef(nodelet.name, port.name)}")
    for nodelet in snapshot.nodelets:
        if not nodelet.ports:
            state = state_of(nodelet)
            loose.append(f"    {nodelet.name} ({'no ports' if state == 'running' else state})")
    if loose:
        yield "(disconnected)"
        yield from loose


_TROUBLED = {"starting": "gray50", "lost": "red3", "failed": "red3"}


def to_dot(snapshot: Model) -> str:
    """Write the graph: ovals for nodelets, rectangles for topics, boxes for namespaces.

    The names of nodes are `n` or `t` followed by the name of the nodelet or topic.
    """
    inside: dict[str, list[str]] = {}
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


def _with_parents(spaces: Iterator[str]) -> set[str]:
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


def _boxes(space: str, spaces: Sequence[str], inside: dict[str, list[str]]) -> Iterator[str]:
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
