# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`graph`: the computation graph as text or as a drawing."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from dyknow.cli import completion
from dyknow.cli.arguments import namespace
from dyknow.cli.command import Command
from dyknow.cli.drawing import to_dot
from dyknow.cli.files import write_file
from dyknow.cli.json_output import nodelet_json
from dyknow.cli.shell import Shell
from dyknow.cli.topics import list_topics
from dyknow.graphviz import CannotDraw, render
from dyknow.wiring.topics import Topic, topics_of

if TYPE_CHECKING:
    from dyknow.model.graph import Model

#: Seconds that graphviz may take.
_TIMEOUT = 120.0


def _arguments(parser: argparse.ArgumentParser) -> None:
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--dot", action="store_true", help="print it in graphviz's DOT language")
    for kind in ("svg", "png"):
        completion.complete_with(
            form.add_argument(
                f"--{kind}", metavar="FILE", default=None, help=f"draw it into a file ({kind})"
            ),
            completion.files,
        )
    completion.complete_with(
        parser.add_argument(
            "--namespace",
            metavar="NS",
            type=namespace,
            default=None,
            help="only nodelets of this namespace, with the topics that they are connected to",
        ),
        completion.namespaces,
    )


def _graph(arguments: argparse.Namespace, shell: Shell) -> None:
    snapshot = shell.client.get_graph()
    if arguments.namespace:
        snapshot = _inside(snapshot, shell.resolve(arguments.namespace))
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
                "topics": [_topic_json(topic) for topic in topics],
            },
            list_topics(snapshot, topics),
        )


def _inside(snapshot: Model, wanted: str) -> Model:
    inside = wanted.rstrip("/") + "/"
    nodelets = tuple(each for each in snapshot.nodelets if each.name.startswith(inside))
    return replace(snapshot, nodelets=nodelets)


def _topic_json(topic: Topic) -> dict[str, object]:
    return {
        "topic": topic.name,
        "datatype": topic.datatype,
        "out": [{"nodelet": end.nodelet, "port": end.port} for end in topic.sources],
        "in": [{"nodelet": end.nodelet, "port": end.port} for end in topic.targets],
    }


COMMANDS = (
    Command(
        "graph",
        "show or draw the computation graph",
        "Show which ports are connected by which topics, or draw it: nodelets as ovals, topics as "
        "rectangles, from left to right, with boxes around namespaces. SVG and PNG need graphviz.",
        "dyknow graph\ndyknow graph --svg graph.svg\ndyknow graph --namespace /robot --dot | "
        "dot -Tpdf -o robot.pdf",
        _arguments,
        _graph,
    ),
)
