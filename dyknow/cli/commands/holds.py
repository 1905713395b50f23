# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`holds`: evaluates a formula on streams, topics or a bag."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from typing import TYPE_CHECKING, Callable, Collection, Generator, Iterable, Mapping

from dyknow.cli.arguments import SEVERAL, argument, flag, seconds_or_none
from dyknow.cli.shell import FAILED, Shell, command
from dyknow.errors import DyKnowError
from dyknow.formulas import Formula, Truth, Verdict, parse

if TYPE_CHECKING:
    from dyknow.formulas import Monitor
    from dyknow.ros.acquiring import AcquiredStream

    MonitorOf = Callable[[Collection[str]], Monitor]

_POLL = 0.5  # seconds between two looks for a topic that is not there yet


@command(
    "Evaluate a formula of metric temporal logic, and print each change of its verdict. Its ports "
    "are topics (--topic), requested streams (--port) or topics of a bag (--bag); without these, "
    "a port is the topic of its name. It ends with Ctrl-C, after --for, or with the bag, and with "
    "exit code 1 if the formula was FALSE in any state.",
    "dyknow holds 'battery.percentage > 0.2' --topic battery=/battery\n"
    "dyknow holds 'historically[0 s, 5 s] battery.percentage > 0.2' --port 'battery=Battery(nao)' "
    "--why\n"
    "dyknow holds 'always norm(odom.twist.twist.linear) < 2' --bag run.bag\n"
    "dyknow holds 'every ?c: Camera (rate(image) > 5)' --port 'image=Image(?c: Camera)'",
    argument("formula", "FORMULA", "the formula, over ports"),
    argument(
        "--topic",
        "PORT=TOPIC",
        "a topic that is a port; with one port its name may be left out",
        **SEVERAL,
    ),
    argument(
        "--port",
        "PORT=TAG",
        "a port whose stream is requested from the manager, by its tag",
        **SEVERAL,
    ),
    argument("--bag", "FILE", "a bag in the place of live topics"),
    argument("--period", "SECONDS", "time between two states (default: 0.1)", default=0.1),
    argument(
        "--hold", "SECONDS", "how long a message has a value (default: until the next one comes)"
    ),
    argument(
        "--delay",
        "SECONDS",
        "how long a state waits for messages that come late (default: 0.1; of verdicts 0.5)",
        type=seconds_or_none,
    ),
    flag("--exact", "reason with all that unknown values could be"),
    argument("--for", "SECONDS", "end after so long", dest="seconds"),
    flag("--why", "print the values that decided"),
    flag("--all", "print the verdict about each state, not only changes"),
)
def _holds(arguments: argparse.Namespace, shell: Shell) -> int | None:
    if arguments.bag and arguments.port:
        arguments.refuse("--bag has topics of its own: --port is for live streams")
    if arguments.bag and arguments.seconds:
        arguments.refuse("--bag ends by itself: --for is for live streams")
    formula = parse(arguments.formula)
    # To be refused at once: the real one, made when the types are known, has the same bounds.
    formula.monitor(arguments.period, arguments.hold, arguments.delay or 0.0, arguments.exact)
    monitors: list[Monitor] = []

    def monitor(datatypes: Collection[str]) -> Monitor:
        from dyknow.ros.formulas.message_types import usual_delay

        delay = usual_delay(datatypes) if arguments.delay is None else arguments.delay
        made = formula.monitor(arguments.period, arguments.hold, delay, arguments.exact)
        monitors.append(made)
        return made

    topics, tags = (_named(formula, each) for each in (arguments.topic, arguments.port))
    counts = dict.fromkeys(Truth, 0)
    if arguments.bag:
        verdicts = _of_bag(arguments.bag, formula, monitor, topics)
    else:
        verdicts = _live(shell, formula, monitor, topics, tags, arguments.seconds)
    with contextlib.closing(verdicts), contextlib.suppress(KeyboardInterrupt):
        for verdict in verdicts:
            counts[verdict.value] += 1
            if arguments.all or verdict.stamp == verdict.since:
                _print(shell, verdict, arguments.why)
    if not shell.as_json:
        false, unknown = counts[Truth.FALSE], counts[Truth.UNKNOWN]
        shell.error(f"FALSE in {false}, UNKNOWN in {unknown} of {sum(counts.values())} states")
    late = sum(each.late for each in monitors)
    if late:
        shell.error(f"{late} messages came too late for their states (--delay)")
    return FAILED if counts[Truth.FALSE] else None


def _named(formula: Formula, given: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Name the ports of arguments."""
    found = {}
    for port, value in given:
        if not port and len(formula.ports) > 1:
            ports = ", ".join(formula.ports)
            raise DyKnowError(f"'{value}' is for which port? Write PORT={value}, of {ports}")
        port = port or formula.ports[0]
        if port not in formula.ports:
            ports = ", ".join(formula.ports)
            raise DyKnowError(f"the formula has no port '{port}': its ports are {ports}")
        found[port] = value
    return found


def _print(shell: Shell, verdict: Verdict, with_why: bool) -> None:
    value = {
        "stamp": verdict.stamp / 1e9,
        "value": verdict.value.name,
        "since": verdict.since / 1e9,
        "why": verdict.why,
    }
    line = str(verdict if with_why else verdict._replace(why=""))
    shell.show(value, [line], indent=None)


def _of_bag(
    path: str, formula: Formula, monitor: MonitorOf, given: Mapping[str, str]
) -> Generator[Verdict, None, None]:
    from dyknow.ros.formulas.bags import Bag  # rosbag takes its time to import
    from dyknow.ros.formulas.message_types import check

    for variable in formula.variables:
        raise DyKnowError(
            f"a bag has no individuals {variable}: expected a formula without 'every' and 'some', "
            "or live streams"
        )
    bag = Bag(path)
    topics = {port: bag.topic(port, given) for port in formula.ports}
    datatypes = {port: bag.datatypes[topic] for port, topic in topics.items()}
    # Other types are checked with their first messages, which are as the bag defines them.
    check(formula, {port: each * bag.has_built(each) for port, each in datatypes.items()})
    shown = -1

    def show(seconds: float) -> None:
        nonlocal shown
        percent = int(100 * seconds / max(bag.duration, 1e-9))
        if percent != shown and sys.stderr.isatty():
            sys.stderr.write(f"\r{percent:3d} % of {path} \r")
            shown = percent

    yield from bag.verdicts(monitor(datatypes.values()), topics, show)


def _live(
    shell: Shell,
    formula: Formula,
    monitor: MonitorOf,
    topics: Mapping[str, str],
    tags: Mapping[str, str],
    duration: float | None,
) -> Generator[Verdict, None, None]:
    """Yield the verdicts about topics, and about streams that are held meanwhile."""
    from dyknow.ros.acquiring import acquire
    from dyknow.ros.formulas.individuals import IndividualStreams, tags_of_individuals
    from dyknow.ros.formulas.message_types import check, known_class
    from dyknow.ros.formulas.sources import LiveTopics

    streams = {
        port: shell.resolve(topics.get(port, port)) for port in formula.ports if port not in tags
    }
    for port in sorted(set(formula.of_individuals) & streams.keys()):
        raise DyKnowError(
            f"the port '{port}' has a stream for each individual: give its tag, as "
            f"--port '{port}=Image(?c: Camera)'"
        )
    of_individuals = {port: tags[port] for port in tags if port in formula.of_individuals}
    individual = tags_of_individuals(formula, of_individuals)
    client = shell.client
    if tags:
        client.list_streams()  # which says what to do where there is no manager
    latest = None if duration is None else time.monotonic() + duration
    datatypes = {port: _datatype(shell, port, topic, latest) for port, topic in streams.items()}
    check(formula, {port: datatypes.get(port, "") for port in formula.ports})
    deadline = None if duration is None else time.monotonic() + duration
    held: dict[str, AcquiredStream] = {}
    bindings: dict[str, Mapping[str, str]] = {}

    def is_over() -> bool:
        for port, stream in held.items():
            if stream.state.ended:
                why = stream.detail or stream.state.name.lower()
                raise DyKnowError(f"the stream {stream.tag} has ended: {why}")
            if bindings.setdefault(port, stream.bindings) != stream.bindings:
                bindings[port] = stream.bindings
                made.forget([port])  # it is that of another individual
        return deadline is not None and time.monotonic() >= deadline

    live = LiveTopics()
    with contextlib.ExitStack() as stack:
        for port, tag in tags.items():
            if port not in individual:
                stream = stack.enter_context(acquire(tag, manager=client.manager))
                streams[port], datatypes[port] = stream.topic, stream.datatype
                held[port] = stream
        check(formula, {port: datatypes.get(port, "") for port in formula.ports})
        for port, topic in streams.items():
            subscriber = live.subscribe(port, "", topic, known_class(datatypes[port]))
            stack.callback(subscriber.unregister)
        present: Callable[[], Mapping[str, list[str]] | None] = dict
        if individual:
            individuals = IndividualStreams(client, individual, {}, live.subscribe)
            stack.callback(individuals.close)
            present = individuals.present
        made = monitor(datatypes.values())
        yield from live.verdicts(made, present, is_over)


def _datatype(shell: Shell, port: str, topic: str, latest: float | None) -> str:
    """Return the ROS type of a topic; waits until ``latest`` for a publisher of it."""
    is_late = False
    while True:
        found = shell.client.datatypes().get(topic, "*")
        if found != "*" and topic in shell.client.topics_in_use()[0]:
            return found
        if latest is not None and time.monotonic() >= latest:
            raise DyKnowError(f"the topic {topic} of the port '{port}' is not published")
        if not is_late:
            shell.warn(f"the topic {topic} of the port '{port}' is not published: waiting for it")
            is_late = True
        time.sleep(_POLL)
