# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`tags`, `plan`, `streams`, `release` and `replan`: streams on request."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import Iterable, Iterator, Sequence

from dyknow.cli.arguments import argument, flag
from dyknow.cli.commands.acquire import DEMAND, request_of
from dyknow.cli.output import columns, picked, stream_json
from dyknow.cli.shell import Shell, command
from dyknow.errors import DyKnowError, Refused
from dyknow.manager.planning.explanation import tree_as_dot
from dyknow.manager.specifications.tags import read_tags
from dyknow.model.graph import Model, PortState
from dyknow.model.streams import StreamStatus
from dyknow.model.transformation import OUT, Port

_PLAN = "cost spawned reused plan"  # fields of a plan that are shown
#: The most tags whose bindings are looked up, and the most bindings shown of each.
_MOST_ASKED = 100
_MOST_SHOWN = 8


@dataclass
class _Supply:
    """The suppliers of a tag: labels of transformations, running nodelets, and ROS types."""

    tag: str
    transformations: set[str] = field(default_factory=set)
    nodelets: set[str] = field(default_factory=set)
    datatypes: set[str] = field(default_factory=set)
    bindings: list[dict[str, str]] | None = None  # of the tag's variables now; None: unknown


@command(
    "List the tags of out-ports: for which names the variables in them can stand now, their "
    "types, the transformations and the running nodelets that supply them.",
    "dyknow tags\ndyknow tags ball\ndyknow tags --json | jq -r '.tags[].tag'",
    argument("text", None, "list only tags that contain this, in any case", nargs="?", default=""),
)
def _tags(arguments: argparse.Namespace, shell: Shell) -> None:
    part = arguments.text.lower()
    supplies = [each for each in _supplies(shell.client.get_model()) if part in each.tag.lower()]
    with_variables = [each for each in supplies if "?" in each.tag]
    for each in with_variables[:_MOST_ASKED]:
        each.bindings = _bindings(shell, each.tag)
    if len(with_variables) > _MOST_ASKED:
        shell.warn(
            f"{len(with_variables)} tags have variables; only for {_MOST_ASKED} of them it was "
            "asked what these can stand for: list fewer, by a part of their text"
        )
    rows = [("TAG", "FOR", "TYPE", "SUPPLIED BY")]
    for each in supplies:
        running = [f"{name} (runs)" for name in sorted(each.nodelets)]
        suppliers = ", ".join([*sorted(each.transformations), *running])
        types = ", ".join(sorted(each.datatypes)) or "-"
        rows.append((each.tag, _written(each.bindings), types, suppliers))
    names = "tag datatypes transformations nodelets bindings"
    shell.show({"tags": [picked(each, names) for each in supplies]}, columns(rows))


def _bindings(shell: Shell, tag: str) -> list[dict[str, str]] | None:
    try:
        found = shell.client.find_bindings(tag)
    except Refused:  # the tag is not a term, so it cannot be requested
        return None
    return [dict(each.partition("=")[::2] for each in way.split(", ")) for way in found]


def _written(bindings: list[dict[str, str]] | None) -> str:
    """Write ``?camera=left|right``; several variables in turn, ``?a=x ?b=y, ?a=x ?b=z``."""
    if bindings is None:
        return "-"
    shown = bindings[:_MOST_SHOWN]
    more = f" and {len(bindings) - len(shown)} more" if len(bindings) > len(shown) else ""
    if not shown:
        return "nothing now"
    if len(shown[0]) == 1:
        (variable,) = shown[0]
        return f"{variable}={'|'.join(each[variable] for each in shown)}{more}"
    return ", ".join(" ".join(f"{x}={name}" for x, name in each.items()) for each in shown) + more


def _supplies(model: Model) -> list[_Supply]:
    """Return the supplies of all tags, which are equal if only their variables' names differ."""
    found: dict[str, _Supply] = {}

    def of(ports: Iterable[Port | PortState]) -> Iterator[_Supply]:
        for port in ports:
            for tag in port.tags if port.direction == OUT else ():
                supply = found.setdefault(_numbered(tag), _Supply(tag))
                supply.tag = min(tag, supply.tag)
                supply.datatypes |= {port.datatype} - {""}
                yield supply

    for transformation in model.transformations:
        for supply in of(transformation.ports):
            supply.transformations.add(transformation.label)
    for nodelet in model.nodelets:
        for supply in of(nodelet.ports):
            supply.nodelets.add(nodelet.name)
    return sorted(found.values(), key=lambda supply: supply.tag)


def _numbered(tag: str) -> str:
    """Number the variables of a tag, whose names do not matter."""
    for term in read_tags((tag,)):
        names = {variable: f"?{number}" for number, variable in enumerate(term.variables)}
        return str(term._replace(args=tuple(names.get(each, each) for each in term.args)))
    return tag


@command(
    "Explain how a stream would be made now: what would be spawned, what would be reused, "
    "and the cost. Nothing is changed.",
    "dyknow plan 'FieldPosition(ball)'\n"
    "dyknow plan 'BallObject(?robot)' --exclude bottom_camera\n"
    "dyknow plan 'FieldPosition(ball)' --dot | dot -Tsvg -o plan.svg",
    *DEMAND,
    flag("--dot", "print the plan in graphviz's DOT language"),
)
def _plan(arguments: argparse.Namespace, shell: Shell) -> None:
    answer = shell.client.acquire_stream(request_of(arguments), dry_run=True)
    for warning in answer.warnings:
        shell.warn(warning)
    result = {"tag": arguments.tag, **picked(answer, f"{_PLAN} bindings least_cost")}
    lines = answer.plan.rstrip("\n").split("\n")
    lines += [f"with {', '.join(answer.bindings)}"] if answer.bindings else []
    if arguments.dot:
        result["dot"] = tree_as_dot(answer.plan)
        lines = result["dot"].rstrip("\n").split("\n")
    shell.show(result, lines)


@command(
    "List the claims: tag, state, topic and details.",
    "dyknow streams\ndyknow streams -l --all\n"
    "dyknow streams --json | jq -r '.streams[] | select(.state != \"active\") | .detail'",
    flag("-a --all", "list claims that ended recently, too"),
    flag("-l --long", "show client, nodelets and details, too"),
)
def _streams(arguments: argparse.Namespace, shell: Shell) -> None:
    streams = [
        each for each in shell.client.list_streams() if arguments.all or not each.state.ended
    ]
    lines = _stream_details(streams) if arguments.long else _stream_table(streams)
    shell.show({"streams": [stream_json(each) for each in streams]}, lines)


def _stream_table(streams: Sequence[StreamStatus]) -> list[str]:
    rows: list[tuple[object, ...]] = [("CLAIM", "STATE", "TAG", "TOPIC", "TYPE", "DETAIL")]
    for each in streams:
        state, ends = each.state.name.lower(), (each.topic or None, each.datatype or None)
        rows.append((each.claim_id, state, each.bound_tag, *ends, each.detail or None))
    return columns(rows)


def _stream_details(streams: Sequence[StreamStatus]) -> Iterator[str]:
    for each in streams:
        yield f"Stream [{each.claim_id}]"
        yield f"Tag: {each.tag}"
        if each.bindings:
            yield f"Bindings: {', '.join(each.bindings)}"
        yield f"State: {each.state.name.lower()}" + (f" ({each.detail})" if each.detail else "")
        yield f"Topic: {each.topic or '-'} [{each.datatype or 'unknown type'}]"
        yield f"Client: {each.client_id or '(not given)'}"
        lease = f"until {each.expires:.1f} (ROS time)" if each.expires else "until released"
        yield f"Lease: {lease}"
        yield f"Nodelets: {' '.join(each.nodelets) or 'none'}"
        yield ""


@command(
    "End claims. Nodelets that were made for them and that no other claim needs are "
    "destroyed after some seconds.",
    "dyknow release 3f0c1a2b4d5e",
    argument("claims", "ID", "a claim; see 'streams'", nargs="+"),
)
def _release(arguments: argparse.Namespace, shell: Shell) -> int | None:
    known = {each.claim_id for each in shell.client.list_streams()}

    def release(claim: str) -> None:
        if claim not in known:
            raise DyKnowError(f"there is no claim '{claim}'; see 'dyknow streams'")
        shell.client.release_stream(claim)

    return shell.for_each("claim", "released", arguments.claims, release)


@command(
    "Switch a claimed stream to the plan that is the cheapest now. Its topic stays.",
    "dyknow replan 3f0c1a2b4d5e --dry-run\ndyknow replan 3f0c1a2b4d5e",
    argument("claim", "ID", "a claim; see 'streams'"),
    flag("-n --dry-run", "show the plan, change nothing"),
)
def _replan(arguments: argparse.Namespace, shell: Shell) -> None:
    answer = shell.client.replan_stream(arguments.claim, arguments.dry_run)
    result = {**picked(arguments, "claim dry_run"), **picked(answer, _PLAN)}
    shell.show(result, answer.plan.rstrip("\n").split("\n"))
