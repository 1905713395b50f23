# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager of the paper's figure 1: the five services of section IV.C, as methods.

Built from: the library (transformations), the graph (nodelets), the lifecycle (making and
destroying them), the observer (keeping the picture true and restoring dead nodelets). It reaches
nodelets through the injected host only.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import partial
from typing import Iterable, Iterator, Mapping, NamedTuple, Sequence

from dyknow import names
from dyknow.errors import DyKnowError, FixedTopics, HostError, HostTimeout, InvalidParameters
from dyknow.manager.record import Record, with_present_ports, without_cut
from dyknow.manager.specifications.given import completed, undeclared
from dyknow.manager.specifications.specification import Specifications
from dyknow.manager.steps import ReversibleStep, StepFailed, carry_out
from dyknow.manager.supervision.lifecycle import Lifecycle, ManagerContext
from dyknow.manager.supervision.observer import Observer
from dyknow.manager.supervision.restarts import Restarts
from dyknow.model.graph import Model, ParameterSet, Restarted, SpawnRequest, State
from dyknow.model.hosts import HostStatus
from dyknow.model.transformation import NODE, Parameter, Program, Transformation


class _Move(NamedTuple):
    """Topics of a nodelet's ports before and after they are moved."""

    name: str
    before: dict[str, str]
    after: dict[str, str]


class Manager:
    """Transformations, nodelets and their connections; every method is safe from any thread."""

    def __init__(self, context: ManagerContext) -> None:
        """Put the parts together; ``start`` comes next."""
        self.library = context.library
        self.guards = context.guards
        self.host = context.host
        self.store = context.store
        self.graph = context.graph
        self.namespace = context.namespace  # where relative names begin
        self.lifecycle = Lifecycle(context)
        self._restarts = Restarts(context, self.lifecycle)
        self.observer = Observer(context, self.lifecycle)

    def start(self) -> None:
        """Take over the running nodelets of an earlier life, and bring back the dead ones."""
        self.observer.adopt(self.store.read("nodelets", Record.from_body).values())

    def look(self) -> float:
        """Compare the picture with reality; returns the seconds until the next look."""
        self.store.write_pending()
        return self.observer.look()

    def end(self) -> None:
        """End on purpose: the nodelets that this manager made are destroyed and forgotten."""
        for record in self.graph.all():
            if record.is_spawned:
                self.lifecycle.clear(record)
        self.store.end()

    # Transformations

    def add_transformation(self, text: str) -> Specifications:
        """Add the transformations of a specification, all or none."""
        self.guards.check_writable("adding transformations")
        specifications = self.library.add(text, check=self._check_programs)
        for each in specifications.transformations:
            self.lifecycle.acquit(each.label)
        self.graph.on_change()
        return specifications

    def _check_programs(self, transformations: Iterable[Transformation]) -> None:
        for each in transformations:
            if each.type == NODE and not each.is_described:
                self.guards.check_program(Program.of(each.source).name)

    def remove_transformation(self, label: str) -> Transformation:
        """Remove a transformation; its nodelets run on."""
        self.guards.check_writable(f"removing transformation '{label}'")
        removed = self.library.remove(label)
        self.graph.on_change()
        return removed

    # Nodelets

    def resolve(self, name: str) -> str:
        """Make the name of a nodelet global."""
        what = "nodelet name"
        return names.resolve(names.check(name, what), self.namespace, "/", what)

    def spawn(self, request: SpawnRequest) -> Record:
        """Make a nodelet, which runs and is connected when this returns; else nothing is left."""
        request = replace(request, name=self.resolve(request.name))
        self.guards.check_writable(f"spawning '{request.name}'")
        record = self.lifecycle.spawn(self.library.get(request.label), request)
        self.observer.forgive(record.name)  # an earlier nodelet of the name
        return record

    def destroy(self, name: str) -> None:
        """Destroy a nodelet, whoever loaded it."""
        name = self.resolve(name)
        self.guards.check_writable(f"destroying '{name}'")
        self.lifecycle.destroy(name)
        self.lifecycle.suspects.acquit(name)

    def restart(self, name: str) -> Restarted:
        """Restart a nodelet, or a nodelet manager with all its nodelets."""
        name = self.resolve(name)
        self.guards.check_writable(f"restarting '{name}'")
        return self._restarts.restart(name)

    def renew(self, name: str) -> Restarted:
        """Restart what the watchdog has found; also in read-only mode, which binds users.

        Nodelets that could not be made today hold up no neighbours.
        """
        return self._restarts.restart(name, is_forced=True)

    def move(self, name: str, manager: str) -> None:
        """Move a nodelet to another nodelet manager of its host, without a lost message."""
        self.guards.check_writable(f"moving '{name}'")
        self._restarts.move(name, manager)

    def set_parameter(self, name: str, parameter: Parameter) -> ParameterSet:
        """Set a private parameter of a nodelet, from now on and whenever it is brought back."""
        name = self.resolve(name)
        self.guards.check_writable(f"setting parameters of '{name}'")
        with self._changing_spawned(name) as record:
            assert record.transformation is not None
            if parameter.name[:1] == "?":
                what = f"'{name}' keeps its {parameter.name} for life; spawn another nodelet"
                raise InvalidParameters(record.label, [what])
            others = [each for each in record.parameters if each.name != parameter.name]
            given = completed(record.transformation, [*others, parameter], self.library.ontology)
            (typed,) = (each for each in given if each.name == parameter.name)
            self.graph.put(replace(record, parameters=given))
            try:
                is_read = self.host.set_parameter(name, typed)
            except HostError:
                self.graph.put(record)
                raise
            return ParameterSet(is_read, "\n".join(undeclared(record.transformation, [typed])))

    @contextlib.contextmanager
    def _changing_spawned(self, name: str) -> Iterator[Record]:
        """Reserve a nodelet that this manager made."""
        with self.graph.changing_present(name) as record:
            if not record.is_spawned:
                raise HostError(f"nodelet '{name}' was not spawned by this manager")
            yield record

    def set_protection(self, name: str, is_protected: bool) -> None:
        """Protect a nodelet from being destroyed, or release it."""
        name = self.resolve(name)
        self.guards.check_writable(f"changing the protection of '{name}'")
        with self._changing_spawned(name) as record:
            self.graph.put(replace(record, is_protected=is_protected))

    def connect(self, moves: Sequence[tuple[str, Mapping[str, str]]]) -> None:
        """Connect ports of nodelets in this order; the model shows it when this returns.

        The moves are names of nodelets, each with topics by port; an empty topic disconnects.

        Raises:
            DyKnowError: one could not be connected, and those before it were moved back; the text
                says so if one could not be.
        """
        resolved = [(self.resolve(name), config) for name, config in moves]
        for name, _ in resolved:
            self.guards.check_writable(f"connecting '{name}'")
        with self.graph.changing_all({name for name, _ in resolved}):
            checked = [self._checked(name, config) for name, config in resolved]
            steps = [
                ReversibleStep(
                    f"connecting '{move.name}'",
                    move.name,
                    partial(self.host.connect, move.name, move.after),
                    partial(self._move_back, move),
                )
                for move in checked
            ]
            try:
                carry_out(steps, may_be_done=lambda error: isinstance(error, HostTimeout))
            except StepFailed as failed:
                if failed.troubles:
                    raise DyKnowError("; ".join([str(failed.error), *failed.troubles])) from failed
                raise failed.error from failed
            finally:
                for move in checked:
                    with contextlib.suppress(HostError):  # the next look shows the ports
                        self._show(move)

    def _show(self, move: _Move) -> None:
        """Show the ports of a nodelet after a move; one that is brought back has them so, too."""
        record = without_cut(self.graph.get(move.name), move.after)
        ports = self.host.ports(move.name)
        if record.state is State.RUNNING:
            self.graph.put(with_present_ports(record, ports))
            return
        moved = {p.name: p.topic for p in ports if p.topic != move.before.get(p.name)}
        self.graph.put(replace(record, topics={**record.topics, **moved}))

    def _checked(self, name: str, config: Mapping[str, str]) -> _Move:
        record = self.graph.get(name)
        if record.is_fixed:
            raise FixedTopics(name, record.manager)
        space = names.parent(name)
        after = {
            p: names.resolve(t, space, name, "topic name") if t else "" for p, t in config.items()
        }
        for topic in after.values():  # foreign nodelet managers do not have these guards
            self.guards.check_topic(topic)
        before = {port.name: port.topic for port in self.host.ports(name)}
        return _Move(name, before, after)

    def _move_back(self, move: _Move) -> None:
        """Move back those ports that are still where they were moved."""
        unknown = {topic for port, topic in move.after.items() if port not in move.before}
        back = {}
        for port in self.host.ports(move.name):  # some were given by their global names
            was = move.before.get(port.name, "")
            is_moved = port.topic == move.after.get(port.name) or port.topic in unknown
            if is_moved and port.topic != was:
                back[port.name] = was
        if back:
            self.host.connect(move.name, back)

    # The model

    def hosts(self) -> tuple[HostStatus, ...]:
        """Return the hosts of the processes that the manager knows, by name."""
        return self.lifecycle.hosts.all(self.graph.all())

    def graph_model(self) -> Model:
        # The revisions come first: a change meanwhile is shown with the next one.
        revisions = self.graph.revision, self.library.revision
        return Model(*revisions, tuple([record.status for record in self.graph.all()]))

    def get_model(self) -> Model:
        """Return nodelets, connections and transformations."""
        return replace(self.graph_model(), transformations=tuple(self.library.all()))
