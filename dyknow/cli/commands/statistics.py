# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`stats`: the traffic of the ports."""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Collection, Dict, List, Optional, Sequence, Tuple, Union

from dyknow.cli import completion
from dyknow.cli.arguments import graph_name, positive, seconds
from dyknow.cli.command import Command
from dyknow.cli.json_output import statistics_json
from dyknow.cli.shell import FAILED, Shell
from dyknow.cli.tables import columns
from dyknow.cli.views import unknown_nodelet
from dyknow.cli.watching import Screen
from dyknow.errors import DyKnowError, NodeletUnreachable, Refused
from dyknow.model.transformation import IN, OUT

if TYPE_CHECKING:
    from dyknow.model.statistics import NodeletStatistics

_WORKERS = 16
_PERIOD = 1.0

_HEAD = (
    *("NODELET", "PORT", "", "HZ", "MESSAGES", "DROPPED", "UNSENT"),
    *("MEAN", "MAX", "ERRORS", "TOPIC"),
)

#: The statistics of a nodelet, or the error.
Answer = Union["NodeletStatistics", DyKnowError]


def _arguments(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument(
            "names", nargs="*", metavar="NAME", type=graph_name, help="nodelets (default: all)"
        ),
        completion.nodelets,
    )
    parser.add_argument(
        "-w",
        "--watch",
        metavar="SECONDS",
        type=seconds,
        nargs="?",
        const=_PERIOD,
        help=f"repeat every SECONDS (default: {_PERIOD:g}) until Ctrl-C",
    )
    parser.add_argument(
        "-n", "--count", metavar="N", type=positive, help="with --watch: end after N times"
    )


def _problem(arguments: argparse.Namespace) -> str:
    if arguments.count is not None and arguments.watch is None:
        return "--count says how often --watch shows; expected both, or neither"
    return ""


def _stats(arguments: argparse.Namespace, shell: Shell) -> Optional[int]:
    names = [shell.resolve(name) for name in arguments.names]
    if arguments.watch is None:
        return _show_once(shell, names)
    screen = Screen(shell, arguments.watch)
    shown = 0
    while True:
        begin = time.monotonic()
        answers = _ask(shell, _present(shell, names))
        screen.show(_json(answers), [*table(answers), *_details(shell, answers)])
        shown += 1
        if arguments.count is not None and shown >= arguments.count:
            return None
        screen.wait(begin)


def _show_once(shell: Shell, names: Sequence[str]) -> Optional[int]:
    snapshot = shell.client.get_graph()
    present = [name for name in names if snapshot.nodelet(name) is not None]
    for name in names:
        if name not in present:
            shell.error(unknown_nodelet(name, snapshot))
    if names and not present:
        return FAILED
    answers = _ask(shell, present or [each.name for each in snapshot.nodelets])
    for answer in answers.values():
        if isinstance(answer, DyKnowError):
            shell.error(answer)
    shell.show(_json(answers), [*table(answers), *_details(shell, answers)])
    silent = any(isinstance(answer, DyKnowError) for answer in answers.values())
    return FAILED if silent or len(present) < len(names) else None


def _present(shell: Shell, names: Sequence[str]) -> List[str]:
    return list(names) or [each.name for each in shell.client.get_graph().nodelets]


def _ask(shell: Shell, names: Sequence[str]) -> Dict[str, Answer]:
    """Ask all nodelets at the same time: one that hangs does not delay the others."""

    def ask(name: str) -> Tuple[str, Answer]:
        try:
            return name, shell.client.get_statistics(name)
        except (Refused, NodeletUnreachable) as error:
            return name, error

    unique = list(dict.fromkeys(names))
    with ThreadPoolExecutor(max_workers=min(_WORKERS, max(1, len(unique)))) as pool:
        return dict(pool.map(ask, unique))


def _json(answers: Dict[str, Answer]) -> dict[str, object]:
    return {
        "nodelets": [
            statistics_json(name, answer)
            for name, answer in answers.items()
            if not isinstance(answer, DyKnowError)
        ],
        "silent": [name for name, answer in answers.items() if isinstance(answer, DyKnowError)],
    }


def table(answers: Dict[str, Answer]) -> List[str]:
    """Write a line of statistics for each port; times in milliseconds."""
    rows: List[Tuple[str, ...]] = [_HEAD]
    for name, answer in answers.items():
        if isinstance(answer, DyKnowError):
            rows.append((name, "(does not answer)", *[""] * 9))
            continue
        errors = _count(answer.callback_errors)
        if not answer.ports:
            rows.append((name, "(no ports)", *[""] * 7, errors, ""))
        for port in sorted(answer.ports, key=lambda port: port.port):
            rows.append(
                (
                    name,
                    port.port,
                    port.direction,
                    "-" if port.rate is None else f"{port.rate:.1f}",
                    _count(port.messages),
                    _count(port.dropped) if port.direction == IN else "-",
                    _count(port.dropped) if port.direction == OUT else "-",
                    _milliseconds(port.mean_callback),
                    _milliseconds(port.max_callback),
                    errors,
                    port.topic or "-",
                )
            )
    return columns(rows, right=(3, 4, 5, 6, 7, 8, 9))


def _details(shell: Shell, names: Collection[str]) -> List[str]:
    nodelets = shell.client.get_graph().nodelets
    return [
        f"{each.name}: {each.detail}" for each in nodelets if each.detail and each.name in names
    ]


def _count(number: Optional[int]) -> str:
    return "-" if number is None else str(number)


def _milliseconds(duration: Optional[float]) -> str:
    return f"{duration * 1000:.2f}" if duration else "-"


COMMANDS = (
    Command(
        "stats",
        "show the rates of the ports",
        "Show the traffic of the ports: rate in Hz, messages since the nodelet was loaded, "
        "messages that were DROPPED from the full queue of an in-port, or are UNSENT because an "
        "out-port was disconnected, mean and longest callback of an in-port in ms, and the number "
        "of callback errors of the nodelet.",
        "dyknow stats\ndyknow stats camera undistort\ndyknow stats --watch\n"
        "dyknow stats --watch 0.5 --count 10 --json",
        _arguments,
        _stats,
        _problem,
    ),
)
