"""Carries a plan out step by step, and takes the steps back when one fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict, List, Mapping, Optional, Protocol, Tuple

from dyknow.errors import DyKnowError, Refused
from dyknow.model.transformation import Transformation
from dyknow.wiring.plan import Kept, Plan
from dyknow.wiring.ports import connections_of
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


class LoadFailed(DyKnowError):
    """A step failed, and those before it were taken back; the text says if one could not be."""


@dataclass(frozen=True)
class Step:
    """Something to do, and how to take it back.

    Attributes:
        what: it in words, for people.
        subject: the nodelet or label that it is about.
        do: does it; raises DyKnowError.
        undo: takes it back.
    """

    what: str
    subject: str
    do: Callable[[], object]
    undo: Callable[[], object]


def steps_of(plan: Plan, client: Client) -> List[Step]:
    """List the steps: what makes way, transformations, new nodelets, changes of those that run."""
    steps = [_end(each, plan, client) for each in plan.remade]
    steps.extend(_add(each, client) for each in plan.added)
    steps.extend(_replace(old, new, client) for old, new in zip(plan.replaced, plan.replacing))
    for nodelet in plan.made:
        steps.extend(_make(nodelet, plan, client))
    for kept in plan.kept:
        steps.extend(_change(kept, client))
    return steps


def carry_out(steps: List[Step], keep_going: bool = False) -> List[Tuple[Step, DyKnowError]]:
    """Do the steps in order.

    Args:
        steps: What to do.
        keep_going: Go on after a step that failed, and leave what was done.

    Returns:
        The steps that failed, and why; none unless `keep_going`.

    Raises:
        LoadFailed: A step failed; everything is as it was.
    """
    done: List[Step] = []
    failed: List[Tuple[Step, DyKnowError]] = []
    for step in steps:
        try:
            step.do()
            done.append(step)
        except DyKnowError as error:
            if not keep_going:
                # What was refused was not done; what was not answered may have been.
                maybe = [] if isinstance(error, Refused) else [step]
                troubles = _take_back(done, maybe)
                words = [f"{step.what}: {error}", *(troubles or ["everything is as it was"])]
                raise LoadFailed("; ".join(words)) from error
            failed.append((step, error))
        except BaseException:
            _take_back(done, [step])
            raise
    return failed


def _take_back(done: List[Step], maybe: List[Step]) -> List[str]:
    troubles = []
    for step in [*maybe, *reversed(done)]:
        try:
            step.undo()
        except DyKnowError as error:
            if step not in maybe:  # else there was probably nothing to take back
                troubles.append(f"cannot take back '{step.what}': {error}")
    return troubles


def _nothing() -> None:
    """Take back a step that leaves nothing behind by itself."""


def _add(transformation: Transformation, client: Client) -> Step:
    label = transformation.label
    return Step(
        f"adding transformation '{label}'",
        label,
        lambda: client.add_transformation(transformation.to_xml()),
        lambda: client.remove_transformation(label),
    )


def _replace(old: Transformation, new: Transformation, client: Client) -> Step:
    return Step(
        f"replacing transformation '{new.label}'",
        new.label,
        lambda: client.add_transformation(new.to_xml()),
        lambda: client.add_transformation(old.to_xml()),
    )


def _end(kept: Kept, plan: Plan, client: Client) -> Step:
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

    return Step(
        f"ending '{former.name}'",
        former.name,
        lambda: client.destroy(former.name),
        bring_back,
    )


def _make(nodelet: WiredNodelet, plan: Plan, client: Client) -> List[Step]:
    """Spawn a nodelet; ports that its transformation does not declare are connected then."""
    config, later = _by_declaration(nodelet, plan.blueprints[nodelet.label])
    manager = "" if nodelet.name in plan.any_manager else nodelet.manager

    def destroy() -> None:
        if nodelet.is_protected:
            client.set_protection(nodelet.name, False)
        client.destroy(nodelet.name)

    steps = [
        Step(
            f"spawning '{nodelet.name}'",
            nodelet.name,
            lambda: _spawn(client, nodelet, config, manager),
            destroy,
        )
    ]
    if later:
        steps.append(
            Step(
                f"connecting '{nodelet.name}'",
                nodelet.name,
                lambda: client.set_config(nodelet.name, later),
                _nothing,
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


def _change(kept: Kept, client: Client) -> List[Step]:
    name, wanted, present = kept.wanted.name, kept.wanted, kept.present
    steps = []
    moves = kept.moves
    if moves:
        before: Dict[str, str] = {port: connections_of(present).get(port, "") for port in moves}
        steps.append(
            Step(
                f"connecting '{name}'",
                name,
                lambda: client.set_config(name, moves),
                lambda: client.set_config(name, before),
            )
        )
    if wanted.is_protected != present.is_protected:
        steps.append(
            Step(
                f"{'protecting' if wanted.is_protected else 'unprotecting'} '{name}'",
                name,
                lambda: client.set_protection(name, wanted.is_protected),
                lambda: client.set_protection(name, present.is_protected),
            )
        )
    return steps
