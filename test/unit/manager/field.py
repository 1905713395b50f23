# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The soccer field on the fake host: a manager, a reconciler, and time that is moved by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple
from unittest import mock

from clocks import HandClock

from dyknow.errors import HostTimeout
from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.manager.claims.assembly import Acquired
from dyknow.manager.claims.reconciler import open_reconciler
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host
from dyknow.manager.library import Library
from dyknow.manager.specifications.template import Concepts
from dyknow.manager.store import Store
from dyknow.manager.supervision.lifecycle import ManagerContext
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.simulated.host import FakeHost

IMAGE, POINT = "sensor_msgs/Image", "geometry_msgs/PointStamped"
RELAY = {"dyknow/Relay": [("in", "in", "*"), ("out", "out", "*")]}
SOURCES = {
    "soccer/Camera": [("image", "out", IMAGE)],
    "soccer/Ceiling": [("image", "out", IMAGE)],
    "soccer/Subsampler": [("yuv", "in", IMAGE), ("planes", "out", IMAGE)],
    "soccer/Detector": [
        ("planes", "in", IMAGE),
        ("joints", "in", "sensor_msgs/JointState"),
        ("ball", "out", POINT),
    ],
    "soccer/Localization": [("ball", "in", POINT), ("position", "out", POINT)],
    **RELAY,
}
LIBRARY = """
<transformations>
  <transformation type="topic"><label>joints</label><source>/joint_states</source>
    <ports><port type="out" datatype="sensor_msgs/JointState">joints</port></ports>
    <tags><tag port="joints">Joints(nao)</tag></tags></transformation>
  <transformation><label>bottom camera</label><source>soccer/Camera</source>
    <ports><port type="out">image</port></ports>
    <tags><tag port="image">YUV(field)</tag></tags></transformation>
  <transformation cost="5"><label>ceiling camera</label><source>soccer/Ceiling</source>
    <ports><port type="out">image</port></ports>
    <tags><tag port="image">YUV(field)</tag></tags></transformation>
  <transformation><label>subsampler</label><source>soccer/Subsampler</source>
    <ports><port type="in">yuv</port><port type="out">planes</port></ports>
    <tags><tag port="yuv">YUV(?where)</tag><tag port="planes">Planes(field)</tag></tags>
    </transformation>
  <transformation><label>detector</label><source>soccer/Detector</source>
    <ports><port type="in">planes</port><port type="in">joints</port><port type="out">ball</port>
    </ports>
    <tags><tag port="planes">Planes(field)</tag><tag port="joints">Joints(?robot)</tag>
    <tag port="ball">RelativePosition(ball)</tag></tags></transformation>
  <transformation><label>localization</label><source>soccer/Localization</source>
    <ports><port type="in">ball</port><port type="out">position</port></ports>
    <tags><tag port="ball">RelativePosition(ball)</tag>
    <tag port="position">FieldPosition(ball)</tag></tags></transformation>
</transformations>
"""
GOAL = "FieldPosition(ball)"
Ports = Mapping[str, Tuple[str, Sequence[str]]]
"""For each port its direction and its tags."""
CHAIN = ["bottom camera", "detector", "localization", "subsampler"]
LINGER = 5.0
#: Reasons of events that come some time after each change of a stream.
FIRST_MESSAGE = "its first message has come"


def transformation(label: str, source: str, ports: str, tags: str, cost: int = 1) -> str:
    """Write a specification: ports as ``in NAME`` or ``out NAME``, tags as ``NAME Tag(x)``."""
    ways = (port.split() for port in ports.split(","))
    named: Dict[str, Tuple[str, List[str]]] = {name: (way, []) for way, name in ways}
    for tag in tags.split(";"):
        name, term = tag.split(maxsplit=1)
        named[name][1].append(term)
    return specification(label, source, named, cost)


def specification(label: str, source: str, ports: Ports, cost: int, datatype: str = "") -> str:
    carried = f' datatype="{datatype}"' if datatype else ""
    lines = [f'<transformation cost="{cost}"><label>{label}</label><source>{source}</source>']
    lines.append("<ports>")
    lines += [f'<port type="{way}"{carried}>{name}</port>' for name, (way, _) in ports.items()]
    lines.append("</ports><tags>")
    for name, (_, tags) in ports.items():
        lines += [f'<tag port="{name}">{tag}</tag>' for tag in tags]
    return "".join([*lines, "</tags></transformation>"])


def library(*transformations: str) -> str:
    return f"<transformations>{''.join(transformations)}</transformations>"


def topic(label: str, name: str, *tags: str, datatype: str = "") -> str:
    """Write the specification of a topic of ordinary nodes."""
    text = specification(label, name, {"out": ("out", tags)}, 1, datatype)
    return text.replace("<transformation", '<transformation type="topic"')


def counted_ids() -> Any:
    """A patch that numbers the ids of claims, which are processed in the order of their ids."""
    numbers = itertools.count(1)
    return mock.patch(
        "dyknow.manager.claims.reconciler.uuid.uuid4",
        lambda: mock.Mock(hex=f"{next(numbers):012x}"),
    )


class Field:
    """A manager, a reconciler, and time that is moved by hand."""

    def __init__(
        self,
        path: str = ":memory:",
        sources: Mapping[str, Sequence[Tuple[str, str, str]]] = SOURCES,
        library: str = LIBRARY,
        ontology: Optional[Concepts] = None,
    ) -> None:
        self.clock = HandClock()
        self.host = FakeHost(sources, clock=self.clock.now)
        self.ontology = ontology
        self.host.topics.add("/joint_states")
        self.path = path
        self.by_hand: Dict[str, bool] = {}
        self.paused = 0.0  # seconds for which everything stood still
        self.moving: set[str] = set()
        self.ended: set[str] = set()
        self.claim_topics: Dict[str, str] = {}
        self.open()
        if library:
            self.manager.add_transformation(library)

    def open(self) -> None:
        """Start a manager on the content of the store."""
        self.store = Store(self.path)
        host, store = self.seen_by_manager()
        library, graph = Library(store, self.ontology), Graph(store, self.clock)
        self.events: List[ClaimEvent] = []
        self.on_event: Callable[[ClaimEvent], None] = self.events.append
        self.reconciler = open_reconciler(
            ManagerContext(host, store, library, graph, clock=self.clock),
            self.sleep,
            lambda: self.now - self.paused,
            on_event=lambda event: self.on_event(event),
        )
        self.manager = self.reconciler.manager
        self.manager.start()

    def seen_by_manager(self) -> Tuple[Host, Store]:
        """Return the host and the store that the manager works with."""
        return self.host, self.store

    def kill_manager(self) -> None:
        """End the manager as kill -9 does, and start another."""
        self.open()

    @property
    def now(self) -> float:
        return self.clock.time

    def sleep(self, seconds: float) -> None:
        self.clock.time += seconds
        self.moving = self.host.flow()

    def pause(self, seconds: float) -> None:
        """Let everything stand still, as when a virtual machine is paused."""
        self.clock.time += seconds
        self.paused += seconds

    # Actions of users

    def spawn(self, label: str, name: str, **kwds: Any) -> None:
        self.manager.spawn(SpawnRequest(label, name, **kwds))
        self.by_hand[name] = True

    def destroy_by_hand(self, name: str) -> None:
        try:
            self.manager.destroy(name)
        except HostTimeout:  # it is destroyed as soon as its nodelet manager answers
            self.by_hand.pop(name, None)
            raise
        self.by_hand.pop(name, None)

    def acquire(self, tag: str = GOAL, **kwds: Any) -> Acquired:
        return self.reconciler.acquire(StreamRequest(tag, **kwds))

    def flowing(self, tag: str = GOAL, **kwds: Any) -> Claim:
        """Acquire a stream, and return its claim once it flows."""
        claim = self.acquire(tag, **kwds).claim
        self.settle()
        self.check_flows(claim)
        return claim

    def add(self, label: str, ports: Ports, cost: int = 1, params: str = "") -> str:
        """Add a transformation and its program; all its ports carry images. Return its source."""
        source = "lab/" + label.replace(" ", "_")
        self.host.sources[source] = [(name, way, IMAGE) for name, (way, _) in ports.items()]
        text = specification(label, source, ports, cost, IMAGE)
        self.manager.add_transformation(text.replace("<ports>", params + "<ports>"))
        return source

    # Passing of time

    def settle(self, seconds: float = 1.0) -> None:
        """Let time pass while the reconciler works; then check the invariants."""
        ticks = max(5, min(40, int(seconds / 0.2)))
        for _ in range(ticks):
            self.tick(seconds / ticks)
        self.check()

    def tick(self, seconds: float = 0.2) -> None:
        self.sleep(seconds)
        self.manager.look()
        self.reconciler.reconcile()

    def tidy(self) -> None:
        """Wait until nodelets that are no longer needed are gone."""
        self.settle(LINGER + 10.0)
        needed = set(self.by_hand)
        for claim in self.living():
            needed.update(claim.nodelets)
        assert set(self.host.running) <= needed, "no orphan"

    def check(self) -> None:
        records = {record.name: record for record in self.manager.graph.all()}
        there = set(self.host.running)
        assert there <= set(records), "the model shows all that runs"
        for name, record in records.items():
            if name not in there:
                assert record.state is not State.RUNNING, "the model shows what does not run"
                continue
            for port in self.host.nodelet(name).ports.values():
                topic = record.topics.get(port.name, "")
                if record.is_fixed and not topic:  # it uses a topic of its own
                    topic = f"{name}/disconnected/{port.name}"
                assert topic == port.topic
        assert set(self.by_hand) <= set(records), "nothing that was made by hand is removed"
        owners = {key.rpartition("/")[0] for key in self.host.parameters}
        assert owners <= set(records), "no parameter is left behind"
        self.check_claims()
        for claim in self.living():
            if claim.state is ClaimState.ACTIVE and claim.goal[0]:
                publishers = self.host.publishers(claim.topic)
                assert publishers == [claim.goal[0]], "one publisher on a claimed topic"

    def check_claims(self) -> None:
        """Check the records, events, parts and topics of claims in any state."""
        made = {each.name: each.label for each in self.manager.graph.all() if each.claimed}
        living = {claim.claim_id for claim in self.living()}
        assert set(self.store.read("claims", lambda key, text: text)) == living
        assert not self.ended & living, "what has ended stays ended"
        self.ended |= {claim.claim_id for claim in self.reconciler.claims()} - living
        last: Dict[str, Claim] = {}
        for event in self.events:
            known = last.get(event.after.claim_id)
            if known is not None:
                assert event.before is not None
                assert replace(event.before, deadline=known.deadline) == known, event.reason
            last[event.after.claim_id] = event.after
        for claim in self.living():
            parts = {made.get(name, "") for name in claim.nodelets}
            assert not parts & set(claim.request.exclude), "nothing excluded is made for it"
            assert claim.state is ClaimState.ACTIVE or claim.detail, "a reason is given"
            if claim.topic:
                topic = self.claim_topics.setdefault(claim.claim_id, claim.topic)
                assert claim.topic == topic, "its client listens where it did"

    # Claims and nodelets

    def living(self) -> List[Claim]:
        return [claim for claim in self.reconciler.claims() if not claim.state.ended]

    def claim(self, claim_id: str) -> Claim:
        return next(each for each in self.reconciler.claims() if each.claim_id == claim_id)

    def state(self, claim_id: str) -> ClaimState:
        return self.claim(claim_id).state

    def check_flows(self, *claims: Claim) -> None:
        """Each claim is whole, and its client listens where it did."""
        for claim in claims:
            assert self.state(claim.claim_id) is ClaimState.ACTIVE, self.reasons()
            assert self.claim(claim.claim_id).topic == claim.topic in self.moving

    def labels(self) -> List[str]:
        return sorted(record.label for record in self.manager.graph.all())

    def reasons(self) -> List[str]:
        return [event.reason for event in self.events]

    def mended(self) -> List[str]:
        found = [each for each in self.reasons() if "mended" in each]
        assert all(each.startswith("mended: ") for each in found), found
        return found
