# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The client of the command line on a manager without ROS, and a way to run commands with it."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import re
import shlex
from dataclasses import dataclass
from typing import Any, Callable, Collection, Sequence

from clocks import HandClock
from rosmaster.paramserver import ParamDictionary
from transcripts import steps
from unit.manager.world import LIBRARY, World

from dyknow.cli.main import execute, parse
from dyknow.cli.shell import Shell
from dyknow.errors import DyKnowError, NodeletUnreachable
from dyknow.model.graph import Model, NodeletStatus
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.model.streams import StreamEvent
from dyknow.model.transformation import IN, OUT
from dyknow.ros.shell.load_meter import Loads
from dyknow.simulated import SimulatedManagerClient

#: Methods that change nothing, whose calls are not noted.
_QUESTIONS = (
    "get_model",
    "get_graph",
    "get_config",
    "get_statistics",
    "nodelet_managers",
    "list_hosts",
    "list_streams",
    "find_bindings",
)


class FakeClient(SimulatedManagerClient):
    """Stands for a `ShellClient`, with the manager of a `World`.

    Attributes:
        calls: the requested changes, in order.
        fail: called before each of them with its name and subject; may raise.
        asked: called with the name of each method that calls the manager or a nodelet.
        hung: nodelets that do not answer.
        ordinary: topics that ordinary nodes publish on.
        links: transports to other processes, by node, direction and topic.
        loaded: the loads of nodelets, and of their processes.
    """

    namespace = "/"

    def __init__(self, world: World) -> None:
        super().__init__(world.host, HandClock(), now=lambda: 0.0)
        world.manager = self.core
        self.core.add_transformation(LIBRARY)
        self.world = world
        self.fail: Callable[[str, str], None] = lambda call, subject: None
        self.asked: Callable[[str], None] = lambda method: None
        self.hung: set[str] = set()
        self.uncounted: set[str] = set()
        self.ordinary: set[str] = set()
        #: Black boxes, and the bag that each writes; an error for one that cannot.
        self.boxes: dict[str, str | DyKnowError] = {}
        self.links: dict[tuple[str, str, str], list[str]] = {}
        self.loaded = Loads({}, {})
        #: Steps that happen, one after the other, while a command waits for events.
        self.script: list[Callable[[], object]] = []

    def black_boxes(self) -> list[str]:
        return sorted(self.boxes)

    def write_bag(self, nodelet: str) -> str:
        found = self.boxes.get(nodelet, NodeletUnreachable("it offers no such service"))
        if isinstance(found, DyKnowError):
            raise found
        return found

    def get_statistics(self, nodelet: str) -> NodeletStatistics:
        ports = self.get_config(nodelet)
        counted = (None,) * 6 if nodelet in self.uncounted else (2, 300, 4, 5.0, 0.001, 0.0025)
        return NodeletStatistics(
            60.0,
            1,
            counted[0],
            tuple(
                PortStatistics(port.name, port.direction, port.topic, *counted[1:])
                for port in ports
            ),
        )

    def transports(self, nodes: Collection[str]) -> dict[tuple[str, str, str], list[str]]:
        return {key: names for key, names in self.links.items() if key[0] in nodes}

    def loads(self, nodelets: Sequence[NodeletStatus]) -> Loads:
        nodes = {each.node for each in nodelets}
        processes = {name: each for name, each in self.loaded.processes.items() if name in nodes}
        return self.loaded._replace(processes=processes)

    def stream_events(self) -> FakeEvents:
        return FakeEvents(self)

    def wait_for_model(self, condition: Callable[[Model], bool]) -> Model | None:
        model = self.get_graph()
        return model if condition(model) else None

    def managers(self) -> list[str]:
        return ["/dyknow_manager"]

    def datatypes(self) -> dict[str, str]:
        return {"/rosout": "rosgraph_msgs/Log"}

    def stored_parameters(self, nodelet: str, parameters: Sequence[str]) -> dict[str, Any]:
        server = ParamDictionary(None)
        for key, value in self.world.host.parameters.items():
            server.set_param(key, copy.deepcopy(value))
        keys = {name: f"{nodelet}/{name}" for name in parameters}
        return {name: server.get_param(key) for name, key in keys.items() if server.has_param(key)}

    def topics_in_use(self) -> tuple[frozenset[str], frozenset[str]]:
        ports = [port for each in self.host.running for port in self.host.ports(each)]
        published = {each.topic for each in ports if each.direction == OUT}
        heard = {each.topic for each in ports if each.direction == IN}
        return frozenset((self.ordinary | published) - {""}), frozenset(heard - {""})

    def is_nodelet(self, name: str) -> bool:
        return name in self.host.running

    def is_own_manager(self, name: str) -> bool:
        return name.startswith("/fake_")

    def _note(self, method: str, subject: str) -> None:
        self.asked(method)
        if method not in _QUESTIONS:
            call = method.replace("_stream", "")
            self.calls.append((call, subject))
            self.fail(call, subject)

    def _check_runs(self, nodelet: str) -> None:
        if nodelet in self.hung:
            raise NodeletUnreachable(f"nodelet '{nodelet}' did not answer within 5 s")
        if nodelet not in self.host.running:
            raise NodeletUnreachable(f"nodelet '{nodelet}' does not answer")


class FakeEvents:
    """Events of the reconciler; plays the client's script while it is waited for, then Ctrl-C."""

    def __init__(self, client: FakeClient) -> None:
        self.waiting: list[StreamEvent] = []
        self._client = client
        client.on_event = self.waiting.append

    def next(self, timeout: float) -> StreamEvent | None:
        if self.waiting:
            return self.waiting.pop(0)
        if not self._client.script:
            raise KeyboardInterrupt
        self._client.script.pop(0)()
        return None

    def close(self) -> None:
        self._client.on_event = lambda event: None


@dataclass(frozen=True)
class Outcome:
    """The exit code and the output of a command."""

    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()

    @property
    def json(self) -> Any:
        return json.loads(self.out)


def run(client: FakeClient | None, line: str) -> Outcome:
    """Run a command line; without `dyknow` at its beginning."""
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(err):  # of the parser
            arguments = parse(shlex.split(line))
            shell = Shell(lambda: client, arguments.json, out, err)  # type: ignore[arg-type,return-value]
            code = execute(arguments, shell)
    except SystemExit as end:
        code = int(str(end))
    return Outcome(code, out.getvalue(), err.getvalue())


def play(client: FakeClient | None, transcript: str) -> None:
    """Run command lines, and compare all that they print with a transcript.

    A line that begins with ``$`` is run. Below it is its output, then its error output,
    then its exit code in brackets unless that is 0. ``...`` stands for any text.
    """
    for step in steps(transcript):
        outcome = run(client, step.line)
        code = f"[{outcome.code}]" if outcome.code else ""
        printed = (outcome.out + outcome.err + code).rstrip() + "\n" * bool(step.printed)
        assert re.fullmatch(step.pattern, printed), f"$ {step.line}\n{printed}"


def cases(table: str) -> list[list[str]]:
    """The rows of a table, one a line, with its columns between bars."""
    return [line.split(" | ") for line in table.strip("\n").splitlines()]
