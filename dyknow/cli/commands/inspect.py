# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`list`, `info`, `stats` and `doctor`: nodelets, their traffic, and the system's defects."""

from __future__ import annotations

import argparse
import collections
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from typing import TYPE_CHECKING, Iterator, Sequence, Union

from dyknow.cli.arguments import argument, flag
from dyknow.cli.output import (
    Json,
    Screen,
    Transports,
    columns,
    count,
    host_json,
    host_table,
    nodelet_json,
    state_of,
    statistics_json,
    unknown_nodelet,
)
from dyknow.cli.shell import FAILED, Shell, command
from dyknow.errors import DyKnowError, NodeletUnreachable, Refused
from dyknow.model.graph import Model, NodeletStatus
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.model.transformation import IN, OUT
from dyknow.wiring.ports import by_name

if TYPE_CHECKING:
    from dyknow.ros.shell.load_meter import Loads

_LOAD = ("CPU %", "MEMORY MB")  # titles of what a nodelet or a process takes


@command(
    "List the nodelets that the manager knows of, one name a line, or the hosts that they run on.",
    "dyknow list\ndyknow list -l\ndyknow list /robot\ndyknow list --hosts\n"
    "dyknow list --json | jq -r '.nodelets[] | select(.state != \"running\") | .name'",
    argument("namespace", "NS", "list only nodelets of this namespace", nargs="?"),
    flag("-l --long", "show transformation, state, ports, load, manager, and the processes' load"),
    flag("--hosts", "list the hosts: what runs there, their load, and their clocks"),
)
def _list(arguments: argparse.Namespace, shell: Shell) -> None:
    if arguments.hosts:
        if arguments.namespace or arguments.long:
            arguments.refuse("--hosts lists hosts; expected it without a namespace and --long")
        hosts = shell.client.list_hosts()
        shell.show({"hosts": [host_json(each) for each in hosts]}, host_table(hosts, time.time()))
        return
    nodelets = shell.graph(arguments.namespace).nodelets
    value: Json = {"nodelets": [nodelet_json(each) for each in nodelets]}
    if not arguments.long:
        shell.show(value, [each.name for each in nodelets])
        return
    loads = shell.client.loads(nodelets)
    for each in value["nodelets"]:
        load = loads.nodelets.get(each["name"])
        each["load"] = load and load._asdict()
    value["processes"] = [
        {"name": name, "cpu": cpu, "memory": memory}
        for name, (cpu, memory) in loads.processes.items()
    ]
    shell.show(value, [*_long_list(nodelets, loads), *_load_table(loads)])


def _long_list(nodelets: Sequence[NodeletStatus], loads: Loads) -> list[str]:
    head = ("NODELET", "TRANSFORMATION", "STATE", "IN", "OUT", "BUSY %", *_LOAD, "MANAGER")
    rows: list[tuple[object, ...]] = [head]
    for each in nodelets:
        directions = [port.direction for port in each.ports]
        marks = (
            ",outdated" * bool(each.outdated)
            + ",protected" * each.is_protected
            + ",isolated" * each.isolated
        )
        ends = directions.count(IN), directions.count(OUT)
        load = loads.nodelets.get(each.name)
        busy, cpu, memory = load or (None, None, None)
        taken = (_percent(busy), _percent(cpu), _megabytes(memory))
        state = state_of(each) + marks
        rows.append((each.name, each.origin, state, *ends, *taken, each.manager or None))
    details = [f"{each.name}: {each.detail}" for each in nodelets if each.detail]
    return [*columns(rows, right=(3, 4, 5, 6, 7)), *details]


def _load_table(loads: Loads) -> list[str]:
    """Write the share of a core and the bytes of memory that each process takes."""
    rows: list[tuple[object, ...]] = [("PROCESS", *_LOAD)]
    rows += [
        (name, _percent(cpu), _megabytes(memory))
        for name, (cpu, memory) in loads.processes.items()
    ]
    return ["", *columns(rows, right=(1, 2))] if len(rows) > 1 else []


def _percent(share: float | None) -> str | None:
    return None if share is None else f"{100 * share:.0f}"


def _megabytes(memory: int | None) -> int | None:
    return None if memory is None else memory // 10**6


@command(
    "Show nodelets: transformation, manager, state, and each port with its type, topic, "
    "tags and the ports at the other end.",
    "dyknow info camera\ndyknow info camera undistort\ndyknow info camera --json",
    argument("names", "NAME", "a nodelet", nargs="+"),
)
def _info(arguments: argparse.Namespace, shell: Shell) -> int | None:
    snapshot = shell.client.get_graph()
    present = _named(shell, arguments.names, snapshot)
    if present or len(arguments.names) > 1:
        lines = (line for nodelet in present for line in _describe(nodelet, snapshot))
        shell.show({"nodelets": [nodelet_json(nodelet) for nodelet in present]}, lines)
    return None if len(present) == len(arguments.names) else FAILED


def _named(shell: Shell, names: Sequence[str], snapshot: Model) -> list[NodeletStatus]:
    """Return the nodelets of these names; the other names are reported."""
    wanted = [shell.resolve(name) for name in names]
    for name in wanted:
        if snapshot.nodelet(name) is None:
            shell.error(unknown_nodelet(name, snapshot))
    return [nodelet for nodelet in map(snapshot.nodelet, wanted) if nodelet is not None]


def _describe(nodelet: NodeletStatus, snapshot: Model) -> Iterator[str]:
    yield "-" * 80
    yield f"Nodelet [{nodelet.name}]"
    yield f"Transformation: {nodelet.transformation or '(none)'}"
    if nodelet.owner:
        yield f"Owner: {nodelet.owner}"
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
    for direction, title, to in ((IN, "In-ports", "from"), (OUT, "Out-ports", "to")):
        yield ""
        ports = [port for port in by_name(nodelet.ports) if port.direction == direction]
        yield f"{title}:" if ports else f"{title}: none"
        for port in ports:
            yield f" * {port.name} [{port.datatype or 'unknown type'}]"
            yield f"    topic: {port.topic or '(disconnected)'}"
            for tag in port.tags:
                yield f"    tag: {tag}"
            for other in snapshot.nodelets if port.topic else ():
                for end in other.ports:
                    if end.topic == port.topic and end.direction != direction:
                        yield f"    {to}: {other.name}:{end.name}"
    yield ""


_WORKERS = 16
_PERIOD = 1.0

_HEAD = (
    *("NODELET", "PORT", "", "HZ", "MESSAGES", "DROPPED", "UNSENT"),
    *("MEAN", "MAX", "ERRORS", "TOPIC", "OUTSIDE"),
)

#: The statistics of a nodelet, or the error; None for a nodelet that has no ports and no proxy.
Answer = Union["NodeletStatistics", DyKnowError, None]


@command(
    "Show the traffic of the ports: rate in Hz, messages since the nodelet was loaded, "
    "messages that were DROPPED from the full queue of an in-port, or are UNSENT because an "
    "out-port was disconnected, mean and longest callback of an in-port in ms, and the number "
    "of callback errors of the nodelet.",
    "dyknow stats\ndyknow stats camera undistort\ndyknow stats --watch\n"
    "dyknow stats --watch 0.5 --count 10 --json",
    argument("names", "NAME", "nodelets (default: all)", nargs="*"),
    argument(
        "-w --watch",
        "SECONDS",
        f"repeat every SECONDS (default: {_PERIOD:g}) until Ctrl-C",
        nargs="?",
        const=_PERIOD,
    ),
    argument("-n --count", "N", "with --watch: end after N times"),
)
def _stats(arguments: argparse.Namespace, shell: Shell) -> int | None:
    if arguments.watch is None:
        if arguments.count is not None:
            arguments.refuse("--count says how often --watch shows; expected both, or neither")
        return _show_once(shell, arguments.names)
    names = [shell.resolve(name) for name in arguments.names]
    screen = Screen(shell)
    shown = 0
    while True:
        begin = time.monotonic()
        snapshot = shell.client.get_graph()
        screen.show(*_counts(shell, _ask(shell, snapshot, names)))
        shown += 1
        if arguments.count is not None and shown >= arguments.count:
            return None
        time.sleep(max(0.0, begin + arguments.watch - time.monotonic()))


def _show_once(shell: Shell, names: Sequence[str]) -> int | None:
    snapshot = shell.client.get_graph()
    present = [each.name for each in _named(shell, names, snapshot)]
    if names and not present:
        return FAILED
    answers = _ask(shell, snapshot, present)
    silent = [answer for answer in answers.values() if isinstance(answer, DyKnowError)]
    for error in silent:
        shell.error(error)
    shell.show(*_counts(shell, answers))
    return FAILED if silent or len(present) < len(names) else None


def _ask(shell: Shell, snapshot: Model, names: Sequence[str]) -> dict[str, Answer]:
    """Ask these nodelets, or all, at the same time, so that none waits for one that hangs."""
    portless = {each.name for each in snapshot.nodelets if not each.ports}

    def ask(name: str) -> tuple[str, Answer]:
        try:
            return name, shell.client.get_statistics(name)
        except (Refused, NodeletUnreachable) as error:
            return name, None if name in portless else error

    unique = list(dict.fromkeys(names or [each.name for each in snapshot.nodelets]))
    with ThreadPoolExecutor(_WORKERS) as pool:
        return dict(pool.map(ask, unique))


def _counts(shell: Shell, answers: dict[str, Answer]) -> tuple[Json, list[str]]:
    """Write statistics as JSON, and as a table with the details of their nodelets below."""
    nodelets = {each.name: each for each in shell.client.get_graph().nodelets}
    processes = {name: each.manager or name for name, each in nodelets.items()}
    found = shell.client.transports({processes.get(name, name) for name in answers})

    def transports(name: str, port: PortStatistics) -> list[str]:
        return sorted(found.get((processes.get(name, name), port.direction, port.topic), ()))

    value = {
        "nodelets": [
            statistics_json(name, answer, transports)
            for name, answer in answers.items()
            if answer and not isinstance(answer, DyKnowError)
        ],
        "silent": [name for name, answer in answers.items() if isinstance(answer, DyKnowError)],
    }
    details = [
        f"{each.name}: {each.detail}"
        for each in nodelets.values()
        if each.detail and each.name in answers
    ]
    return value, [*_statistics_table(answers, transports), *details]


def _statistics_table(answers: dict[str, Answer], transports: Transports) -> list[str]:
    """Write a line of statistics for each port; times in milliseconds."""
    rows: list[tuple[object, ...]] = [_HEAD]
    for name, answer in answers.items():
        if isinstance(answer, DyKnowError):
            rows.append((name, "(does not answer)", *[""] * 10))
            continue
        errors = answer.callback_errors if answer else None
        ports = answer.ports if answer else ()
        if not ports:
            rows.append((name, "(no ports)", *[""] * 7, errors, "", ""))
        for port in sorted(ports, key=lambda port: port.port):
            rows.append(
                (
                    name,
                    port.port,
                    port.direction,
                    None if port.rate is None else f"{port.rate:.1f}",
                    port.messages,
                    port.dropped if port.direction == IN else None,
                    port.dropped if port.direction == OUT else None,
                    _milliseconds(port.mean_callback),
                    _milliseconds(port.max_callback),
                    errors,
                    port.topic or None,
                    _counted(transports(name, port)) or None,
                )
            )
    return columns(rows, right=(3, 4, 5, 6, 7, 8, 9))


def _counted(words: Sequence[str]) -> str:
    counts = collections.Counter(words)
    return ", ".join(word if n == 1 else f"{n} {word}" for word, n in counts.items())


def _milliseconds(duration: float | None) -> str | None:
    return f"{duration * 1000:.2f}" if duration else None


@command(
    "Examine the system: names of hosts, dead registrations, processes that another ROS "
    "master knows, nodelets and streams that fail or hang, unknown sources "
    "and types, parameters that nothing reads, processes of another version, file "
    "descriptors and disks. Sources, types and the disk of the state are examined on the "
    "manager's machine alone. Nothing is changed. The exit code is 1 if anything was found.",
    "dyknow doctor\ndyknow doctor --quiet\n"
    "dyknow doctor --json | jq -r '.findings[] | select(.is_error) | .cure'",
    flag("-q --quiet", "do not list the checks without a finding"),
)
def _doctor(arguments: argparse.Namespace, shell: Shell) -> int | None:
    from dyknow.ros.shell.doctor import Doctor, Finding  # rospy takes its time to import

    shell.client.managers()  # without a ROS master there is nothing to examine
    found: dict[str, list[Finding]] = {}
    lines: list[str] = []
    for name, check in Doctor(shell.client).checks():
        try:
            found[name] = list(check())
        except (DyKnowError, LookupError) as error:
            found[name] = [Finding(name, f"cannot be examined: {error}", "run doctor again")]
        except Exception as error:  # a boundary: the other checks find what they find
            problem = f"cannot be examined: {type(error).__name__}: {error}"
            found[name] = [Finding(name, problem, "run doctor again; else report this")]
        if not found[name] and not arguments.quiet:
            lines.append(f"ok       {name}")
        for each in found[name]:
            lines.append(
                f"{'ERROR' if each.is_error else 'warning':7}  {each.subject}: {each.problem}"
            )
            lines.append(f"         cure: {each.cure}")
    findings = [each for several in found.values() for each in several]
    errors = sum(each.is_error for each in findings)
    lines.append(
        f"{count(len(found), 'check')}: {count(errors, 'error')}, "
        f"{count(len(findings) - errors, 'warning')}"
    )
    shell.show(
        {
            "checks": list(found),
            "findings": [
                {"check": name, **asdict(each)}
                for name, several in found.items()
                for each in several
            ],
        },
        lines,
    )
    return FAILED if findings else None
