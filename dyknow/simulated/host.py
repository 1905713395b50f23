# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A host in memory, for whole scenarios without processes and without ROS."""

from __future__ import annotations

import builtins
import contextlib
import itertools
import time
from dataclasses import dataclass, field, replace
from typing import Any, Callable, Collection, Dict, Iterable, Iterator, Mapping, Sequence

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.errors import HostError, HostTimeout, NameTaken
from dyknow.locks import assert_no_state_lock
from dyknow.manager.host import (
    Count,
    Crash,
    HeardVerdict,
    Host,
    HostReport,
    Listening,
    LoadRequest,
    ProcessState,
    Reported,
    Usage,
)
from dyknow.manager.specifications.values import value_of
from dyknow.model.graph import NodeletKind, PortState
from dyknow.model.transformation import (
    FORMULA_CLASS,
    NODE,
    VERDICT,
    Parameter,
    Program,
    Transformation,
)


@dataclass
class FakeNodelet:
    """A nodelet in memory."""

    request: LoadRequest  # from its load
    ports: dict[str, PortState] = field(default_factory=dict)  # by name
    sent: dict[str, int] = field(default_factory=dict)  # messages by out-port
    #: Out-ports that keep a message for subscribers that connect later.
    latched: set[str] = field(default_factory=set)
    reconfigurations: int = 0  # how often its ports were connected elsewhere
    #: Ports that were connected before they show, whose topics are kept until then.
    kept: set[str] = field(default_factory=set)

    def topics(self, direction: str) -> list[str]:
        """Return the topics of its ``in``-ports or its ``out``-ports."""
        ports = self.ports.values()
        return [port.topic for port in ports if port.direction == direction and port.topic]


@dataclass
class FakeProcess:
    """A nodelet manager in memory, and its nodelets by name."""

    state: ProcessState
    nodelets: dict[str, FakeNodelet] = field(default_factory=dict)


class FakeListening(Listening):
    """Counts the messages of one topic; ``FakeHost.flow`` sends them."""

    def __init__(self, host: FakeHost, topic: str) -> None:
        self.topic = topic
        self.messages = 0
        self._host = host

    def count(self) -> Count | None:
        now = self._host.clock()
        return Count(self.messages, now, now, age=self._host.age_on(self.topic))

    def close(self) -> None:
        self._host.listeners.remove(self)


class FakeHost(Host):
    """Keeps everything in dictionaries; tests inject the faults.

    ``dividers`` and ``delays`` are by nodelet, type or ordinary topic; a nodelet's entry comes
    before that of its type.
    """

    def __init__(
        self,
        sources: Mapping[str, Sequence[tuple[str, str, str]]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Make a host without a nodelet manager.

        ``sources`` are the ports of each nodelet type, as (name, direction, datatype).
        """
        self.sources = {FORMULA_CLASS: (), **sources}
        self.clock = clock
        #: Types that are C++ nodelets, and whether nodelet managers for these are stock ones.
        self.cpp: set[str] = set()
        self.stock = False
        #: Programs that are Python scripts (others are C++ nodes), and those that end at once.
        self.scripts: set[str] = set()
        self.ending: set[str] = set()
        #: Ports of nodelet types that do not show until they have a subscriber.
        self.lazy: dict[str, Collection[str]] = {}
        self.topics: set[str] = set()  # ordinary topics that are published
        #: Nodelets, by name or type, and ordinary topics that send nothing.
        self.silent: set[str] = set()
        self.dividers: dict[str, int] = {}  # how many messages make one that is sent; 1 by default
        #: Seconds that are added to the age of messages; None for messages without a stamp.
        self.delays: dict[str, float | None] = {}
        #: Stopped nodelet managers that seem to be well until they are called.
        self.unnoticed: set[str] = set()
        self.unstamped: set[str] = set()  # ROS types without a header
        #: Nodelets whose connections and unloads fail with a timeout, and are made by ``arrive``.
        self.slow: set[str] = set()
        #: Code by source, and sources whose changed files cannot be run.
        self.code: dict[str, str] = {}
        self.broken: set[str] = set()
        self.reconfigurable: set[str] = set()  # nodelets that read their parameters while they run
        self.taken: dict[str, int] = {}  # bytes of memory by nodelet manager
        self.used: dict[str, Usage] = {}  # what nodelet managers have used
        self.details: dict[str, str] = {}  # problems by nodelet
        self.machine = ""  # the machine of the processes that are not external
        self.publishing: dict[str, str] = {}  # hosts of the nodes that publish on ordinary topics
        self.loaders: dict[str, str] = {}  # nodes that had nodelets loaded, by nodelet
        #: Nodelet managers that may still publish on topics of claims.
        self.leased: set[str] = set()
        #: Topics of verdicts that are followed, and the last verdict on each.
        self.followed: frozenset[str] = frozenset()
        self._heard: dict[str, HeardVerdict] = {}
        #: Called before each operation with its name and argument; may raise.
        self.fail: Callable[[str, str], object] = lambda operation, argument: None
        #: Called after each change of nodelets and connections.
        self.on_change: Callable[[], None] = lambda: None
        self.calls: list[tuple[str, str]] = []  # every operation, in order
        self.listeners: list[FakeListening] = []
        self.processes: dict[str, FakeProcess] = {}
        self.parameters: dict[str, object] = {}
        self._incarnations = itertools.count(1)
        self._hung: set[str] = set()
        self._crashes: list[Crash] = []
        self._cut: dict[str, ProcessState] = {}
        self._passed: dict[str, int] = {}
        self._ages: dict[str, float | None] = {}
        #: Connections of nodelets; None for an unload.
        self._on_the_way: list[tuple[FakeNodelet, dict[str, str] | None]] = []

    # Faults and other events

    def fail_at(
        self, operation: str, part: str = "", error: BaseException | str = "it is broken"
    ) -> None:
        """Let an operation fail from now on whenever its argument contains ``part``."""

        def fail(what: str, argument: str) -> None:
            if what == operation and part in argument:
                raise HostError(error) if isinstance(error, str) else error

        self.fail = fail

    def recover(self) -> None:
        """Let no operation fail any more."""
        self.fail = lambda operation, argument: None

    def kill(self, manager: str) -> None:
        """Kill a nodelet manager, and its nodelets with it, or a node."""
        process = self.processes[manager]
        process.nodelets.clear()
        self._hung.discard(manager)
        process.state = replace(process.state, incarnation="")
        if process.state.kind.is_node or process.state.foreign:
            del self.processes[manager]

    def reboot(self) -> None:
        """End every process, and all memory of them, as when the machine is started again."""
        self.processes.clear()
        self._hung.clear()
        self._crashes.clear()
        self._on_the_way.clear()

    def crash(
        self, manager: str, running: Iterable[str] | None = (), unloading: Iterable[str] = ()
    ) -> None:
        """Let a nodelet manager crash; ``running`` is None if it is not known whose code ran."""
        at_work = None if running is None else frozenset(map(names.mark, running))
        unloaded = frozenset(map(names.mark, unloading))
        incarnation = self.processes[manager].state.incarnation
        self._crashes.append(Crash(manager, "SIGSEGV", at_work, unloaded, incarnation))
        self.kill(manager)

    def hang(self, manager: str) -> None:
        """Stop a nodelet manager's process, as SIGSTOP does."""
        self._hung.add(manager)

    def wake(self, manager: str) -> None:
        """Let a stopped process go on; it answers the requests that came meanwhile."""
        self._hung.discard(manager)
        self.arrive()

    def may_publish(self, manager: str) -> bool:
        return manager in self.leased

    def is_hung(self, manager: str) -> bool:
        return manager in self._hung

    def arrive(self) -> builtins.list[str]:
        """Connect and unload what took too long, but not in stopped processes."""
        waiting, self._on_the_way = self._on_the_way, []
        arrived = []
        for nodelet, config in waiting:
            name = nodelet.request.name
            process = self._place_of(name)
            if process is None or process.nodelets[name] is not nodelet:
                continue
            if process.state.name in self._hung:
                self._on_the_way.append((nodelet, config))
                continue
            if config is None:
                del process.nodelets[name]
                self.on_change()
            else:
                self._apply(nodelet, config)
            arrived.append(name)
        return arrived

    def run_node(
        self, name: str, source: str, topics: Mapping[str, str], kind: NodeletKind
    ) -> None:
        """Start, or restart, a foreign node."""
        self.add(name, kind, foreign=True)
        nodelet = FakeNodelet(LoadRequest(name, source, kind=kind))
        for port, direction, datatype in self.sources[source]:
            nodelet.ports[port] = PortState(port, direction, datatype, topics.get(port, ""))
        self.processes[name].nodelets[name] = nodelet
        self.on_change()

    def add(
        self,
        manager: str,
        kind: NodeletKind = NodeletKind.PYTHON,
        machine: str = "",
        foreign: bool = False,
    ) -> None:
        """Start, or restart, an external nodelet manager, on a machine, or a foreign one."""
        state = self._state(manager, kind, own=False)
        state = replace(state, host=machine, foreign=foreign)
        self.processes[manager] = FakeProcess(state)

    def cut(self, manager: str, known: bool = True, unseen: bool = False) -> None:
        """Cut the network to a host, ``known`` or ``unseen`` since the manager's start."""
        self._cut[manager] = replace(
            self.processes[manager].state,
            incarnation=self.processes[manager].state.incarnation if known else "",
            responsive=False,
            away=True,
            unseen=unseen,
        )

    def mend(self, manager: str) -> None:
        del self._cut[manager]

    def flow(self) -> set[str]:
        """Send a message on each topic that is published; nodelets with input pass it on.

        Returns the topics on which a message was sent.
        """
        moving = {each for each in self.topics - self.silent if self._sends(each)}
        self._ages.update((each, self._aged([], each)) for each in moving)
        waiting = [
            (nodelet, nodelet.topics("in"), nodelet.topics("out"))
            for name, process in self.processes.items()
            for nodelet in process.nodelets.values()
            if not {nodelet.request.name, nodelet.request.source} & self.silent
            and name not in self._hung
        ]
        count = len(waiting) + 1
        while len(waiting) < count:
            count, left = len(waiting), []
            for nodelet, inputs, outputs in waiting:
                takes = any(port.direction == "in" for port in nodelet.ports.values())
                if (takes and not inputs) or not moving.issuperset(inputs):
                    left.append((nodelet, inputs, outputs))
                elif self._sends(nodelet.request.name, nodelet.request.source):
                    age = self._aged(inputs, nodelet.request.name, nodelet.request.source)
                    self._ages.update(dict.fromkeys(outputs, age))
                    moving.update(outputs)
                    for port in nodelet.ports.values():
                        if port.direction == "out" and port.topic:
                            nodelet.sent[port.name] = nodelet.sent.get(port.name, 0) + 1
            waiting = left
        for listener in self.listeners:
            listener.messages += listener.topic in moving
        return moving

    def _sends(self, name: str, kind: str = "") -> bool:
        """Whether one more message makes something send."""
        divider = self.dividers.get(name, self.dividers.get(kind, 1))
        passed = self._passed[name] = self._passed.get(name, 0) + 1
        return passed % divider == 0

    def _aged(self, inputs: Iterable[str], name: str, kind: str = "") -> float | None:
        """Age of what something sends that it makes of these topics."""
        delay = self.delays.get(name, self.delays.get(kind, 0.0))
        ages = [self._ages.get(topic) for topic in inputs]
        return None if delay is None else delay + max([age or 0.0 for age in ages], default=0.0)

    def age_on(self, topic: str) -> float | None:
        """Seconds by which the latest message of a topic was old when it was sent."""
        return self._ages.get(topic)

    def vanish(self, name: str) -> None:
        """Unload a nodelet behind the manager's back."""
        next(p for p in self.processes.values() if name in p.nodelets).nodelets.pop(name)

    def nodelet(self, name: str) -> FakeNodelet:
        process = self._place_of(name)
        if process is None:
            raise HostError(f"nodelet '{name}' does not run")
        return process.nodelets[name]

    @property
    def running(self) -> builtins.list[str]:
        """Names of all nodelets that run."""
        return sorted(name for process in self.processes.values() for name in process.nodelets)

    def publishers(self, topic: str) -> builtins.list[str]:
        """Names of the nodelets that publish on a topic and are not stopped."""
        return sorted(
            name
            for manager, process in self.processes.items()
            for name, nodelet in process.nodelets.items()
            if manager not in self._hung and topic in nodelet.topics("out")
        )

    # The host

    @property
    def here(self) -> str:
        return self.machine

    def publishing_hosts(self, topics: Iterable[str]) -> frozenset[str]:
        return frozenset(self.publishing[each] for each in topics if each in self.publishing)

    def kind_of(self, transformation: Transformation) -> NodeletKind:
        source = transformation.source
        if transformation.type == NODE:
            program = Program.of(source)
            if source not in self.sources:
                raise HostError(
                    f"package '{program.package}' has no program '{program.executable}'"
                )
            return NodeletKind.SCRIPT if source in self.scripts else NodeletKind.CPP_NODE
        if source not in self.sources:
            raise HostError(f"no package declares a nodelet type '{source}'")
        return NodeletKind.CPP if source in self.cpp else NodeletKind.PYTHON

    def states(self) -> dict[str, ProcessState]:
        hung = self._hung - self.unnoticed
        return {
            name: self._cut.get(name)
            or replace(self.processes[name].state, responsive=name not in hung)
            for name in sorted(self.processes)
        }

    def poll(self) -> HostReport:
        states = self.states()
        nodelets = {}
        for name in states:
            with contextlib.suppress(HostError):
                nodelets[name] = frozenset(self.list(name))
        return HostReport(states, nodelets, {each.incarnation: each for each in self._crashes})

    def look_for(self, manager: str) -> None:
        """Do nothing: nodelet managers are known as soon as they are there."""

    def ensure(self, kind: NodeletKind, isolated_for: str = "") -> str:
        if kind.is_node:
            return isolated_for
        self._step("ensure", isolated_for or kind.value)
        fitting = [
            state
            for state in self.states().values()
            if state.own
            and state.kind is kind
            and state.isolated_for == isolated_for
            and state.responsive
        ]
        fitting.sort(key=lambda state: not state.alive)
        for state in fitting:
            if not state.alive:
                self._start(state.name, kind, isolated_for)
        return fitting[0].name if fitting else self._start(self._new_name(), kind, isolated_for)

    def retire(self, manager: str) -> None:
        self._step("retire", manager)
        self.processes.pop(manager, None)

    def memory(self, manager: str) -> int:
        return self.taken.get(manager, 0)

    def renew(self, manager: str) -> None:
        self._step("renew", manager)
        state = self.processes[manager].state
        self.kill(manager)
        self._start(manager, state.kind, state.isolated_for)

    def code_of(self, manager: str, transformation: Transformation, anew: bool = False) -> str:
        return self.code.get(transformation.source, "")

    def check_code(self, transformation: Transformation) -> None:
        if transformation.source in self.broken:
            raise HostError(f"{transformation.source}: line 1: invalid syntax")

    def load(self, manager: str, request: LoadRequest, timeout: float) -> None:
        self._step("load", request.name)
        if request.kind.is_node:
            if manager in self.processes and self.processes[manager].state.alive:
                raise NameTaken(request.name, "running", "another node")
            if request.source in self.ending:
                raise HostError(f"node {request.name}: it ended at its start")
            self._start(manager, request.kind, manager)
        process = self._alive(manager)
        if request.name in process.nodelets:
            raise NameTaken(request.name)
        for parameter in request.parameters:
            self.parameters[f"{request.name}/{parameter.name}"] = value_of(parameter)
        nodelet = FakeNodelet(request)
        for name, direction, datatype in self._ports_of(request):
            key = names.resolve(name, names.parent(request.name), request.name)
            topic = request.remappings.get(key, "")
            if process.state.rewirable and topic.startswith(f"{request.name}/disconnected/"):
                topic = ""
            nodelet.ports[name] = PortState(name, direction, datatype, topic)
        process.nodelets[request.name] = nodelet
        self.on_change()
        self._step("loaded", request.name)

    def _ports_of(self, request: LoadRequest) -> Sequence[tuple[str, str, str]]:
        """List the ports of a nodelet; those of a formula are in its parameters."""
        if request.source != FORMULA_CLASS:
            return self.sources[request.source]
        given: Dict[str, Any] = {each.name: value_of(each) for each in request.parameters}
        ports = [(name, "in", datatype) for name, datatype in given["datatypes"].items()]
        return [*ports, (given.get("out", "holds"), "out", VERDICT)]

    def unload(self, manager: str, name: str) -> None:
        self._step("unload", name)
        process = self.processes.get(manager)
        if process is not None and process.state.kind.is_node:
            del self.processes[manager]
            self.on_change()
            return
        self._pop(manager, name)

    @contextlib.contextmanager
    def moving(self, name: str, source: str, target: str) -> Iterator[Callable[[], None]]:
        self._step("note", f"{name} in {source}")
        self._alive(source)
        self._step("park", f"{name} in {target}")
        self._alive(target)

        def hand_over() -> None:
            self._step("give", f"{name} in {source}")
            self._pop(source, name)

        yield hand_over

    def _pop(self, manager: str, name: str) -> None:
        nodelets = self._alive(manager).nodelets
        if name not in nodelets:
            raise HostError(f"no nodelet named '{name}' is loaded")
        if name in self.slow:
            self._on_the_way.append((nodelets[name], None))
            raise HostTimeout(f"nodelet '{name}' was not unloaded in time")
        del nodelets[name]
        self.on_change()

    def usage(self) -> Mapping[str, Usage]:
        return self.used

    def widen(self, kind: NodeletKind) -> None:
        self._step("widen", kind.value)
        self._start(self._new_name(), kind, "")

    def set_parameter(self, name: str, parameter: Parameter) -> bool:
        self._step("set_parameter", f"{name} {parameter.name}")
        self.parameters[f"{name}/{parameter.name}"] = value_of(parameter)
        return name in self.reconfigurable

    def forget(self, name: str, parameters: Sequence[str]) -> None:
        for parameter in parameters:
            self.parameters.pop(f"{name}/{parameter}", None)

    def list(self, manager: str) -> builtins.list[str]:
        return sorted(self._alive(manager).nodelets)

    def reported(self, manager: str, name: str) -> Reported | None:
        process = self.processes.get(manager)
        if process is None or name not in process.nodelets or not process.state.rewirable:
            return None
        ports, detail = self._present_ports(process.nodelets[name]), self.details.get(name, "")
        return Reported(ports, detail, loader=self.loaders.get(name, ""))

    def ports(self, name: str) -> tuple[PortState, ...]:
        self._step("ports", name)
        return self._present_ports(self._process_of(name).nodelets[name])

    def _present_ports(self, nodelet: FakeNodelet) -> tuple[PortState, ...]:
        lazy = self.lazy.get(nodelet.request.source, ())
        return tuple(
            replace(port, datatype="") if port.name in lazy else port
            for port in nodelet.ports.values()
            if port.name not in lazy or port.name in nodelet.kept
        )

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        self._step("connect", name)
        process = self._place_of(name)
        if process is not None and (name in self.slow or process.state.name in self._hung):
            self.unnoticed.discard(process.state.name)
            self._on_the_way.append((process.nodelets[name], dict(config)))
            raise HostTimeout(f"nodelet '{name}' did not answer in time")
        nodelet = self._process_of(name).nodelets[name]
        ports = nodelet.ports
        unknown = [port for port in config if port not in ports]
        if unknown:
            raise HostError(
                f"unknown port '{unknown[0]}'; known ports: {', '.join(sorted(ports))}"
            )
        for port, topic in config.items():
            found, mine = self._type_of(topic, name), ports[port].datatype
            if topic and not types_fit(found, mine):
                raise HostError(f"topic '{topic}' carries {found}")
        nodelet.kept.update(set(config) & set(self.lazy.get(nodelet.request.source, ())))
        self._apply(nodelet, config)

    def published(self, topics: Iterable[str]) -> frozenset[str]:
        self._step("published", "")
        return frozenset(topics) & self.topics

    def counts(
        self, wanted: Mapping[str, Collection[str]]
    ) -> dict[str, Mapping[str, Count] | None]:
        found: dict[str, Mapping[str, Count] | None] = {}
        for manager in sorted(wanted):
            for name in sorted(wanted[manager]):
                asked = self.clock()
                try:
                    self._step("counts", name)
                    nodelet = self._alive(manager).nodelets[name]
                except HostTimeout:
                    continue
                except (HostError, KeyError):
                    found[name] = None
                    continue
                found[name] = {
                    port.name: Count(
                        nodelet.sent.get(port.name, 0),
                        asked,
                        self.clock(),
                        port.name in nodelet.latched,
                        self._ages.get(port.topic),
                    )
                    for port in nodelet.ports.values()
                    if port.direction == "out"
                }
        return found

    def is_stamped(self, datatype: str) -> bool | None:
        return datatype not in self.unstamped

    def verdicts(self, topics: Collection[str]) -> dict[str, HeardVerdict]:
        self._heard = {topic: self._heard[topic] for topic in topics if topic in self._heard}
        self.followed = frozenset(topics)
        return self._heard

    def decide(self, topic: str, is_true: bool, why: str = "") -> None:
        """Let a verdict come on a topic; it is not heard unless the topic is followed."""
        if topic in self.followed:
            known, now = self._heard.get(topic), self.clock()
            heard = HeardVerdict(is_true, now, now, why, state=now).after(known)
            self._heard = {**self._heard, topic: heard}

    def listen(self, topic: str) -> Listening:
        self._step("listen", topic)
        listener = FakeListening(self, topic)
        self.listeners.append(listener)
        return listener

    def _new_name(self) -> str:
        candidates = (f"/fake_{number}" for number in itertools.count())
        return next(name for name in candidates if name not in self.processes)

    def _start(self, name: str, kind: NodeletKind, isolated_for: str) -> str:
        self.processes[name] = FakeProcess(self._state(name, kind, isolated_for))
        self._hung.discard(name)  # that was another process
        return name

    def _state(
        self, name: str, kind: NodeletKind, isolated_for: str = "", own: bool = True
    ) -> ProcessState:
        rewirable = kind is not NodeletKind.CPP or not self.stock
        incarnation = str(next(self._incarnations))
        host = self.machine if own else ""
        return ProcessState(
            name, kind, incarnation, isolated_for, own, rewirable=rewirable, host=host
        )

    def _step(self, operation: str, argument: str) -> None:
        assert_no_state_lock(f"asking the host: {operation} {argument}")
        self.calls.append((operation, argument))
        self.fail(operation, argument)

    def _alive(self, manager: str) -> FakeProcess:
        assert_no_state_lock(f"asking nodelet manager {manager}")
        process: FakeProcess | None = self.processes.get(manager)
        if manager in self._hung or manager in self._cut:
            self.unnoticed.discard(manager)
            raise HostTimeout(f"nodelet manager '{manager}' does not answer")
        if process is None or not process.state.alive:
            raise HostError(f"nodelet manager '{manager}' does not run")
        return process

    def _apply(self, nodelet: FakeNodelet, config: Mapping[str, str]) -> None:
        before = dict(nodelet.ports)
        for port, topic in config.items():
            nodelet.ports[port] = replace(nodelet.ports[port], topic=topic)
        nodelet.reconfigurations += nodelet.ports != before
        self.on_change()

    def _type_of(self, topic: str, but: str) -> str:
        for name in self.running:
            for port in self.nodelet(name).ports.values():
                if port.topic == topic and name != but:
                    return port.datatype
        return ""

    def _process_of(self, name: str) -> FakeProcess:
        process = self._place_of(name)
        if process is None:
            raise HostError(f"nodelet '{name}' does not answer")
        return self._alive(process.state.name)

    def _place_of(self, name: str) -> FakeProcess | None:
        hosting = (each for each in self.processes.values() if name in each.nodelets)
        return next(hosting, None)
