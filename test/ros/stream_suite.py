# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about streams: a library with tags, and the invariants."""

from __future__ import annotations

import time
from typing import Any

import rosgraph
import rospy
from dyknow_msgs.msg import StreamEvent as StreamEventMessage
from graph import is_fed
from manager_suite import MANAGER, ManagerCase, ManagerProcess, eventually, listed, nodes
from std_msgs.msg import Header, String

from dyknow.errors import DyKnowError
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamEvent, StreamStatus
from dyknow.ros.wire.messages import event_from


def transformation(label: str, source: str, supplies: str, needs: str = "", cost: int = 1) -> str:
    """Write a transformation with tags on its port out and, if it has one, its port in."""
    ports, tags = '<port type="out">out</port>', f'<tag port="out">{supplies}</tag>'
    if needs:
        ports += '<port type="in">in</port>'
        tags += f'<tag port="in">{needs}</tag>'
    return (
        f'<transformation cost="{cost}"><label>{label}</label>'
        f"<source>dyknow_manager_test/{source}</source>"
        f"<ports>{ports}</ports><tags>{tags}</tags></transformation>"
    )


FILTER = transformation("filter", "Moody", "Filtered(ball)", "Raw(?camera)")
SPARE_FILTER = transformation("spare filter", "Moody", "Filtered(ball)", "Raw(?camera)", 5)
TRACKER = transformation("tracker", "Relay", "Position(ball)", "Filtered(ball)")
CAMERA = transformation("camera", "Counter", "Raw(own)")
CEILING = transformation("ceiling", "Counter", "Raw(ceiling)", cost=9)
SENSOR = (
    '<transformation type="topic"><label>sensor</label><source>/sensor/raw</source>'
    '<ports><port type="out" datatype="std_msgs/Header">out</port></ports>'
    '<tags><tag port="out">Raw(sensor)</tag></tags></transformation>'
)
LIBRARY = f"<transformations>{CAMERA}{CEILING}{FILTER}{TRACKER}</transformations>"
GOAL = "Position(ball)"


class Flow:
    """Records the times at which messages arrive on a topic."""

    def __init__(self, topic: str) -> None:
        self.arrivals: list[float] = []
        self._subscriber = rospy.Subscriber(topic, Header, self._note, queue_size=1000)

    def _note(self, message: Header) -> None:
        self.arrivals.append(time.monotonic())

    def close(self) -> None:
        self._subscriber.unregister()

    def wait(self, timeout: float = 5.0) -> float:
        """Wait until it flows again; returns how long (s) that took."""
        count = len(self.arrivals)
        return eventually(lambda: len(self.arrivals) > count + 2, timeout, "messages arrive")

    def longest_pause(self, since: float) -> float:
        """Longest time (s) without a message, counted from the last message before ``since``."""
        before = [when for when in self.arrivals if when <= since][-1:]
        times = before + [when for when in self.arrivals if when > since]
        return max((later - earlier for earlier, later in zip(times, times[1:])), default=0.0)


class Events:
    """Records the events of all claims, in order."""

    def __init__(self) -> None:
        self.all: list[StreamEvent] = []
        self._subscriber = rospy.Subscriber(
            f"{MANAGER}/stream_events",
            StreamEventMessage,
            lambda message: self.all.append(event_from(message)),
            queue_size=1000,
        )

    def close(self) -> None:
        self._subscriber.unregister()

    def mended(self, cause: str, timeout: float = 10.0) -> None:
        """Wait for a repair whose reason contains a text."""

        def is_mended() -> bool:
            reasons = [each.reason for each in list(self.all)]
            return any(text.startswith("mended") and cause in text for text in reasons)

        eventually(is_mended, timeout, f"mended: {cause}")

    def states(self, claim_id: str) -> list[ClaimState]:
        return [each.after.state for each in list(self.all) if each.after.claim_id == claim_id]


class StreamCase(ManagerCase):
    """Each test has a manager with a library of tagged transformations, and no other node."""

    def tracking(self, **parameters: Any) -> ManagerProcess:
        manager = self.running(**parameters)
        manager.client.add_transformation(LIBRARY)
        return manager

    def flow(self, topic: str) -> Flow:
        flow = Flow(topic)
        self.addCleanup(flow.close)
        return flow

    def events(self) -> Events:
        events = Events()
        self.addCleanup(events.close)
        eventually(lambda: is_fed(f"{MANAGER}/stream_events"), 5.0, "events are heard")
        return events

    def tell(self, nodelet: str, order: str) -> None:
        """Send an order to a nodelet that can misbehave on request."""
        publisher = rospy.Publisher(f"{nodelet}/order", String, queue_size=1)
        self.addCleanup(publisher.unregister)  # not before, which would drop unsent messages
        eventually(publisher.get_num_connections, 5.0, f"{nodelet} listens")
        publisher.publish(order)

    def claim(self, manager: ManagerProcess, claim_id: str) -> StreamStatus:
        return next(each for each in manager.client.list_streams() if each.claim_id == claim_id)

    def become(
        self, manager: ManagerProcess, claim_id: str, state: ClaimState, timeout: float = 10.0
    ) -> float:
        """Wait until a claim is in a state; returns how long (s) that took."""
        return eventually(
            lambda: self.claim(manager, claim_id).state is state,
            timeout,
            f"{claim_id} is {state.name}",
        )

    def nodelet_of(self, manager: ManagerProcess, label: str) -> str:
        """Name of the one nodelet that was made from a transformation."""
        found = [
            each.name
            for each in manager.client.get_model().nodelets
            if each.transformation == label
        ]
        self.assertEqual(len(found), 1, f"{label}: {found}")
        return found[0]

    def settled(self, manager: ManagerProcess, timeout: float = 10.0) -> None:
        """Wait until the invariants hold; fails with the violations."""
        wrong: list[str] = []

        def holds() -> bool:
            wrong[:] = _violations(manager)
            return not wrong

        eventually(holds, timeout, "all is as it should be", lambda: f"{wrong}\n{manager.output}")


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
