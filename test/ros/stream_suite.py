# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about streams: a library with tags, and the invariants."""

from __future__ import annotations

from typing import Any

import rosgraph
import rospy
from dyknow_msgs.msg import StreamEvent as StreamEventMessage
from graph import Heard, is_fed
from manager_suite import MANAGER, ManagerCase, ManagerProcess, library, listed, specification
from processes import eventually, nodes
from std_msgs.msg import String

from dyknow.errors import DyKnowError
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamEvent, StreamStatus
from dyknow.ros.wire.messages import event_from


def transformation(label: str, source: str, supplies: str, needs: str = "", cost: int = 1) -> str:
    """Write a transformation with tags on its port out and, if it has one, its port in."""
    ports = f"out>={supplies}" + (f" >in={needs}" if needs else "")
    return specification(label, f"dyknow_manager_test/{source}", ports, cost=cost)


FILTER = transformation("filter", "Moody", "Filtered(ball)", "Raw(?camera)")
SPARE_FILTER = transformation("spare filter", "Moody", "Filtered(ball)", "Raw(?camera)", 5)
TRACKER = transformation("tracker", "Relay", "Position(ball)", "Filtered(ball)")
CAMERA = transformation("camera", "Counter", "Raw(own)")
CEILING = transformation("ceiling", "Counter", "Raw(ceiling)", cost=9)
LIBRARY = library(CAMERA, CEILING, FILTER, TRACKER)
GOAL = "Position(ball)"


class Events(Heard):
    """Records the events of all claims, in order."""

    def __init__(self) -> None:
        topic = f"{MANAGER}/stream_events"
        super().__init__(topic, StreamEventMessage, event_from)
        eventually(lambda: is_fed(topic), 5.0, "events are heard")

    def reasons(self) -> list[str]:
        return [each.reason for each in self]

    def mended(self, cause: str = "", since: int = 0) -> StreamEvent:
        """Wait for a repair whose reason contains a text; returns its event."""

        def repairs() -> list[StreamEvent]:
            return [each for each in self[since:] if each.reason.startswith("mended")]

        def found() -> list[StreamEvent]:
            return [each for each in repairs() if cause in each.reason]

        eventually(found, 20.0, f"mended: {cause}", self.reasons)
        return found()[0]

    def changes(self, since: int = 0, claim_id: str = "") -> list[str]:
        """States and reasons, without changes of the detail alone; by default of all claims."""
        return [
            f"{each.after.state.name}: {each.reason}"
            for each in self[since:]
            if claim_id in ("", each.after.claim_id)
            and (each.before is None or each.before.state is not each.after.state)
        ]

    def is_one_loss(self, since: int = 0, claim_id: str = "") -> None:
        """One claim was mended, in one step."""
        states = [each.partition(":")[0] for each in self.changes(since, claim_id)]
        assert states == ["RECOVERING", "ACTIVE"], self.reasons()


class StreamCase(ManagerCase):
    """Each test has a manager with a library of tagged transformations, and no other node."""

    def tracking(self, **parameters: Any) -> ManagerProcess:
        manager = self.running(**parameters)
        manager.client.add_transformation(LIBRARY)
        return manager

    def events(self) -> Events:
        return self.enter(Events())

    def tell(self, nodelet: str, order: str) -> None:
        """Send an order to a nodelet that can misbehave on request."""
        # It stays for as long as the test, which would drop unsent messages otherwise.
        publisher = self.publisher(f"{nodelet}/order", String)
        eventually(publisher.get_num_connections, 5.0, f"{nodelet} listens")
        publisher.publish(order)

    def claim(self, manager: ManagerProcess, claim_id: str) -> StreamStatus:
        return next(each for each in manager.client.list_streams() if each.claim_id == claim_id)

    def become(self, manager: ManagerProcess, claim_id: str, state: ClaimState) -> None:
        """Wait until a claim is in a state."""
        eventually(
            lambda: self.claim(manager, claim_id).state is state,
            20.0,
            f"{claim_id} is {state.name}",
            lambda: f"{self.claim(manager, claim_id)}\n{manager.output}",
        )

    def delivers(self, manager: ManagerProcess, claim_id: str) -> None:
        """Wait until the manager knows that a claim's stream has delivered a message."""

        def does() -> bool:
            claim = self.claim(manager, claim_id)
            return claim.state is ClaimState.ACTIVE and not claim.detail

        eventually(does, 20.0, f"{claim_id} delivers", lambda: manager.output)

    def is_cleared(self, manager: ManagerProcess) -> None:
        """Wait until all nodelets are collected."""
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")

    def nodelet_of(self, manager: ManagerProcess, label: str) -> str:
        """Name of the one nodelet that was made from a transformation."""
        found = [
            each.name
            for each in manager.client.get_model().nodelets
            if each.transformation == label
        ]
        self.assertEqual(len(found), 1, f"{label}: {found}")
        return found[0]

    def settled(self, manager: ManagerProcess) -> None:
        """Wait until the invariants hold; fails with the violations."""
        wrong: list[str] = []

        def holds() -> bool:
            wrong[:] = _violations(manager)
            return not wrong

        eventually(holds, 10.0, "all is as it should be", lambda: f"{wrong}\n{manager.output}")


def _violations(manager: ManagerProcess) -> list[str]:
    """Violated invariants, judged by the nodelet managers' lists and the proxies."""
    found = []
    model = manager.client.get_model()
    claims = manager.claims()
    needed = {name for claim in claims for name in claim.nodelets}
    real = {name for child in manager.children() for name in listed(child) or ()}
    names = {each.name for each in model.nodelets}
    if real != names:
        found.append(f"the model has {sorted(names)}, reality {sorted(real)}")
    for nodelet in model.nodelets:
        if nodelet.state is not State.RUNNING:
            found.append(f"{nodelet.name} is {nodelet.state.name}")
            continue
        try:
            there = {port.name: port.topic for port in manager.client.get_config(nodelet.name)}
        except DyKnowError as error:  # it goes just now
            found.append(str(error))
            continue
        shown = {port.name: port.topic for port in nodelet.ports}
        if there != shown:
            found.append(f"{nodelet.name}: the model has {shown}, reality {there}")
    state = dict(rosgraph.Master(rospy.get_name()).getSystemState()[0])
    for claim in claims:
        if claim.state is not ClaimState.ACTIVE and not claim.detail:
            found.append(f"{claim.claim_id} is {claim.state.name} for no reason")
        if claim.state is ClaimState.ACTIVE:
            ports = [
                f"{nodelet.name}.{port.name}"
                for nodelet in model.nodelets
                for port in nodelet.ports
                if port.direction == "out" and port.topic == claim.topic
            ]
            alive = set(state.get(claim.topic, ())) & nodes()
            if len(ports) > 1 or len(alive) != 1:
                found.append(f"{claim.topic} is published by {ports} in {sorted(alive)}")
        missing = set(claim.nodelets) - names
        if claim.state is ClaimState.ACTIVE and missing:
            found.append(f"{claim.claim_id} needs {sorted(missing)}, which are not there")
    orphans = {name for name in names if name.startswith(OF_CLAIMS)} - needed
    if orphans:
        found.append(f"nobody needs {sorted(orphans)}")
    return found


#: Prefix of the names of nodelets that the manager makes for claims in these suites.
OF_CLAIMS = ("/camera", "/ceiling", "/filter", "/cheap", "/spare", "/tracker")
