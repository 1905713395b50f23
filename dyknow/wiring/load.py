# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The steps that carry out the plan of a load, each with its reversal."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Mapping, Tuple

from dyknow.errors import DyKnowError
from dyknow.manager.steps import ReversibleStep
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import SpawnRequest
from dyknow.model.transformation import Transformation
from dyknow.wiring.plan import Kept, LoadPlan


def steps_of(plan: LoadPlan, client: BaseManagerClient) -> List[ReversibleStep]:
    """List the steps: ends of nodelets, transformations, new nodelets, changes of running ones."""
    steps = [_end(each, plan, client) for each in plan.remade]
    steps.extend(_add(each, client) for each in plan.added)
    steps.extend(_replace(old, new, client) for old, new in zip(plan.replaced, plan.replacing))
    for nodelet in plan.made:
        steps.extend(_make(nodelet, plan, client))
    for kept in plan.kept:
        steps.extend(_change(kept, client))
    return steps


def _add(transformation: Transformation, client: BaseManagerClient) -> ReversibleStep:
    label = transformation.label
    return ReversibleStep(
        f"adding transformation '{label}'",
        label,
        lambda: client.add_transformation(transformation.to_xml()),
        lambda: client.remove_transformation(label),
    )


def _replace(
    old: Transformation, new: Transformation, client: BaseManagerClient
) -> ReversibleStep:
    return ReversibleStep(
        f"replacing transformation '{new.label}'",
        new.label,
        lambda: client.add_transformation(new.to_xml()),
        lambda: client.add_transformation(old.to_xml()),
    )


def _end(kept: Kept, plan: LoadPlan, client: BaseManagerClient) -> ReversibleStep:
    """End a nodelet that is to be made again."""
    former = kept.present.request

    def bring_back() -> None:
        blueprint = plan.former.get(former.label)
        if blueprint is None:
            raise DyKnowError(f"the library has no '{former.label}' any more")
        declared, later = _by_declaration(former, blueprint)
        client.spawn_nodelet(replace(former, config=declared))
        _connect_undeclared(former.name, later, client)
        if kept.differences:
            raise DyKnowError("it runs again, but is made as the library says now")

    return ReversibleStep(
        f"ending '{former.name}'",
        former.name,
        lambda: client.destroy(former.name),
        bring_back,
    )


def _make(
    nodelet: SpawnRequest, plan: LoadPlan, client: BaseManagerClient
) -> List[ReversibleStep]:
    """Spawn a nodelet; ports that its transformation does not declare are connected then."""
    config, later = _by_declaration(nodelet, plan.blueprints[nodelet.label])
    manager = "" if nodelet.name in plan.any_manager else nodelet.manager
    request = replace(nodelet, config=config, manager=manager)

    def destroy() -> None:
        if nodelet.is_protected:
            client.set_protection(nodelet.name, False)
        client.destroy(nodelet.name)

    steps = [
        ReversibleStep(
            f"spawning '{nodelet.name}'",
            nodelet.name,
            lambda: client.spawn_nodelet(request),
            destroy,
        )
    ]
    if later:
        steps.append(
            ReversibleStep(
                f"connecting '{nodelet.name}'",
                nodelet.name,
                lambda: _connect_undeclared(nodelet.name, later, client),
                lambda: None,  # it goes with the nodelet
            )
        )
    return steps


def _connect_undeclared(name: str, config: Mapping[str, str], client: BaseManagerClient) -> None:
    """Connect ports that are not declared.

    A C++ nodelet may not have them yet; it then puts them where its code says.
    """
    nodelet = client.get_graph().nodelet(name) if config else None
    if nodelet is not None and not nodelet.kind.is_written_for_dyknow:
        config = {port: topic for port, topic in config.items() if nodelet.port(port) is not None}
    if config:
        client.set_config(name, config)


def _by_declaration(
    nodelet: SpawnRequest, blueprint: Transformation
) -> Tuple[Dict[str, str], Dict[str, str]]:
    """Split the connections into those of declared and of undeclared ports."""
    declared = {port.name for port in blueprint.ports}
    connections = nodelet.config.items()
    return (
        {port: topic for port, topic in connections if port in declared},
        {port: topic for port, topic in connections if port not in declared},
    )


def _change(kept: Kept, client: BaseManagerClient) -> List[ReversibleStep]:
    name, wanted, present = kept.wanted.name, kept.wanted, kept.present
    steps = []
    moves = kept.moves
    if moves:
        before: Dict[str, str] = {port: present.connections.get(port, "") for port in moves}
        steps.append(
            ReversibleStep(
                f"connecting '{name}'",
                name,
                lambda: client.connect([(name, moves)]),
                lambda: client.connect([(name, before)]),
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
