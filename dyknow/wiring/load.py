"""The steps that carry out the plan of a load, each with what takes it back."""

from __future__ import annotations

from typing import Dict, List, Mapping, Optional, Protocol, Tuple

from dyknow.errors import DyKnowError
from dyknow.model.transformation import Transformation
from dyknow.wiring.plan import Kept, Plan
from dyknow.wiring.ports import connections_of
from dyknow.wiring.steps import ReversibleStep
from dyknow.wiring.wiring import WiredNodelet


class Client(Protocol):
    """What a load needs of the manager and the proxies; every method raises DyKnowError."""

    def add_transformation(self, specification: str) -> object:
        """Add what a specification says."""

    def remove_transformation(self, label: str) -> None:
        """Remove a transformation."""

    def spawn(
        self,
        label: str,
        name: str,
        config: Optional[Mapping[str, str]] = None,
        is_protected: bool = False,
        isolated: bool = False,
        manager: str = "",
    ) -> None:
        """Make a nodelet."""

    def destroy(self, name: str) -> None:
        """End a nodelet."""

    def set_protection(self, name: str, is_protected: bool) -> None:
        """Protect a nodelet, or release it."""

    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet, all or none."""


def steps_of(plan: Plan, client: Client) -> List[ReversibleStep]:
    """List the steps: what makes way, transformations, new nodelets, changes of those that run."""
    steps = [_end(each, plan, client) for each in plan.remade]
    steps.extend(_add(each, client) for each in plan.added)
    steps.extend(_replace(old, new, client) for old, new in zip(plan.replaced, plan.replacing))
    for nodelet in plan.made:
        steps.extend(_make(nodelet, plan, client))
    for kept in plan.kept:
        steps.extend(_change(kept, client))
    return steps


def _add(transformation: Transformation, client: Client) -> ReversibleStep:
    label = transformation.label
    return ReversibleStep(
        f"adding transformation '{label}'",
        label,
        lambda: client.add_transformation(transformation.to_xml()),
        lambda: client.remove_transformation(label),
    )


def _replace(old: Transformation, new: Transformation, client: Client) -> ReversibleStep:
    return ReversibleStep(
        f"replacing transformation '{new.label}'",
        new.label,
        lambda: client.add_transformation(new.to_xml()),
        lambda: client.add_transformation(old.to_xml()),
    )


def _end(kept: Kept, plan: Plan, client: Client) -> ReversibleStep:
    """End a nodelet that is to be made anew."""
    former = WiredNodelet.of(kept.present)

    def bring_back() -> None:
        blueprint = plan.former.get(former.label)
        if blueprint is None:
            raise DyKnowError(f"the library has no '{former.label}' any more")
        declared, later = _by_declaration(former, blueprint)
        _spawn(client, former, declared, former.manager)
        if later:
            client.set_config(former.name, later)
        if kept.differences:
            raise DyKnowError("it runs again, but is made as the library says now")

    return ReversibleStep(
        f"ending '{former.name}'",
        former.name,
        lambda: client.destroy(former.name),
        bring_back,
    )


def _make(nodelet: WiredNodelet, plan: Plan, client: Client) -> List[ReversibleStep]:
    """Spawn a nodelet; ports that its transformation does not declare are connected then."""
    config, later = _by_declaration(nodelet, plan.blueprints[nodelet.label])
    manager = "" if nodelet.name in plan.any_manager else nodelet.manager

    def destroy() -> None:
        if nodelet.is_protected:
            client.set_protection(nodelet.name, False)
        client.destroy(nodelet.name)

    steps = [
        ReversibleStep(
            f"spawning '{nodelet.name}'",
            nodelet.name,
            lambda: _spawn(client, nodelet, config, manager),
            destroy,
        )
    ]
    if later:
        steps.append(
            ReversibleStep(
                f"connecting '{nodelet.name}'",
                nodelet.name,
                lambda: client.set_config(nodelet.name, later),
                lambda: None,  # it goes with the nodelet
            )
        )
    return steps


def _by_declaration(
    nodelet: WiredNodelet, blueprint: Transformation
) -> Tuple[Dict[str, str], Dict[str, str]]:
    """Split the connections into those of declared ports and the others."""
    declared = {port.name for port in blueprint.ports}
    connections = nodelet.connections
    return (
        {port: topic for port, topic in connections if port in declared},
        {port: topic for port, topic in connections if port not in declared},
    )


def _spawn(client: Client, nodelet: WiredNodelet, config: Dict[str, str], manager: str) -> None:
    client.spawn(
        nodelet.label, nodelet.name, config, nodelet.is_protected, nodelet.isolated, manager
    )


def _change(kept: Kept, client: Client) -> List[ReversibleStep]:
    name, wanted, present = kept.wanted.name, kept.wanted, kept.present
    steps = []
    moves = kept.moves
    if moves:
        before: Dict[str, str] = {port: connections_of(present).get(port, "") for port in moves}
        steps.append(
            ReversibleStep(
                f"connecting '{name}'",
                name,
                lambda: client.set_config(name, moves),
                lambda: client.set_config(name, before),
            )
        )
    if wanted.is_protected != present.is_protected:
        steps.append(
            ReversibleStep(
                f"{'protecting' if wanted.is_protected else 'unprotecting'} '{name}'",
                name,
                lambda: client.set_protection(name, wanted.is_protected),
                lambda: client.set_protection(name, present.is_protected),
            )
        )
    return steps
