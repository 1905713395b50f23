"""A manager that exists in this process only: for tests of the window, and for its pictures.

It behaves as a real one does where the window can see it, and can be told to fail or to be slow.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from dyknow import names
from dyknow.errors import (
    DyKnowError,
    HostError,
    InvalidConfiguration,
    NameTaken,
    Protected,
    Refused,
    SpecificationError,
    TypeMismatch,
    UnknownNodelet,
    UnknownPort,
    UnknownTransformation,
)
from dyknow.locks import reentrant_state_lock
from dyknow.manager.specifications.specification import parse
from dyknow.model.graph import Model, NodeletStatus, PortState, State
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamEvent, StreamRequest, StreamStatus
from dyknow.model.transformation import OUT, TOPIC, Added, Transformation
from dyknow_rqt.graph.snapshot import PortRef, Side
from dyknow_rqt.remote import Remote
from dyknow_rqt.simulated_streams import SimulatedStreams


class SimulatedRemote(Remote):
    """Holds a graph and a library, and obeys."""

    def __init__(self) -> None:
        """Begin with nothing, with a manager that is up."""
        self.manager = "/dyknow_manager"
        self.is_up = True
        #: Seconds that every call takes.
        self.delay = 0.0
        #: What was asked, in order: name of the method and its first argument.
        self.calls: List[Tuple[str, str]] = []
        #: Messages a second, and messages lost a second, of out-ports; others are silent.
        self.rates: Dict[PortRef, Tuple[float, float]] = {}
        self.publishers: Dict[str, List[str]] = {}
        self.subscribers: Dict[str, List[str]] = {}
        self._nodelets: Dict[str, NodeletStatus] = {}
        self._library: Dict[str, Transformation] = {}
        self._revision = self._library_revision = 1
        self._lock = reentrant_state_lock("simulated manager")
        self._on_model: Callable[[Model], None] = lambda model: None
        self._start = time.monotonic()
        #: The claims, to be altered as if by themselves.
        self.streams_ = SimulatedStreams(
            self._nodelets, self._library, self.spawn, self.set_config
        )

    # What is asked by the window

    def start(
        self,
        on_model: Callable[[Model], None],
        on_event: Callable[[StreamEvent], None],
    ) -> None:
        """Hand on each change from now on."""
        self._on_model, self.streams_.on_event = on_model, on_event

    def close(self) -> None:
        """Hand on nothing more."""
        self._on_model, self.streams_.on_event = lambda model: None, lambda event: None

    def graph(self) -> Model:
        """What runs."""
        self._answer("graph", "")
        return self._model(())

    def library(self) -> Model:
        """What runs and can run."""
        self._answer("library", "")
        return self._model(tuple(self._library[label] for label in sorted(self._library)))

    def ports(self, nodelet: str) -> Sequence[PortState]:
        """As they are."""
        self._answer("ports", nodelet)
        return self._find(nodelet).ports

    def statistics(self, nodelet: str) -> NodeletStatistics:
        """Counts that grow evenly."""
        self._answer("statistics", nodelet)
        found = self._find(nodelet)
        age = time.monotonic() - self._start
        return NodeletStatistics(
            age, 0, 0, tuple(self._traffic(nodelet, p, age) for p in found.ports)
        )

    def system_state(self) -> Tuple[Side, Side]:
        """Ordinary nodes, and the nodelet managers for their nodelets."""
        self._answer("system_state", "")
        return sorted(self.publishers.items()), sorted(self.subscribers.items())

    def nodelet_managers(self) -> Sequence[str]:
        """Those that host something."""
        self._answer("nodelet_managers", "")
        return sorted({each.manager for each in self._nodelets.values()})

    def add_transformation(self, specification: str) -> Added:
        """Read it as the manager does."""
        self._answer("add_transformation", specification)
        try:
            found = parse(specification)
        except SpecificationError as error:
            raise Refused(str(error)) from error
        for each in found.transformations:
            self._library[each.label] = each
        self._library_revision += 1
        self._changed()
        warnings = "\n".join(str(warning) for warning in found.warnings)
        return Added(tuple(each.label for each in found.transformations), warnings)

    def remove_transformation(self, label: str) -> None:
        """Take it out."""
        self._answer("remove_transformation", label)
        if self._library.pop(label, None) is None:
            raise Refused(str(UnknownTransformation(label)))
        self._library_revision += 1
        self._changed()

    def spawn(
        self,
        label: str,
        name: str,
        config: Optional[Mapping[str, str]] = None,
        is_protected: bool = False,
        isolated: bool = False,
        manager: str = "",
    ) -> None:
        """Make a nodelet with the ports of its transformation."""
        self._answer("spawn", name)
        name = names.resolve(names.check(name), "/", "/")
        transformation = self._library.get(label)
        if transformation is None or transformation.type == TOPIC:
            raise Refused(str(UnknownTransformation(label)))
        if name in self._nodelets:
            raise Refused(str(NameTaken(name)))
        own = "/dyknow_nodelet_manager" + ("_2" if isolated else "")
        ports = tuple(
            PortState(port.name, port.direction, port.datatype, "", port.tags)
            for port in transformation.ports
        )
        self._nodelets[name] = NodeletStatus(
            *(name, label, manager or own, is_protected, isolated, False, State.RUNNING, ""),
            ports,
        )
        try:
            self._connect(name, config or {})
        except DyKnowError:
            del self._nodelets[name]
            raise
        self._changed()

    def destroy(self, name: str) -> None:
        """Take it out of the graph, unless it is protected."""
        self._answer("destroy", name)
        if self._find(name).is_protected:
            raise Refused(str(Protected(name)))
        del self._nodelets[name]
        self._changed()

    def set_protection(self, name: str, is_protected: bool) -> None:
        """Set the protection."""
        self._answer("set_protection", name)
        self.alter(name, is_protected=is_protected)

    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        """Connect all ports or none."""
        self._answer("set_config", nodelet)
        self._connect(nodelet, config)
        self._changed()

    def acquire_stream(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        """Plan, and make what is missing."""
        self._answer("acquire_stream", request.tag)
        return self.streams_.acquire(request, dry_run)

    def release_stream(self, claim_id: str) -> None:
        """End a claim."""
        self._answer("release_stream", claim_id)
        self.streams_.release(claim_id)

    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        """Say what the way is now."""
        self._answer("replan_stream", claim_id)
        return self.streams_.replan(claim_id, dry_run)

    def streams(self) -> Sequence[StreamStatus]:
        """All claims."""
        self._answer("streams", "")
        return self.streams_.all()

    # What happens behind the window's back

    def alter(self, name: str, **fields: object) -> None:
        """Change fields of a nodelet, as if by itself."""
        self._nodelets[name] = replace(self._find(name), **fields)  # type: ignore[arg-type]
        self._changed()

    # Inside

    def _answer(self, method: str, argument: str) -> None:
        self.calls.append((method, argument))
        if self.delay:
            time.sleep(self.delay)
        if not self.is_up:
            raise HostError(f"service {self.manager}/{method} is not there")

    def _model(self, transformations: Tuple[Transformation, ...]) -> Model:
        nodelets = tuple(self._nodelets[name] for name in sorted(self._nodelets))
        return Model(self._revision, self._library_revision, nodelets, transformations)

    def _changed(self) -> None:
        self._revision += 1
        self._on_model(self._model(()))

    def _find(self, name: str) -> NodeletStatus:
        if name not in self._nodelets:
            raise Refused(str(UnknownNodelet(name, self._nodelets)))
        return self._nodelets[name]

    def _connect(self, name: str, config: Mapping[str, str]) -> None:
        nodelet = self._find(name)
        known = {port.name: port for port in nodelet.ports}
        problems: List[DyKnowError] = []
        for port, topic in sorted(config.items()):
            if port not in known:
                problems.append(UnknownPort(port, known))
            elif topic:
                wanted, present = known[port].datatype, self._datatype(topic)
                if present and wanted and wanted != present:
                    problems.append(TypeMismatch(topic, wanted, present))
        if problems:
            raise Refused(str(InvalidConfiguration(name, problems)))
        ports = tuple(replace(p, topic=config.get(p.name, p.topic)) for p in nodelet.ports)
        self._nodelets[name] = replace(nodelet, ports=ports)

    def _datatype(self, topic: str) -> str:
        ports = [port for each in self._nodelets.values() for port in each.ports]
        return next((port.datatype for port in ports if port.topic == topic and port.datatype), "")

    def _traffic(self, nodelet: str, port: PortState, age: float) -> PortStatistics:
        rate, lost = self.rates.get(PortRef(nodelet, port.name), (0.0, 0.0))
        if port.direction != OUT and port.topic and (rate, lost) == (0.0, 0.0):
            rate = sum(
                self.rates.get(PortRef(each.name, other.name), (0.0, 0.0))[0]
                for each in self._nodelets.values()
                for other in each.ports
                if other.direction == OUT and other.topic == port.topic
            )
        counts = int(rate * age), int(lost * age)
        return PortStatistics(port.name, port.direction, port.topic, *counts, rate, 0.0, 0.0)
