# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A DyKnow manager in this process, without ROS: for tests, for pictures, and to try things out.

It is the real manager, planner and claims included, on nodelets that run nowhere. No message
flows; counts of ports are invented.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from dataclasses import replace
from typing import Callable, Iterable, Iterator, Mapping, Sequence

from dyknow import names
from dyknow.errors import DyKnowError, HostError, NodeletUnreachable, Refused
from dyknow.locks import turn_lock
from dyknow.manager.claim import ClaimEvent
from dyknow.manager.claims.answers import StreamAnswers, refusal_of, unknown_names
from dyknow.manager.claims.reconciler import open_reconciler
from dyknow.manager.graph import Graph
from dyknow.manager.library import Library
from dyknow.manager.specifications.tags import written_bindings
from dyknow.manager.store import Store
from dyknow.manager.supervision.lifecycle import ManagerContext
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import Model, ParameterSet, PortState, Restarted, SpawnRequest
from dyknow.model.hosts import HostStatus
from dyknow.model.statistics import NodeletCount, NodeletStatistics, PortCount, PortStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamEvent, StreamRequest, StreamStatus
from dyknow.model.transformation import IN, OUT, TOPIC, Added, Parameter, Transformation
from dyknow.periodic import STEADY, Clock, ControlLoop
from dyknow.simulated.host import FakeHost


class SimulatedHost(FakeHost):
    """Runs nodelets of every source: they have the ports that transformations declare."""

    def __init__(self, clock: Clock = STEADY) -> None:
        """Know the relay, which claims may need."""
        super().__init__({"dyknow/Relay": (("in", IN, "*"), ("out", OUT, "*"))}, clock.now)

    def learn(self, transformations: Iterable[Transformation]) -> None:
        """Take the ports of sources from their transformations."""
        for each in transformations:
            if each.type == TOPIC:
                self.topics.add(names.join("/", each.source))
            elif not each.is_described:
                ports = {port[0]: port for port in self.sources.get(each.source, ())}
                ports.update((port.name, port[:3]) for port in each.ports)
                self.sources[each.source] = tuple(ports.values())

    def _new_name(self) -> str:
        name = "/dyknow_nodelet_manager"
        candidates = (f"{name}_{number}" if number > 1 else name for number in itertools.count(1))
        return next(name for name in candidates if name not in self.processes)


class SimulatedClock(Clock):
    """Time that stands still; a wait on it returns at once, and moves it forward instead."""

    def __init__(self, time: float = 0.0) -> None:
        self.time = time

    def now(self) -> float:
        return self.time

    def wait(self, condition: threading.Condition, seconds: float | None) -> None:
        self.time += seconds or 0.0


class _Silent(HostError):
    """Nobody is there to answer."""


class SimulatedManagerClient(BaseManagerClient):
    """The client of a manager that is made with it; every method is safe from any thread.

    Attributes:
        host: runs the nodelets; faults are injected there.
        core: the manager itself.
        reconciler: keeps its claims.
        is_up: whether the manager answers.
        answers: cleared while every call waits for its answer.
        calls: requests in order: name of the method and its subject.
        rates: messages and lost messages a second of ports, by nodelet and port. In-ports that
            are not named receive all messages of their topic.
        samples: ages (s, None for unknown) and sizes (bytes) of messages, by nodelet and port.
        strains: share of the time that callbacks take, and the last error, by nodelet.
        on_model: called with the graph after each change, before the call that made it returns; it
            must not call the client.
        on_event: called in the same way with each event of a claim.
    """

    def __init__(
        self,
        host: FakeHost | None = None,
        clock: Clock = STEADY,
        now: Callable[[], float] = time.time,
    ) -> None:
        """Make a manager without transformations, by default on a host that runs every source.

        ``now`` returns the seconds on the clock of those who read when a lease ends.
        """
        self.manager = "/dyknow_manager"
        self.host = host or SimulatedHost(clock)
        self.is_up = True
        self.answers = threading.Event()
        self.answers.set()
        self.calls: list[tuple[str, str]] = []
        self._clock = clock
        self.rates: dict[tuple[str, str], tuple[float, float]] = {}
        self.samples: dict[tuple[str, str], tuple[float | None, int]] = {}
        self.strains: dict[str, tuple[float, str]] = {}
        self.on_model: Callable[[Model], None] | None = None
        self.on_event: Callable[[StreamEvent], None] = lambda event: None
        self._turn = turn_lock("simulated manager")
        self._altered: dict[str, dict[str, object]] = {}
        self._start = clock.now()
        store = Store(":memory:")
        self._loop = ControlLoop(clock=clock)
        graph = Graph(store, clock, self._on_change)
        manager = ManagerContext(
            self.host, store, Library(store), graph, clock=clock, run=self._loop.once
        )
        self.reconciler = open_reconciler(manager, self._pass, on_event=self._tell_event)
        self.core = self.reconciler.manager
        self.core.start()
        self._loop.add("observe", self.core.look, 0.0)
        self._loop.add("reconcile", self.reconciler.work, 0.0)
        self._answers = StreamAnswers(now, clock.now)

    def alter(self, name: str, **fields: object) -> None:
        """Show other fields of a nodelet, such as a ``state``, for as long as it is there."""
        self.core.graph.get(name)
        self._altered[name] = {**self._altered.get(name, {}), **fields}
        self._tell_model()

    def settle(self) -> None:
        """Let messages pass once, and the manager and its claims follow."""
        with self._turn:
            self._pass(0.0)
            self.core.look()
            for _ in self._loop.advance(self._clock.now()):
                pass
            self.reconciler.reconcile()

    def advance(self, seconds: float) -> None:
        """Let time pass on a ``SimulatedClock``: the manager works as its node does.

        Messages pass before each round.
        """
        assert isinstance(self._clock, SimulatedClock)
        with self._turn:
            end = self._clock.now() + seconds
            for moment in self._loop.advance(end):
                self._clock.time = max(self._clock.time, moment)
                self._pass(0.0)
            self._clock.time = max(self._clock.time, end)

    # The interface

    def add_transformation(self, specification: str) -> Added:
        with self._request("add_transformation", specification):
            found = self.core.add_transformation(specification)
            if isinstance(self.host, SimulatedHost):
                self.host.learn(found.transformations)
            labels = tuple(sorted({each.label for each in found.transformations}))
            return Added(labels, "\n".join(map(str, found.warnings)))

    def remove_transformation(self, label: str) -> None:
        with self._request("remove_transformation", label):
            self.core.remove_transformation(label)

    def spawn_nodelet(self, request: SpawnRequest) -> None:
        with self._request("spawn", request.name):
            self.core.spawn(request)

    def destroy(self, name: str) -> None:
        with self._request("destroy", name):
            self.core.destroy(name)
            self._altered.pop(self.core.resolve(name), None)

    def restart(self, name: str) -> Restarted:
        with self._request("restart", name):
            return self.core.restart(name)

    def set_parameter(self, name: str, parameter: Parameter) -> ParameterSet:
        with self._request("set_parameter", name):
            return self.core.set_parameter(name, parameter)

    def set_protection(self, name: str, is_protected: bool) -> None:
        with self._request("set_protection", name):
            self.core.set_protection(name, is_protected)

    def connect(self, moves: Sequence[tuple[str, Mapping[str, str]]]) -> None:
        with self._request("connect", ", ".join(name for name, _ in moves)):
            self.core.connect(moves)

    def get_model(self) -> Model:
        with self._request("get_model"):
            return self._show(self.core.get_model())

    def get_graph(self) -> Model:
        with self._request("get_graph"):
            return self._show(self.core.graph_model())

    def nodelet_managers(self) -> list[str]:
        with self._request("nodelet_managers"):
            states = self.host.states()
            return sorted(name for name, each in states.items() if not each.foreign)

    def list_hosts(self) -> tuple[HostStatus, ...]:
        with self._request("list_hosts"):
            return self.core.hosts()

    def get_config(self, nodelet: str) -> tuple[PortState, ...]:
        with self._request("get_config", nodelet):
            return self._ports(nodelet)

    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        with self._request("set_config", nodelet):
            space = names.parent(nodelet)
            topics = {
                port: names.resolve(names.check(topic, "topic"), space, nodelet) if topic else ""
                for port, topic in config.items()
            }
            self._check_runs(nodelet)
            self.host.connect(nodelet, topics)
            self.core.look()

    def get_statistics(self, nodelet: str) -> NodeletStatistics:
        with self._request("get_statistics", nodelet):
            age = self._clock.now() - self._start
            ports = tuple(self._port(nodelet, port, age) for port in self._ports(nodelet))
            return NodeletStatistics(age, 0, 0, ports)

    def counts(self) -> tuple[NodeletCount, ...]:
        """Return the counts of all nodelets that run, as the manager's node publishes them."""
        with self._request("counts"):
            age, found = self._clock.now() - self._start, []
            for name in self.host.running:
                ports = [self._port(name, port, age) for port in self.host.ports(name)]
                counts = {
                    each.port: PortCount(
                        each.messages or 0,
                        each.dropped or 0,
                        *self.samples.get((name, each.port), ()),
                    )
                    for each in ports
                }
                load, error = self.strains.get(name, (0.0, ""))
                found.append(NodeletCount(name, age, 0, counts, bool(error), error, load * age))
            return tuple(found)

    def acquire_stream(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        with self._request("plan_stream" if dry_run else "acquire_stream", request.tag):
            try:
                acquired = self.reconciler.acquire(request, dry_run)
            except DyKnowError as error:
                raise refusal_of(error) from error
            return self._answers.acquisition(acquired, unknown_names(self.core, request))

    def release_stream(self, claim_id: str) -> None:
        with self._request("release_stream", claim_id):
            self.reconciler.release(claim_id)

    def renew_stream(self, claim_id: str, lease: float) -> float:
        with self._request("renew_stream", claim_id):
            return self._answers.expires(self.reconciler.renew(claim_id, lease))

    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        with self._request("replan_stream", claim_id):
            return self._answers.replanned(self.reconciler.replan(claim_id, dry_run))

    def plan_stream(self, claim_id: str, exclude: Sequence[str]) -> Replanned:
        with self._request("plan_stream", claim_id):
            return self._answers.replanned(self.reconciler.plan(claim_id, exclude))

    def list_streams(self) -> tuple[StreamStatus, ...]:
        with self._request("list_streams"):
            return tuple(map(self._answers.status, self.reconciler.claims()))

    def find_bindings(self, tag: str, datatype: str = "") -> tuple[str, ...]:
        with self._request("find_bindings", tag):
            found, _ = self.reconciler.find_bindings(tag, datatype)
            return tuple(map(written_bindings, found))

    # Inside

    @contextlib.contextmanager
    def _request(self, method: str, subject: str = "") -> Iterator[None]:
        """Answer as a manager of the ROS graph does."""
        self._note(method, subject)
        with self._turn:
            try:
                yield
            except (Refused, NodeletUnreachable, _Silent):
                raise
            except DyKnowError as error:
                raise Refused(str(error)) from error

    def _note(self, method: str, subject: str) -> None:
        self.calls.append((method, subject))
        self.answers.wait()
        if not self.is_up:
            raise HostError(f"service {self.manager}/{method} is not there")

    def _ports(self, nodelet: str) -> tuple[PortState, ...]:
        self._check_runs(nodelet)
        return self.host.ports(nodelet)

    def _check_runs(self, nodelet: str) -> None:
        if nodelet not in self.host.running:
            raise _Silent(f"service {nodelet}/get_config is not there")

    def _on_change(self) -> None:
        self._loop.wake("reconcile")
        self._tell_model()

    def _pass(self, seconds: float) -> None:
        if isinstance(self._clock, SimulatedClock):
            self._clock.time += seconds
        self.host.flow()

    def _tell_model(self) -> None:
        if self.on_model is not None:
            self.on_model(self._show(self.core.graph_model()))

    def _tell_event(self, event: ClaimEvent) -> None:
        self.on_event(self._answers.event(event))

    def _show(self, model: Model) -> Model:
        if not self._altered:
            return model
        nodelets = tuple(
            replace(each, **self._altered.get(each.name, {}))  # type: ignore[arg-type]
            for each in model.nodelets
        )
        return replace(model, nodelets=nodelets)

    def _port(self, nodelet: str, port: PortState, age: float) -> PortStatistics:
        rate, lost = self.rates.get((nodelet, port.name), (0.0, 0.0))
        if port.direction == IN and port.topic and (nodelet, port.name) not in self.rates:
            topics = {name: self.host.ports(name) for name, _ in self.rates}
            rate = sum(
                self.rates.get((name, other.name), (0.0, 0.0))[0]
                for name, ports in topics.items()
                for other in ports
                if other.direction == OUT and other.topic == port.topic
            )
        counts = int(rate * age), int(lost * age)
        return PortStatistics(port.name, port.direction, port.topic, *counts, rate, 0.0, 0.0)
