# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The steps that carry out the plan of a load, each with its reversal, and what runs then."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Iterator, Mapping, Sequence

from dyknow.errors import DyKnowError
from dyknow.manager.steps import ReversibleStep, check_connected, spawning
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import Model, SpawnRequest, State
from dyknow.model.hosts import pins
from dyknow.model.streams import ClaimState, StreamStatus
from dyknow.model.transformation import Transformation
from dyknow.wiring.plan import Kept, LoadPlan
from dyknow.wiring.wiring import Wiring, request_of


def steps_of(plan: LoadPlan, client: BaseManagerClient) -> list[ReversibleStep]:
    """List the steps: ends of nodelets, transformations, new nodelets, changes of running ones."""
    pinned = pins(client.list_hosts()) if plan.remade else {}
    library = [*((None, each) for each in plan.added), *plan.replaced]
    made = [
        replace(each, manager="") if each.name in plan.any_manager else each for each in plan.made
    ]
    return [
        *(_end(each, request_of(each.present, pinned), plan, client) for each in plan.remade),
        *(_put(old, new, client) for old, new in library),
        *(step for each in made for step in making(each, plan.blueprints[each.label], client)),
        *(step for kept in plan.kept for step in _change(kept, client)),
    ]


def _put(
    old: Transformation | None, new: Transformation, client: BaseManagerClient
) -> ReversibleStep:
    """Add a transformation, or replace an old one."""

    def put_back() -> None:
        if old is None:
            client.remove_transformation(new.label)
        else:
            client.add_transformation(old.to_xml())

    return ReversibleStep(
        f"{'adding' if old is None else 'replacing'} transformation '{new.label}'",
        new.label,
        lambda: client.add_transformation(new.to_xml()),
        put_back,
    )


def _end(
    kept: Kept, former: SpawnRequest, plan: LoadPlan, client: BaseManagerClient
) -> ReversibleStep:
    """End a nodelet that is to be made again; ``former`` is the request that brings it back."""

    def bring_back() -> None:
        blueprint = plan.former.get(former.label)
        if blueprint is None:
            raise DyKnowError(f"the library has no '{former.label}' any more")
        make_again(former, blueprint, client)
        if kept.differences:
            raise DyKnowError("it runs again, but is made as the library says now")

    return ReversibleStep(
        f"ending '{former.name}'", former.name, lambda: client.destroy(former.name), bring_back
    )


def making(
    request: SpawnRequest, blueprint: Transformation, client: BaseManagerClient
) -> Iterator[ReversibleStep]:
    """Spawn a nodelet; ports that its transformation does not declare are connected then."""
    name = request.name
    declared, later = by_declaration(request, blueprint)
    yield spawning(replace(request, config=declared), client)
    if later:
        connect = partial(_connect_undeclared, name, later, client)
        # Nothing to undo: the connections go with the nodelet.
        yield ReversibleStep(f"connecting '{name}'", name, connect, lambda: None)


def make_again(
    request: SpawnRequest, blueprint: Transformation, client: BaseManagerClient
) -> None:
    """Spawn a nodelet that has ended, with all its connections."""
    for step in making(request, blueprint, client):
        step.do()


def _connect_undeclared(name: str, config: Mapping[str, str], client: BaseManagerClient) -> None:
    """Connect ports that are not declared.

    A C++ nodelet may not have them yet; it then puts them where its code says.
    """
    nodelet = client.get_graph().nodelet(name)
    if nodelet is not None and not nodelet.kind.is_written_for_dyknow:
        config = {port: topic for port, topic in config.items() if nodelet.port(port) is not None}
    if config:
        client.connect([(name, config)])


def by_declaration(
    nodelet: SpawnRequest, blueprint: Transformation
) -> tuple[dict[str, str], dict[str, str]]:
    """Split the connections into those of declared and of undeclared ports."""
    ports = {port.name for port in blueprint.ports}
    declared = {port: topic for port, topic in nodelet.config.items() if port in ports}
    return declared, {p: topic for p, topic in nodelet.config.items() if p not in ports}


def _change(kept: Kept, client: BaseManagerClient) -> Iterator[ReversibleStep]:
    name, wanted, present = kept.wanted.name, kept.wanted, kept.present
    moves = kept.moves
    if moves:
        before = {port: present.connections.get(port, "") for port in moves}
        yield ReversibleStep(
            f"connecting '{name}'",
            name,
            lambda: client.connect([(name, moves)]),
            lambda: client.connect([(name, before)]),
            lambda: check_connected(client, name, moves),
        )
    if wanted.is_protected != present.is_protected:
        yield ReversibleStep(
            f"{'protecting' if wanted.is_protected else 'unprotecting'} '{name}'",
            name,
            lambda: client.set_protection(name, wanted.is_protected),
            lambda: client.set_protection(name, present.is_protected),
        )


def unsettled(wiring: Wiring, model: Model, streams: Sequence[StreamStatus]) -> Iterator[str]:
    """Say what of a wiring does not run, and which claims that use it are not active."""
    wanted = {each.name for each in wiring.nodelets}
    for name in sorted(wanted):
        nodelet = model.nodelet(name)
        if nodelet is None:
            yield f"nodelet '{name}' is not there"
        elif nodelet.state is not State.RUNNING:
            why = f": {nodelet.detail}" if nodelet.detail else ""
            yield f"nodelet '{name}' is {nodelet.state.name.lower()}{why}"
    for claim in streams:
        is_active = claim.state is ClaimState.ACTIVE or claim.state.ended
        if not (is_active or wanted.isdisjoint(claim.nodelets)):
            why = f": {claim.detail}" if claim.detail else ""
            yield f"claim {claim.claim_id}, {claim.tag}, is {claim.state.name.lower()}{why}"
