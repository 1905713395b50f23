# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Draws the graph at the end of an act of the story: kept, new and removed nodelets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import AbstractSet, Dict, List, Sequence, Tuple

from dyknow.graphviz import quote, render
from dyknow.model.graph import Model, NodeletStatus, State
from dyknow_demo.soccer.narration import short

FORMS = ("png", "svg")

_LAYOUT_TIMEOUT = 20.0  # s
_KEPT, _NEW, _IDLE = "#cfe2f3", "#c6e7c8", "#eeeeee"
_HEAD = """digraph story {
  rankdir=TB; nodesep=0.2; ranksep=0.25; labelloc=t; fontname="sans-serif"; fontsize=15;
  node [fontname="sans-serif", fontsize=12, margin="0.08,0.04", height=0.3];
  edge [fontname="sans-serif", fontsize=10];"""


@dataclass(frozen=True)
class PictureContents:
    """What a picture shows.

    Attributes:
        title: heading of the picture.
        model: the graph.
        needed: names of the nodelets of the stream.
        goal: topic on which the client listens.
        space: namespace left out of names.
    """

    title: str
    model: Model
    needed: AbstractSet[str]
    goal: str
    space: str = "/"

    def label(self, name: str) -> str:
        """Write a name without the namespace; a topic's in two lines."""
        head, slash, tail = short(name, self.space).rpartition("/")
        return quote(f"{head}\n{slash}{tail}" if head else slash + tail)


def to_dot(contents: PictureContents, first: Model) -> str:
    """Write a picture in graphviz's DOT language.

    Ovals are nodelets and rectangles are topics; the topic of the client is drawn bold. Whatever
    was in the first picture is blue, new things are green, and what the stream no longer needs is
    grey. Anything that has gone since the first picture is dashed.

    Args:
        contents: what to draw.
        first: the graph of the first picture.
    """
    there, known = _running(contents.model), _running(first)
    lines = [_HEAD, f"  label={quote(contents.title)};"]
    for name in sorted({*there, *known}):
        if name not in there:
            style = "style=dashed, color=gray50, fontcolor=gray50"
        elif name not in contents.needed:
            style = _filled(_IDLE)
        else:
            style = _filled(_KEPT if name in known else _NEW)
        lines.append(f"  {quote('n' + name)} [label={contents.label(name)}, {style}];")
    lines += _streams(there, contents)
    lines.append("}")
    return "\n".join(lines) + "\n"


def draw(dot: str, folder: Path, name: str) -> List[Path]:
    """Draw a picture in every form, into files of that name.

    Raises:
        CannotDraw: drawing failed; the text says why.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{form}" for form in FORMS]
    for form, file in zip(FORMS, files):
        file.write_bytes(render(dot, form, _LAYOUT_TIMEOUT))
    return files


def _running(model: Model) -> Dict[str, NodeletStatus]:
    return {each.name: each for each in model.nodelets if each.state is State.RUNNING}


def _filled(colour: str) -> str:
    return f'style=filled, fillcolor="{colour}"'


def _streams(there: Dict[str, NodeletStatus], contents: PictureContents) -> List[str]:
    """Topics with subscribers, and the arrows to and from them."""
    sources: Dict[str, List[Tuple[str, str]]] = {}
    targets: Dict[str, List[Tuple[str, str]]] = {contents.goal: []}
    for name in sorted(there):
        for port in there[name].ports:
            if port.topic:
                side = targets if port.direction == "in" else sources
                side.setdefault(port.topic, []).append((name, port.name))
    lines = [f"  client [shape=plaintext]; {quote('t' + contents.goal)} -> client;"]
    for topic in sorted(targets):
        bold = ", style=bold" if topic == contents.goal else ""
        lines.append(f"  {quote('t' + topic)} [label={contents.label(topic)}, shape=box{bold}];")
        lines += _arrows(topic, sources.get(topic, ()), targets[topic])
    return lines


def _arrows(
    topic: str, sources: Sequence[Tuple[str, str]], targets: Sequence[Tuple[str, str]]
) -> List[str]:
    node = quote("t" + topic)
    return [
        *(f"  {quote('n' + name)} -> {node};" for name, _ in sources),
        *(f"  {node} -> {quote('n' + name)} [label={quote(port)}];" for name, port in targets),
    ]
