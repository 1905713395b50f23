# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`acquire`: asks for a stream, and holds it."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import socket
import time
from typing import TYPE_CHECKING, Any, Iterable

from dyknow.cli import completion
from dyknow.cli.arguments import SEVERAL, argument, flag, seconds_or_none, some_text
from dyknow.cli.output import event_json, stream_json
from dyknow.cli.shell import FAILED, Shell, command
from dyknow.errors import DyKnowError, ManagerUnreachable, StreamRefused
from dyknow.model.streams import Acquisition, StreamRequest, StreamStatus

if TYPE_CHECKING:
    from dyknow.ros.shell.shell_client import EventReader


_FIELDS = dataclasses.fields(StreamRequest)
#: The arguments of a request; most are fields of one.
DEMAND = (
    argument("tag", "TAG", "the tag of the stream, such as 'FieldPosition(ball)'"),
    argument(
        "--datatype",
        "TYPE",
        "the ROS type of the stream, such as geometry_msgs/PointStamped (default: any)",
    ),
    argument("--exclude", "LABEL", "transformations that must not be used", **SEVERAL),
    argument(
        "--min-rate", "HZ", "how many messages a second there have to be (default: any number)"
    ),
    argument(
        "--max-age",
        "SECONDS",
        "how old messages may be when they are sent, by their headers' stamps (default: any age)",
    ),
    argument(
        "--require",
        "FORMULA",
        "what has to hold of the messages, which are `it`, such as 'it.covariance[0] < 0.1'",
    ),
    *(
        argument(
            option,
            "NAME",
            f"{what}: transformations by label, or concepts of their tags",
            completer=completion.labels,
            type=some_text,
            **SEVERAL,
        )
        for option, what in (
            ("--prefer", "use these where there is a choice"),
            ("--avoid", "use these only where there is no choice"),
        )
    ),
    argument("--budget", "SECONDS", "how long the plan may be improved (default: 0.1 s)"),
)


def request_of(arguments: argparse.Namespace) -> StreamRequest:
    """Make the request from the arguments; the client is this process."""
    fields = {each.name: getattr(arguments, each.name, None) for each in _FIELDS}
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in fields.items()
        if value or name == "tag"
    }
    client = f"dyknow acquire on {socket.gethostname()} ({os.getpid()})"
    return StreamRequest(**{**given, "client_id": client, "lease": _LEASE})


#: Seconds that a claim outlives a command that was killed, or interrupted before the answer.
_LEASE = 10.0
_RENEWAL = 3.0
_RETRY = 1.0  # seconds before the next question to a manager that did not answer


@command(
    "Ask for a stream by its tag. Missing nodelets are spawned and connected, and maintained "
    "while the command runs; each change of state is printed. Ctrl-C releases the stream.",
    "dyknow acquire 'FieldPosition(ball)'\n"
    "dyknow acquire 'Undistorted(?camera)' --datatype sensor_msgs/Image --max-silence 1\n"
    "dyknow acquire 'FieldPosition(ball)' --wait --json\n"
    "dyknow acquire 'FieldPosition(ball)' --lease 60",
    *DEMAND,
    argument(
        "--max-silence",
        "SECONDS",
        "how long the stream may be silent before it is repaired (default: repair only what died)",
    ),
    flag("--wait", "wait if the stream cannot be made now, until it can"),
    argument(
        "--lease",
        "SECONDS",
        "do not hold the stream: leave a claim that lasts so long (0: until 'release')",
        type=seconds_or_none,
    ),
)
def _acquire(arguments: argparse.Namespace, shell: Shell) -> int | None:
    if arguments.lease is not None:
        claim, answer = _ask(arguments, shell)
        shell.show(_acquired_json(claim, answer), _describe(claim, answer))
        return None
    events = shell.client.stream_events()  # before the claim is made: no event is missed
    claim, answer = _ask(arguments, shell)
    try:
        lines = [*_describe(claim, answer), "held until Ctrl-C"]
        shell.show(_acquired_json(claim, answer), lines, indent=None)
        return _hold(shell, claim.claim_id, events)
    except KeyboardInterrupt:
        try:
            shell.client.release_stream(claim.claim_id)
        except ManagerUnreachable as error:
            shell.warn(f"{error}; claim {claim.claim_id} ends with its lease")
            return None
        shell.show({"released": claim.claim_id}, [f"released {claim.claim_id}"], indent=None)
        return None


def _ask(arguments: argparse.Namespace, shell: Shell) -> tuple[StreamStatus, Acquisition | None]:
    """Ask for the stream; returns its claim, and the answer unless it waits."""
    answer: Acquisition | None = None
    try:
        answer = shell.client.acquire_stream(request_of(arguments))
        for warning in answer.warnings:
            shell.warn(warning)
        claim_id = answer.claim_id
    except StreamRefused as error:
        if not error.claim_id:
            raise
        if not arguments.wait:
            shell.client.release_stream(error.claim_id)
            raise error.given_up() from error
        claim_id = error.claim_id
    if arguments.lease is not None:
        shell.client.renew_stream(claim_id, arguments.lease)
    for each in shell.client.list_streams():
        if each.claim_id == claim_id:
            return each, answer
    raise DyKnowError(f"claim {claim_id} has ended already")


def _hold(shell: Shell, claim_id: str, events: EventReader) -> int:
    """Renew a lease and print the events of a claim until it ends; return the exit code.

    Raises:
        Refused: the claim has ended meanwhile.
    """
    renewal = time.monotonic()  # at once: the connection that this makes needs the master
    while True:
        try:
            event = events.next(max(0.0, renewal - time.monotonic()))
        except ManagerUnreachable as error:
            shell.warn(f"{error}; waiting for it")
            events.close()
            events = _wait_for_manager(shell, claim_id)
            continue
        # Its first state was printed.
        if event is not None and event.before is not None and event.after.claim_id == claim_id:
            clock = time.strftime("%H:%M:%S", time.localtime(event.stamp))
            line = f"{clock} {event.after.state.name.lower()}: {event.reason}"
            shell.show(event_json(event), [line], indent=None)
            if event.after.state.ended:
                return FAILED
        if time.monotonic() >= renewal:
            renewal = time.monotonic() + _RETRY
            with contextlib.suppress(ManagerUnreachable):  # its end breaks the connection, too
                shell.client.renew_stream(claim_id, _LEASE)
                renewal = time.monotonic() + _RENEWAL


def _wait_for_manager(shell: Shell, claim_id: str) -> EventReader:
    """Renew the lease of a claim once the manager, which stores it, is back."""
    while True:
        time.sleep(_RETRY)
        with contextlib.suppress(ManagerUnreachable):
            shell.client.renew_stream(claim_id, _LEASE)
            events = shell.client.stream_events()
            shell.warn("the manager is back")
            for claim in shell.client.list_streams():
                if claim.claim_id == claim_id:
                    shell.show(stream_json(claim), _describe(claim), indent=None)
            return events


def _acquired_json(claim: StreamStatus, answer: Acquisition | None) -> dict[str, Any]:
    """Write the claim and the cost of its plan, which is null while the claim waits."""
    cost, least_cost = (None, None) if answer is None else (answer.cost, answer.least_cost)
    return {**stream_json(claim), "cost": cost, "least_cost": least_cost}


def _describe(claim: StreamStatus, answer: Acquisition | None = None) -> Iterable[str]:
    place = f"on {claim.topic} [{claim.datatype or 'unknown type'}]" if claim.topic else ""
    yield f"{claim.tag} {place or f'is {claim.state.name.lower()}: {claim.detail}'}"
    yield f"  claim {claim.claim_id}"
    if claim.bindings:
        yield f"  with {', '.join(claim.bindings)}"
    if answer is not None:
        is_proven = answer.cost <= answer.least_cost
        how_good = "proven least" if is_proven else f"least possible: {answer.least_cost:.0f}"
        yield f"  cost {answer.cost:.0f} ({how_good})"
    if place and claim.detail:
        yield f"  {claim.detail}"
    if claim.nodelets:
        yield f"  nodelets {' '.join(claim.nodelets)}"
