"""The computation graph in graphviz's DOT language, and drawn by graphviz.

Everything is written in sorted order, so that the same graph always gives the same drawing and a
small change a small one.
"""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING, Dict, Iterator, List, Sequence, Set

from dyknow import names
from dyknow.cli.topics import topics_of
from dyknow.cli.views import state_of
from dyknow.errors import DyKnowError

if TYPE_CHECKING:
    from dyknow.ros.views import ModelView, NodeletView

#: Seconds that graphviz may take; some 200 nodelets need 15 of them.
LAYOUT_TIMEOUT = 120.0

_TROUBLED = {"starting": "gray50", "lost": "red3", "failed": "red3"}


class CannotDraw(DyKnowError):
    """Graphviz is not installed, or gave up."""


def to_dot(snapshot: ModelView) -> str:
    """Write the graph: ovals for nodelets, rectangles for topics, boxes for namespaces.

    The names of nodes are `n` or `t` followed by the name of the nodelet or topic.
    """
    inside: Dict[str, List[str]] = {}
    nodelets = sorted(snapshot.nodelets, key=lambda nodelet: nodelet.name)
    spaces = _with_parents(names.parent(nodelet.name) for nodelet in nodelets)
    for nodelet in nodelets:
        inside.setdefault(names.parent(nodelet.name), []).append(_oval(nodelet))
    topics = topics_of(snapshot)
    known = {nodelet.name for nodelet in nodelets}
    for topic in topics:
        # /camera/image is drawn beside /camera, not in a box of its own.
        space = names.parent(topic.name)
        while space not in spaces or space in known:
            space = names.parent(space)
        label = [topic.name, *([topic.datatype] if topic.datatype else [])]
        rectangle = f"{_id('t', topic.name)} [shape=box, label={_quoted(*label)}];"
        inside.setdefault(space, []).append(rectangle)
    lines = ["digraph dyknow {", "  rankdir=LR;", '  node [fontname="sans-serif", fontsize=11];']
    lines.append('  edge [fontname="sans-serif", fontsize=9];')
    lines.extend("  " + line for line in _boxes("/", sorted(spaces), inside))
    for topic in topics:
        for source in topic.sources:
            ends = f"{_id('n', source.nodelet)} -> {_id('t', topic.name)}"
            lines.append(f"  {ends} [label={_quoted(source.port)}];")
        for target in topic.targets:
            ends = f"{_id('t', topic.name)} -> {_id('n', target.nodelet)}"
            lines.append(f"  {ends} [label={_quoted(target.port)}];")
    lines.append("}")
    return "\n".join(lines) + "\n"


def render(dot: str, form: str, timeout: float = LAYOUT_TIMEOUT) -> bytes:
    """Draw a graph with graphviz.

    Args:
        dot: The graph.
        form: `svg` or `png`.
        timeout: Seconds after which it is given up.

    Raises:
        CannotDraw: with the reason.
    """
    try:
        done = subprocess.run(
            ["dot", f"-T{form}"],
            input=dot.encode("utf-8"),
            capture_output=True,
            timeout=timeout,
            check=False,
        )
    except FileNotFoundError as error:
        raise CannotDraw(
            "graphviz's program 'dot' is not installed; install graphviz, or use --dot"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise CannotDraw(
            f"graphviz needs more than {timeout:g} s; draw less with --namespace, or use --dot"
        ) from error
    if done.returncode:
        words = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise CannotDraw(f"graphviz failed: {words[0] if words else done.returncode}")
    return done.stdout


def _with_parents(spaces: Iterator[str]) -> Set[str]:
    found = {"/"}
    for space in spaces:
        while space not in found:
            found.add(space)
            space = names.parent(space)
    return found


def _oval(nodelet: NodeletView) -> str:
    label = [nodelet.name, *([nodelet.transformation] if nodelet.transformation else [])]
    more = ""
    state = state_of(nodelet)
    if state in _TROUBLED:
        label.append(state)
        more = f", style=dashed, color={_TROUBLED[state]}"
    elif nodelet.is_protected:
        more = ", style=bold"
    return f"{_id('n', nodelet.name)} [shape=ellipse, label={_quoted(*label)}{more}];"


def _boxes(space: str, spaces: Sequence[str], inside: Dict[str, List[str]]) -> Iterator[str]:
    yield from inside.get(space, ())
    for child in spaces:
        if child != "/" and names.parent(child) == space:
            yield f"subgraph {_quoted('cluster ' + child)} {{"
            yield f"  label={_quoted(child)};"
            for line in _boxes(child, spaces, inside):
                yield "  " + line
            yield "}"


def _id(kind: str, name: str) -> str:
    return _quoted(kind + name)


def _quoted(*lines: str) -> str:
    """Quote a text of DOT; a label may have several lines."""
    return (
        '"'
        + "\\n".join(
            line.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ") for line in lines
        )
        + '"'
    )
