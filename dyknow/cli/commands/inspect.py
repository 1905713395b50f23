# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`list` and `info`: what runs."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Dict, Iterator, List, Optional, Sequence, Tuple

from dyknow.cli import completion
from dyknow.cli.arguments import graph_name, namespace
from dyknow.cli.command import Command
from dyknow.cli.json_output import nodelet_json
from dyknow.cli.shell import FAILED, Shell
from dyknow.cli.tables import columns
from dyknow.cli.views import state_of, unknown_nodelet
from dyknow.model.transformation import IN, OUT
from dyknow.wiring.ports import by_name

if TYPE_CHECKING:
    from dyknow.model.graph import Model, NodeletStatus

_Ends = Dict[str, List[Tuple[str, str, str]]]


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument(
            "namespace", nargs="?", type=namespace, help="list only nodelets of this namespace"
        ),
        completion.namespaces,
    )
    parser.add_argument(
        "-l", "--long", action="store_true", help="show transformation, state, ports and manager"
    )


def _list(arguments: argparse.Namespace, shell: Shell) -> None:
    nodelets = shell.client.get_graph().nodelets
    if arguments.namespace:
        inside = shell.resolve(arguments.namespace).rstrip("/") + "/"
        nodelets = tuple(each for each in nodelets if each.name.startswith(inside))
    shell.show(
        {"nodelets": [nodelet_json(each) for each in nodelets]},
        _long_list(nodelets) if arguments.long else [each.name for each in nodelets],
    )


def _long_list(nodelets: Sequence[NodeletStatus]) -> List[str]:
    rows = [("NODELET", "TRANSFORMATION", "STATE", "IN", "OUT", "MANAGER")]
    for each in nodelets:
        directions = [port.direction for port in each.ports]
        marks = [state_of(each)]
        marks.extend(["protected"] if each.is_protected else [])
        marks.extend(["isolated"] if each.isolated else [])
        rows.append(
            (
                each.name,
                each.transformation or "-",
                ",".join(marks),
                str(directions.count(IN)),
                str(directions.count(OUT)),
                each.manager or "-",
            )
        )
    details = [f"{each.name}: {each.detail}" for each in nodelets if each.detail]
    return [*columns(rows, right=(3, 4)), *details]


def _info_arguments(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument("names", nargs="+", metavar="NAME", type=graph_name, help="a nodelet"),
        completion.nodelets,
    )


def _info(arguments: argparse.Namespace, shell: Shell) -> Optional[int]:
    snapshot = shell.client.get_graph()
    wanted = [shell.resolve(name) for name in arguments.names]
    found = [snapshot.nodelet(name) for name in wanted]
    for name, nodelet in zip(wanted, found):
        if nodelet is None:
            shell.error(unknown_nodelet(name, snapshot))
    present = [nodelet for nodelet in found if nodelet is not None]
    if present or len(wanted) > 1:
        lines = (line for nodelet in present for line in _describe(nodelet, snapshot))
        shell.show({"nodelets": [nodelet_json(nodelet) for nodelet in present]}, lines)
    return None if len(present) == len(wanted) else FAILED


def _describe(nodelet: NodeletStatus, snapshot: Model) -> Iterator[str]:
    yield "-" * 80
    yield f"Nodelet [{nodelet.name}]"
    yield f"Transformation: {nodelet.transformation or '(none: loaded by others)'}"
    yield f"Kind: {nodelet.kind.title}"
    if nodelet.manager:
        yield f"Nodelet manager: {nodelet.manager}{' (its own process)' * nodelet.isolated}"
    if nodelet.host:
        yield f"Host: {nodelet.host}"
    yield f"State: {state_of(nodelet)}" + (f" ({nodelet.detail})" if nodelet.detail else "")
    yield f"Protected: {'yes' if nodelet.is_protected else 'no'}"
    if nodelet.parameters:
        given = ", ".join(f"{each.name}={each.text}" for each in nodelet.parameters)
        yield f"Parameters given at the spawn: {given}"
    if nodelet.is_fixed:
        yield "Re-wiring: its topics are fixed (its nodelet manager has no live ports)"
    ends = _ends(snapshot)
    for direction, title in ((IN, "In-ports"), (OUT, "Out-ports")):
        yield ""
        ports = [port for port in by_name(nodelet.ports) if port.direction == direction]
        yield f"{title}:" if ports else f"{title}: none"
        for port in ports:
            yield f" * {port.name} [{port.datatype or 'unknown type'}]"
            yield f"    topic: {port.topic or '(disconnected)'}"
            for tag in port.tags:
                yield f"    tag: {tag}"
            others = [end for end in ends.get(port.topic, []) if end[0] != direction]
            for _, other, name in others:
                yield f"    {'from' if direction == IN else 'to'}: {other}:{name}"
    yield ""


def _ends(snapshot: Model) -> _Ends:
    """The ports on each topic: direction, nodelet and port."""
    ends: _Ends = {}
    for nodelet in snapshot.nodelets:
        for port in nodelet.ports:
            if port.topic:
                ends.setdefault(port.topic, []).append((port.direction, nodelet.name, port.name))
    return ends


COMMANDS = (
    Command(
        "list",
        "list the nodelets",
        "List the nodelets that the manager knows of, one name a line.",
        "dyknow list\ndyknow list -l\ndyknow list /robot\n"
        "dyknow list --json | jq -r '.nodelets[] | select(.state != \"running\") | .name'",
        _list_arguments,
        _list,
    ),
    Command(
        "info",
        "show nodelets, their ports and connections",
        "Show nodelets: transformation, manager, state, and each port with its type, topic, "
        "tags and the ports at the other end.",
        "dyknow info camera\ndyknow info camera undistort\ndyknow info camera --json",
        _info_arguments,
        _info,
    ),
)
