# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The changes that loading a wiring would make, found before anything is changed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Callable, Collection, Iterator, Mapping, Sequence

from dyknow.datatypes import ANY, types_fit
from dyknow.errors import FixedTopics, InvalidParameters, Problem, UnknownPort
from dyknow.manager.specifications.findings import shorten
from dyknow.manager.specifications.given import bindings_of, completed, set_on_load
from dyknow.manager.specifications.values import as_tree, find
from dyknow.model.graph import Model, NodeletStatus, SpawnRequest, State
from dyknow.model.transformation import TOPIC, Transformation, Transformations
from dyknow.wiring.wiring import NODELET, TRANSFORMATION, Wiring

Stored = Callable[[str, Sequence[str]], Mapping[str, object]]
"""Returns the values that the parameter server has for parameters of a nodelet, by name."""


@dataclass(frozen=True)
class Kept:
    """A nodelet that runs already, as it is wanted and as it is."""

    wanted: SpawnRequest  # the request in the file
    present: NodeletStatus  # the running nodelet
    #: How it was made otherwise than the library says now, in words: from an earlier
    #: transformation, so that it cannot be made again as it was.
    differences: tuple[str, ...] = ()
    #: Ports of its transformation. Others of a C++ nodelet stay where they are, unless the file
    #: connects them, and may not be there yet.
    declared: frozenset[str] = frozenset()

    @property
    def moves(self) -> dict[str, str]:
        """New topics of those ports that are to be moved; empty to disconnect."""
        present = self.present.connections
        disconnected = dict.fromkeys(present, "")
        wanted = dict(self.wanted.config)
        if not self.present.kind.is_written_for_dyknow:
            there = {port.name for port in self.present.ports} | self.declared
            wanted = {port: topic for port, topic in wanted.items() if port in there}
            disconnected = {port: "" for port in disconnected if port in self.declared}
        ports = {**disconnected, **wanted}
        return {
            port: topic for port, topic in sorted(ports.items()) if present.get(port, "") != topic
        }

    @property
    def is_as_wanted(self) -> bool:
        """Whether nothing of it is to be changed."""
        return not self.moves and self.wanted.is_protected == self.present.is_protected


@dataclass
class LoadPlan:
    """The changes that a load would make, and the problems that forbid it."""

    #: Transformations that the library does not have.
    added: list[Transformation] = field(default_factory=list)
    #: Transformations that the library has otherwise, each with the file's.
    replaced: list[tuple[Transformation, Transformation]] = field(default_factory=list)
    same: list[str] = field(default_factory=list)  # labels of those that it has just so
    #: Nodelets to make that are not there, readers before writers.
    spawned: list[SpawnRequest] = field(default_factory=list)
    #: Running nodelets that are to be made again, since they were made otherwise.
    remade: list[Kept] = field(default_factory=list)
    kept: list[Kept] = field(default_factory=list)  # nodelets that run already, and go on
    #: Names of nodelets whose nodelet manager is not there: the manager chooses.
    any_manager: set[str] = field(default_factory=set)
    #: Why the load is refused; empty if it is not.
    problems: list[Problem] = field(default_factory=list)
    #: The transformations to make nodelets from, by label.
    blueprints: dict[str, Transformation] = field(default_factory=dict)
    #: Those that the library has now, by label.
    former: dict[str, Transformation] = field(default_factory=dict)

    @property
    def is_done(self) -> bool:
        """Whether a load would change nothing."""
        changes = (self.added, self.replaced, self.spawned, self.remade)
        return not any(changes) and all(each.is_as_wanted for each in self.kept)

    @property
    def made(self) -> list[SpawnRequest]:
        """All nodelets to make, for the first time or again, readers before writers."""
        wanted = [*self.spawned, *(each.wanted for each in self.remade)]
        return readers_first(wanted, self.blueprints)


def plan_load(
    wiring: Wiring,
    snapshot: Model,
    managers: Collection[str],
    is_own_manager: Callable[[str], bool] = lambda name: False,
    replace: bool = False,
    any_manager: bool = False,
    stored: Stored | None = None,
) -> LoadPlan:
    """Compare a wiring with the running system, a snapshot with its transformations.

    The managers are the nodelet managers that may be used, and hosts that answer, as ``@HOST``;
    one that ``is_own_manager`` is started by the DyKnow manager when it is needed. ``replace``
    allows to replace transformations that differ, and to make nodelets again that were made
    otherwise; ``any_manager`` lets the manager choose where the wanted nodelet manager is not one
    of these. ``stored`` returns the parameters of nodelets; None if they are unknown.
    """
    plan = LoadPlan()
    plan.former = {each.label: each for each in snapshot.transformations}
    plan.blueprints = {**plan.former, **{each.label: each for each in wiring.transformations}}
    _plan_transformations(plan, wiring, replace)
    for nodelet in wiring.nodelets:
        problems: list[str] = []
        blueprint = plan.blueprints.get(nodelet.label)
        if blueprint is None:
            problems.append(
                f"neither the file nor the library has its transformation '{nodelet.label}'"
            )
        else:
            present = snapshot.nodelet(nodelet.name)
            problems += _problems_of_blueprint(nodelet, blueprint, present is not None)
            if present is None:
                plan.spawned.append(nodelet)
            if present is None or _is_remade(plan, wiring, nodelet, present, replace, stored):
                may_choose = any_manager or is_own_manager(nodelet.manager)
                if nodelet.manager and nodelet.manager not in managers and may_choose:
                    plan.any_manager.add(nodelet.name)
                else:
                    problems += _problems_of_place(nodelet, managers)
        plan.problems += [
            wiring.problem(f"nodelet '{nodelet.name}': {problem}", (NODELET, nodelet.name))
            for problem in problems
        ]
    plan.problems += _problems_of_topics(plan, wiring)
    plan.problems.sort(key=lambda problem: problem.line)
    plan.spawned = readers_first(plan.spawned, plan.blueprints)
    return plan


def _plan_transformations(plan: LoadPlan, wiring: Wiring, replace: bool) -> None:
    for transformation in wiring.transformations:
        present = plan.former.get(transformation.label)
        if present is None:
            plan.added.append(transformation)
        elif present == transformation:
            plan.same.append(transformation.label)
        else:
            plan.replaced.append((present, transformation))
            if not replace:
                what = (
                    f"transformation '{transformation.label}' is in the library already, and "
                    "differs; replace it with --replace"
                )
                plan.problems.append(wiring.problem(what, (TRANSFORMATION, transformation.label)))


def _problems_of_blueprint(
    nodelet: SpawnRequest, blueprint: Transformation, is_present: bool
) -> Iterator[str]:
    if blueprint.node and not is_present:
        yield "it is a node that others start, and does not run"
    elif blueprint.type == TOPIC:
        yield f"transformation '{nodelet.label}' is an existing topic, not a nodelet"
    try:
        completed(blueprint, nodelet.parameters)
    except InvalidParameters as error:
        yield str(error)


def _problems_of_place(nodelet: SpawnRequest, managers: Collection[str]) -> Iterator[str]:
    if nodelet.manager and nodelet.manager not in managers:
        what = (
            f"its host '{nodelet.host}' does not answer; start a nodelet manager there"
            if nodelet.host
            else f"its nodelet manager '{nodelet.manager}' is not running, or ~nodelet_managers "
            "does not name it; start or name it"
        )
        yield f"{what}, or let the manager choose with --any-manager"
    elif nodelet.manager and not nodelet.host and nodelet.isolated:
        yield (
            f"isolated, and in nodelet manager '{nodelet.manager}'; expected a process of its own "
            "or a named one, not both"
        )


def _is_remade(
    plan: LoadPlan,
    wiring: Wiring,
    nodelet: SpawnRequest,
    present: NodeletStatus,
    replace: bool,
    stored: Stored | None,
) -> bool:
    """Keep a running nodelet, or make it again; returns whether it is to be made again."""

    def refuse(why: str) -> None:
        plan.problems.append(wiring.problem(why, (NODELET, nodelet.name)))

    if present.transformation != nodelet.label:
        made_from = f"made from '{present.transformation}'" * bool(present.transformation)
        made_from = made_from or f"loaded by {present.owner}"
        refuse(f"nodelet '{nodelet.name}' runs already, {made_from}; expected '{nodelet.label}'")
        return False
    blueprint = plan.blueprints[nodelet.label]
    is_isolated = nodelet.isolated or (blueprint.isolated and not nodelet.manager)
    if is_isolated and not (present.isolated or present.kind.is_node):
        refuse(f"nodelet '{nodelet.name}' runs already, not isolated; expected the contrary")
        return False
    is_replaced = nodelet.label in (old.label for old, _ in plan.replaced) and not blueprint.node
    outdated: tuple[str, ...] = ()
    if not is_replaced:
        outdated = _otherwise_made(blueprint, nodelet, present, stored)
    kept = Kept(nodelet, present, outdated, frozenset(port.name for port in blueprint.ports))
    if not replace or blueprint.node or not (is_replaced or outdated):
        if present.is_fixed and kept.moves:
            refuse(str(FixedTopics(nodelet.name, present.manager)))
        plan.problems += _unknown_ports(kept, wiring)
        plan.kept.append(kept)
        return False
    if present.is_protected:
        refuse(
            f"nodelet '{nodelet.name}' is protected, and would have to be made again; release it "
            f"first: dyknow unprotect {nodelet.name}"
        )
        return False
    plan.remade.append(kept)
    return True


def _unknown_ports(kept: Kept, wiring: Wiring) -> Iterator[Problem]:
    """Find ports that a running nodelet does not have, nor an image port to which they belong."""
    present = kept.present
    known = {port.name for port in present.ports}
    if present.state is State.RUNNING and present.kind.is_written_for_dyknow:
        for port in kept.moves:
            if known.isdisjoint((port, port.rpartition("/")[0])):
                why = f"nodelet '{present.name}': {UnknownPort(port, known)}"
                yield wiring.problem(why, (present.name, port))


def _otherwise_made(
    blueprint: Transformation, nodelet: SpawnRequest, present: NodeletStatus, stored: Stored | None
) -> tuple[str, ...]:
    """Compare a running nodelet, as far as it is visible, with the file's request for it.

    A nodelet keeps the transformation that it was made from when the library gets another, and the
    parameters that were given to it.
    """
    found: list[str] = []
    try:
        wanted = set_on_load(blueprint, completed(blueprint, nodelet.parameters))
    except InvalidParameters:
        return ()  # it is a problem of the plan
    if bindings_of(nodelet.parameters) != bindings_of(present.parameters):
        found.append("its variables were bound otherwise")
    names = {each.name for each in wanted}
    for name, _, text in present.parameters:
        if name[:1] != "?" and name not in names:
            found.append(f"parameter {name} is {shorten(text)}, expected none")
    if stored is not None and wanted:
        values, tree = stored(present.name, [each.name for each in wanted]), as_tree(wanted)
        for name, _, text in wanted:
            value = find(tree, name, None)  # another one may be above it, or below
            if name not in values and value is not None:
                found.append(f"parameter {name} is not set, expected {shorten(text)}")
            elif not _is_same(values.get(name), value):
                what = shorten(str(values[name]))
                found.append(f"parameter {name} is {what}, expected {shorten(text)}")
    for port in blueprint.ports:
        shown = present.port(port.name)
        if shown is not None and (shown.direction, shown.tags) != (port.direction, port.tags):
            found.append(f"port {port.name} was declared otherwise")
    return tuple(found)


def _is_same(value: object, expected: object) -> bool:
    """Whether two values of a parameter are equal, also where they have NaN."""
    return value == expected or repr(value) == repr(expected)


def _problems_of_topics(plan: LoadPlan, wiring: Wiring) -> Iterator[Problem]:
    """Find topics to which ports of different types are to be connected."""
    first: dict[str, tuple[str, str]] = {}
    for nodelet in wiring.nodelets:
        blueprint = plan.blueprints.get(nodelet.label)
        types = {port.name: port.datatype for port in blueprint.ports} if blueprint else {}
        for port, topic in nodelet.config.items():
            datatype = types.get(port, "")
            if datatype in ANY:
                continue
            place = f"{nodelet.name}:{port}"
            other, present = first.setdefault(topic, (place, datatype))
            if not types_fit(present, datatype):
                why = f"topic '{topic}': '{place}' has type {datatype}, '{other}' has {present}"
                yield wiring.problem(why, (nodelet.name, port))


def readers_first(nodelets: list[SpawnRequest], blueprints: Transformations) -> list[SpawnRequest]:
    """Order nodelets so that a stream's readers are there before it begins, as far as possible."""
    ordered = sorted(nodelets, key=lambda nodelet: nodelet.name)
    reading: dict[str, list[SpawnRequest]] = {}
    for nodelet in ordered:
        for topic in _topics(nodelet, blueprints, "in"):
            reading.setdefault(topic, []).append(nodelet)
    done: dict[str, SpawnRequest] = {}
    entered: set[str] = set()
    # Depth first, with a stack of its own: chains may be longer than Python's recursion allows.
    stack = [(nodelet, False) for nodelet in reversed(ordered)]
    while stack:
        nodelet, readers_are_done = stack.pop()
        if readers_are_done:
            done.setdefault(nodelet.name, nodelet)
        elif nodelet.name not in entered:
            entered.add(nodelet.name)
            stack.append((nodelet, True))
            readers = [
                reader
                for topic in _topics(nodelet, blueprints, "out")
                for reader in reading.get(topic, ())
            ]
            stack.extend((reader, False) for reader in reversed(readers))
    return list(done.values())


def _topics(nodelet: SpawnRequest, blueprints: Transformations, direction: str) -> list[str]:
    connections = nodelet.config
    return [
        connections[port.name]
        for port in blueprints[nodelet.label].ports
        if port.direction == direction and port.name in connections
    ]
