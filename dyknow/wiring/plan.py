"""What loading a wiring would change, found out before anything is changed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Callable, Collection, Dict, List, Mapping, Set, Tuple

from dyknow.manager.specifications.transformation import TOPIC, Transformation
from dyknow.wiring.ports import connections_of, types_fit
from dyknow.wiring.wiring import WiredNodelet, Wiring

if TYPE_CHECKING:
    from dyknow.ros.views import ModelView, NodeletView


@dataclass(frozen=True)
class Kept:
    """A nodelet that runs already, as it is wanted and as it is."""

    wanted: WiredNodelet
    present: NodeletView

    @property
    def moves(self) -> Dict[str, str]:
        """New topics of those ports that are to be moved; empty to disconnect."""
        wanted = dict(self.wanted.connections)
        present = connections_of(self.present)
        ports = {**dict.fromkeys(present, ""), **wanted}
        return {
            port: topic for port, topic in sorted(ports.items()) if present.get(port, "") != topic
        }

    @property
    def is_as_wanted(self) -> bool:
        """Whether nothing of it is to be changed."""
        return not self.moves and self.wanted.is_protected == self.present.is_protected


@dataclass
class Plan:
    """The steps of a load, and what stands against it.

    Attributes:
        added: transformations that the library does not have.
        replaced: transformations that the library has otherwise: the present ones.
        replacing: what these are replaced with.
        same: labels of those that it has just so.
        spawned: nodelets to make, readers before writers.
        kept: nodelets that run already.
        any_manager: names of nodelets whose nodelet manager is not there: the manager chooses.
        problems: why the load is refused; empty if it is not.
    """

    added: List[Transformation] = field(default_factory=list)
    replaced: List[Transformation] = field(default_factory=list)
    replacing: List[Transformation] = field(default_factory=list)
    same: List[str] = field(default_factory=list)
    spawned: List[WiredNodelet] = field(default_factory=list)
    kept: List[Kept] = field(default_factory=list)
    any_manager: Set[str] = field(default_factory=set)
    problems: List[str] = field(default_factory=list)
    blueprints: Dict[str, Transformation] = field(default_factory=dict)


def plan_load(
    wiring: Wiring,
    snapshot: ModelView,
    managers: Collection[str],
    is_own_manager: Callable[[str], bool] = lambda name: False,
    replace: bool = False,
    any_manager: bool = False,
) -> Plan:
    """Compare a wiring with what runs.

    Args:
        wiring: What is wanted.
        snapshot: What is there, with its transformations.
        managers: Nodelet managers that are up.
        is_own_manager: Tells a nodelet manager that the DyKnow manager starts when it is needed.
        replace: Replace transformations that the library has otherwise.
        any_manager: Let the manager choose where the wanted nodelet manager is not up.
    """
    plan = Plan()
    _plan_transformations(plan, wiring, snapshot, replace)
    plan.blueprints = {each.label: each for each in snapshot.transformations}
    plan.blueprints.update({each.label: each for each in wiring.transformations})
    for nodelet in wiring.nodelets:
        blueprint = plan.blueprints.get(nodelet.label)
        if blueprint is None:
            plan.problems.append(
                f"nodelet '{nodelet.name}': neither the file nor the library has its "
                f"transformation '{nodelet.label}'"
            )
            continue
        _check_blueprint(plan, nodelet, blueprint)
        present = snapshot.nodelet(nodelet.name)
        if present is not None:
            _plan_kept(plan, nodelet, present)
            continue
        plan.spawned.append(nodelet)
        if nodelet.manager and nodelet.manager not in managers:
            if any_manager or is_own_manager(nodelet.manager):
                plan.any_manager.add(nodelet.name)
            else:
                plan.problems.append(
                    f"nodelet '{nodelet.name}': its nodelet manager '{nodelet.manager}' is not "
                    "running; start it, or let the manager choose with --any-manager"
                )
        elif nodelet.manager and nodelet.isolated:
            plan.problems.append(
                f"nodelet '{nodelet.name}': isolated, and in nodelet manager '{nodelet.manager}'; "
                "expected a process of its own or a named one, not both"
            )
    _check_topics(plan, wiring)
    plan.spawned = readers_first(plan.spawned, plan.blueprints)
    return plan


def readers_first(
    nodelets: List[WiredNodelet], blueprints: Mapping[str, Transformation]
) -> List[WiredNodelet]:
    """Order nodelets so that a stream's readers are there before it begins, as far as possible."""
    ordered = sorted(nodelets, key=lambda nodelet: nodelet.name)
    reading: Dict[str, List[WiredNodelet]] = {}
    for nodelet in ordered:
        for topic in _topics(nodelet, blueprints, "in"):
            reading.setdefault(topic, []).append(nodelet)
    done: Dict[str, WiredNodelet] = {}
    entered: Set[str] = set()
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


def _topics(
    nodelet: WiredNodelet, blueprints: Mapping[str, Transformation], direction: str
) -> List[str]:
    connections = dict(nodelet.connections)
    return [
        connections[port.name]
        for port in blueprints[nodelet.label].ports
        if port.direction == direction and port.name in connections
    ]


def _plan_transformations(plan: Plan, wiring: Wiring, snapshot: ModelView, replace: bool) -> None:
    library = {each.label: each for each in snapshot.transformations}
    for transformation in wiring.transformations:
        present = library.get(transformation.label)
        if present is None:
            plan.added.append(transformation)
        elif present == transformation:
            plan.same.append(transformation.label)
        else:
            plan.replaced.append(present)
            plan.replacing.append(transformation)
            if not replace:
                plan.problems.append(
                    f"transformation '{transformation.label}' is in the library already, and "
                    "differs; replace it with --replace"
                )


def _plan_kept(plan: Plan, nodelet: WiredNodelet, present: NodeletView) -> None:
    if present.transformation != nodelet.label:
        made_from = (
            f"made from '{present.transformation}'"
            if present.transformation
            else "loaded by others"
        )
        plan.problems.append(
            f"nodelet '{nodelet.name}' runs already, {made_from}; expected '{nodelet.label}'"
        )
    elif present.isolated != nodelet.isolated:
        plan.problems.append(
            f"nodelet '{nodelet.name}' runs already, {'' if present.isolated else 'not '}"
            "isolated; expected the contrary"
        )
    else:
        plan.kept.append(Kept(nodelet, present))


def _check_blueprint(plan: Plan, nodelet: WiredNodelet, blueprint: Transformation) -> None:
    if blueprint.type == TOPIC:
        plan.problems.append(
            f"nodelet '{nodelet.name}': transformation '{nodelet.label}' is an existing topic, "
            "not a nodelet"
        )


def _check_topics(plan: Plan, wiring: Wiring) -> None:
    """Find topics to which ports of different types are to be connected."""
    first: Dict[str, Tuple[str, str]] = {}
    for nodelet in wiring.nodelets:
        blueprint = plan.blueprints.get(nodelet.label)
        types = {port.name: port.datatype for port in blueprint.ports} if blueprint else {}
        for port, topic in nodelet.connections:
            datatype = types.get(port, "")
            if not datatype or datatype == "*":
                continue
            place = f"{nodelet.name}:{port}"
            other, present = first.setdefault(topic, (place, datatype))
            if not types_fit(present, datatype):
                plan.problems.append(
                    f"topic '{topic}': '{place}' has type {datatype}, '{other}' has {present}"
                )
