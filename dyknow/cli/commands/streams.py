# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`plan`, `streams`, `release` and `replan`: streams on request."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Dict, List, Optional, Sequence

from dyknow.cli import completion
from dyknow.cli.command import Command
from dyknow.cli.json_output import stream_json
from dyknow.cli.shell import FAILED, Shell
from dyknow.cli.streams import demand_arguments, request_of
from dyknow.cli.tables import columns
from dyknow.errors import DyKnowError, ManagerUnreachable
from dyknow.manager.planning.explanation import tree_as_dot

if TYPE_CHECKING:
    from dyknow.model.streams import StreamStatus


def _plan_arguments(parser: argparse.ArgumentParser) -> None:
    demand_arguments(parser)
    parser.add_argument(
        "--dot", action="store_true", help="print the plan in graphviz's DOT language"
    )


def _plan(arguments: argparse.Namespace, shell: Shell) -> None:
    answer = shell.client.acquire_stream(request_of(arguments), dry_run=True)
    for warning in answer.warnings:
        shell.warn(warning)
    dot = tree_as_dot(answer.plan) if arguments.dot else ""
    result: Dict[str, Any] = {
        "tag": arguments.tag,
        "cost": answer.cost,
        "spawned": list(answer.spawned),
        "reused": list(answer.reused),
        "plan": answer.plan,
        "bindings": list(answer.bindings),
        "least_cost": answer.least_cost,
    }
    if arguments.dot:
        result["dot"] = dot
    lines = (dot or answer.plan).rstrip("\n").split("\n")
    if answer.bindings and not arguments.dot:
        lines.append(f"with {', '.join(answer.bindings)}")
    shell.show(result, lines)


def _streams_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-a", "--all", action="store_true", help="list claims that ended recently, too"
    )
    parser.add_argument(
        "-l", "--long", action="store_true", help="show client, nodelets and details, too"
    )


def _streams(arguments: argparse.Namespace, shell: Shell) -> None:
    streams = [
        each for each in shell.client.list_streams() if arguments.all or not each.state.ended
    ]
    lines = _long_list(streams) if arguments.long else _list(streams)
    shell.show({"streams": [stream_json(each) for each in streams]}, lines)


def _list(streams: Sequence[StreamStatus]) -> List[str]:
    rows = [("CLAIM", "STATE", "TAG", "TOPIC", "TYPE", "DETAIL")]
    rows += [
        (
            each.claim_id,
            each.state.name.lower(),
            each.bound_tag,
            each.topic or "-",
            each.datatype or "-",
            each.detail or "-",
        )
        for each in streams
    ]
    return columns(rows)


def _long_list(streams: Sequence[StreamStatus]) -> List[str]:
    lines = []
    for each in streams:
        detail = f" ({each.detail})" if each.detail else ""
        lease = f"until {each.expires:.1f} (ROS time)" if each.expires else "until released"
        lines += [
            f"Stream [{each.claim_id}]",
            f"Tag: {each.tag}",
            *([f"Bindings: {', '.join(each.bindings)}"] if each.bindings else []),
            f"State: {each.state.name.lower()}{detail}",
            f"Topic: {each.topic or '-'} [{each.datatype or 'unknown type'}]",
            f"Client: {each.client_id or '(not given)'}",
            f"Lease: {lease}",
            f"Nodelets: {' '.join(each.nodelets) or 'none'}",
            "",
        ]
    return lines


def _claims_argument(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument("claims", nargs="+", metavar="ID", help="a claim; see 'streams'"),
        completion.claims,
    )


def _release(arguments: argparse.Namespace, shell: Shell) -> Optional[int]:
    released: List[str] = []
    failed: List[Dict[str, str]] = []
    known = {each.claim_id for each in shell.client.list_streams()}
    for claim in arguments.claims:
        try:
            if claim not in known:
                raise DyKnowError(f"there is no claim '{claim}'; see 'dyknow streams'")
            shell.client.release_stream(claim)
        except ManagerUnreachable:
            raise
        except DyKnowError as error:
            shell.error(error)
            failed.append({"claim": claim, "message": str(error)})
        else:
            released.append(claim)
    shell.show(
        {"released": released, "failed": failed}, [f"released {claim}" for claim in released]
    )
    return FAILED if failed else None


def _replan_arguments(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument("claim", metavar="ID", help="a claim; see 'streams'"),
        completion.claims,
    )
    parser.add_argument(
        "-n", "--dry-run", action="store_true", help="show the plan, change nothing"
    )


def _replan(arguments: argparse.Namespace, shell: Shell) -> None:
    answer = shell.client.replan_stream(arguments.claim, arguments.dry_run)
    result = {
        "claim": arguments.claim,
        "dry_run": arguments.dry_run,
        "cost": answer.cost,
        "spawned": list(answer.spawned),
        "reused": list(answer.reused),
        "plan": answer.plan,
    }
    shell.show(result, answer.plan.rstrip("\n").split("\n"))


COMMANDS = (
    Command(
        "plan",
        "explain how a stream would be made",
        "Explain how a stream would be made now: what would be spawned, what would be reused, "
        "and the cost. Nothing is changed.",
        "dyknow plan 'FieldPosition(ball)'\n"
        "dyknow plan 'BallObject(?robot)' --exclude bottom_camera\n"
        "dyknow plan 'FieldPosition(ball)' --dot | dot -Tsvg -o plan.svg",
        _plan_arguments,
        _plan,
    ),
    Command(
        "streams",
        "list the claimed streams",
        "List the claims: tag, state, topic and details.",
        "dyknow streams\ndyknow streams -l --all\n"
        "dyknow streams --json | jq -r '.streams[] | select(.state != \"active\") | .detail'",
        _streams_arguments,
        _streams,
    ),
    Command(
        "release",
        "end claims",
        "End claims. Nodelets that were made for them and that no other claim needs are "
        "destroyed after some seconds.",
        "dyknow release 3f0c1a2b4d5e",
        _claims_argument,
        _release,
    ),
    Command(
        "replan",
        "switch a stream to the cheapest plan",
        "Switch a claimed stream to the plan that is the cheapest now. Its topic stays.",
        "dyknow replan 3f0c1a2b4d5e --dry-run\ndyknow replan 3f0c1a2b4d5e",
        _replan_arguments,
        _replan,
    ),
)
