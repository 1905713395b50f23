# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""No in-port ever receives a stream that it does not demand, under any sequence of events.

Libraries, clients, users and accidents are random; a witness checks after every single change of
the fake host, and again after each round of the manager.
"""

from __future__ import annotations

import itertools
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import pytest
from hypothesis import HealthCheck
from hypothesis import strategies as st
from hypothesis.stateful import (
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from property_tests import examples
from unit.manager.faulty_lives import NUMBERS, FaultyLife
from unit.manager.field import RELAY, Field, specification, topic
from unit.manager.witness import Concepts, Witness, variables_in

from dyknow.errors import DyKnowError, HostError
from dyknow.model.graph import SpawnRequest
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Parameter

CONCEPTS = Concepts({"Frame": "Image", "left": "camera", "right": "camera"})
TYPE = "test/Signed"
GROUND = ["Image(left)", "Image(right)", "Frame(left)", "Ball(red)", "Ball(blue)", "Goal(red)"]
OPEN = ["Image(?c)", "Image(camera)", "Frame(?c)", "Ball(?b)", "Image(?b: camera)", "Goal(?c)"]
BOUND = ["Frame(?c)", "Ball(?c)", "Ball(?b)", "Goal(?b)"]
SUPPLIED = st.lists(st.sampled_from(GROUND), min_size=1, max_size=2, unique=True)
SENT = st.lists(st.sampled_from(GROUND + BOUND), min_size=1, max_size=2, unique=True)
DEMANDED = st.sampled_from(GROUND + OPEN)
LABELS = st.sampled_from([f"part {letter}" for letter in "abcdef"])
ORDINARY = st.sampled_from(["/sensor", "/other_sensor"])
PLAN = st.tuples(
    st.lists(DEMANDED, max_size=2),
    st.lists(SENT, min_size=1, max_size=2),
    st.integers(0, 3),
    st.sampled_from([False, False, False, True]),
    st.booleans(),
)


class Truth(FaultyLife):
    """A library, claims, and all faults."""

    def __init__(self) -> None:
        super().__init__()
        self.witness = Witness(self.field.host, CONCEPTS)
        self.witness.claims = lambda: self.field.reconciler.claims()
        self.witness.given = self.given
        self.types = itertools.count(1)
        self.hands = itertools.count(1)
        self.stock()

    @initialize(is_heard=st.booleans())
    def begin(self, is_heard: bool) -> None:
        """Half of the lives begin with a claim, and a nodelet that listens to its stream."""
        if is_heard:
            self.field.acquire("Frame(?c)")
            self.listen(0)

    @rule()
    def stock(self) -> None:
        """Describe, and describe again, the transformations that the library begins with."""
        self.add("part a", [], [["Image(left)"]])
        self.add("part b", [], [["Image(right)"]], cost=2)
        self.add("part c", ["Image(?c)"], [["Frame(?c)"]])
        self.add("part d", ["Image(?c)"], [["Ball(red)"], ["Ball(blue)"]])
        self.add("part e", ["Ball(?b)", "Image(?c)"], [["Goal(?b)"]], is_filled=True)
        self.add("part f", ["Image(?c)", "Frame(?c)"], [["Ball(?c)"]])

    def make_field(self, path: str) -> Field:
        made = Field(path, RELAY, "", CONCEPTS)
        made.host.topics.clear()
        return made

    def after_kill(self) -> None:
        self.witness.excuse()

    def after_hang(self) -> None:
        self.field.manager.look()
        self.forgive()

    def teardown(self) -> None:
        self.end_faults()
        self.witness.excuse()  # connections by people while some nodelets could not be reached
        self.arrive_late()
        self.witness.excuse()
        for _ in range(3):
            self.pass_time(60.0)
        for claim in self.field.living():
            states = (ClaimState.ACTIVE, ClaimState.PENDING, ClaimState.DEGRADED)
            # The part that could make it, or one in its way, is fixed where a person connected it.
            has_no_live_ports = "are fixed" in claim.detail or "has fixed" in claim.detail
            assert claim.state in states or has_no_live_ports, (claim.state, claim.detail)
            if claim.state is ClaimState.ACTIVE and not self.witness.by_hand:
                assert claim.topic in self.field.moving, claim
        self.close()

    # Clients

    @rule(tag=DEMANDED, silence=st.sampled_from([0.0, 0.0, 1.0]), exclude=st.booleans())
    def acquire(self, tag: str, silence: float, exclude: bool) -> None:
        labels = ("part a",) if exclude else ()
        self.asked(lambda: self.field.acquire(tag, max_silence=silence, exclude=labels))

    # The library

    @rule(label=LABELS, plan=PLAN)
    def describe(self, label: str, plan) -> None:
        self.add(label, *plan)

    def add(
        self,
        label: str,
        demanded: Sequence[str],
        supplied: Sequence[Sequence[str]],
        cost: int = 1,
        is_plain: bool = False,
        is_filled: bool = False,
    ) -> None:
        source = f"test/T{next(self.types)}"
        variables = variables_in(demanded)
        supplied = [[tag for tag in tags if variables_in([tag]) <= variables] for tags in supplied]
        named: Dict[str, Tuple[str, Sequence[str]]] = {
            f"in{number}": ("in", (tag,)) for number, tag in enumerate(demanded)
        }
        for number, tags in enumerate(supplied):
            named[f"out{number}"] = ("out", tuple(tags))
        self.field.host.sources[source] = [(name, way, TYPE) for name, (way, _) in named.items()]
        if is_plain:
            self.field.host.cpp.add(source)
            self.field.host.stock = True
        self.witness.signed[source] = {name: tags for name, (_, tags) in named.items()}
        text = specification(label, source, named, cost, TYPE)
        if is_filled:
            params = "".join(
                f'<param name="{each[1:]}" type="string">${{{each}}}</param>'
                for each in sorted(variables)
            )
            text = text.replace("<ports>", f"<params>{params}</params><ports>")
        self.field.manager.add_transformation(text)
        self.witness.described.pop(label, None)
        self.witness.excuse()

    @rule(label=LABELS, name=ORDINARY, tags=SUPPLIED)
    def describe_topic(self, label: str, name: str, tags: List[str]) -> None:
        text = topic(label, name, *tags, datatype=TYPE)
        self.field.manager.add_transformation(text)
        self.witness.described[label] = (name, tuple(tags))
        self.witness.excuse()

    @precondition(lambda self: self.beginnings())
    @rule(number=NUMBERS)
    def withdraw(self, number: int) -> None:
        """Remove the first part of a claim's stream: another one may replace it."""
        self.remove(self.any_of(self.beginnings(), number))

    @rule(label=LABELS)
    def remove(self, label: str) -> None:
        self.asked(lambda: self.field.manager.remove_transformation(label))
        self.witness.described.pop(label, None)
        self.witness.excuse()

    # Users

    @rule(label=LABELS, numbers=st.lists(NUMBERS, min_size=4, max_size=4))
    def spawn(self, label: str, numbers: List[int]) -> None:
        name = f"/by_hand_{next(self.hands)}"
        topics = ["", *self.topics(), f"{name}/own"]
        try:
            ports = self.field.manager.library.get(label).ports
        except DyKnowError:
            return
        config = {port.name: topics[number % len(topics)] for port, number in zip(ports, numbers)}
        tags = [tag for port in ports for tag in port.tags]
        names = ("left", "right", "red", "blue")
        given = tuple(
            Parameter(variable, "string", names[numbers[-1] % len(names)])
            for variable in sorted(variables_in(tags))
        )
        given = given if numbers[0] % 2 else ()
        self.make_by_hand(SpawnRequest(label, name, config, parameters=given))

    @precondition(lambda self: self.witness.bound())
    @rule(number=NUMBERS)
    def listen(self, number: int) -> None:
        """Spawn a nodelet that listens only to the output of a claim's nodelet."""
        topic, tag = self.any_of(self.witness.bound(), number)
        self.add("listener", [tag], [])
        name = f"/by_hand_{next(self.hands)}"
        self.make_by_hand(SpawnRequest("listener", name, {"in0": topic}))

    def make_by_hand(self, request: SpawnRequest) -> None:
        self.witness.by_hand.add(request.name)
        self.asked(lambda: self.field.manager.spawn(request))
        self.forgive()

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def destroy(self, number: int) -> None:
        name = self.any_nodelet(number)
        self.asked(lambda: self.field.manager.destroy(name))
        self.forgive()

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS, port=NUMBERS, topic=NUMBERS)
    def connect(self, number: int, port: int, topic: int) -> None:
        host = self.field.host
        name = self.any_nodelet(number)
        is_plain = host.nodelet(name).request.source in host.cpp
        if is_plain or host.is_hung(self.field.manager.graph.get(name).manager):
            return
        ports = sorted(host.nodelet(name).ports)
        topics = ["", *self.topics(), "/by/hand"]
        fail, host.fail = host.fail, lambda operation, argument: None
        slow, host.slow = host.slow, set()
        config = {ports[port % len(ports)]: topics[topic % len(topics)]}
        self.asked(lambda: host.connect(name, config))
        host.fail, host.slow = fail, slow
        self.forgive()
        self.field.manager.look()

    # Accidents

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def vanish(self, number: int) -> None:
        self.field.host.vanish(self.any_nodelet(number))
        self.witness.excuse()

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def silence(self, number: int) -> None:
        self.field.host.silent.add(self.any_nodelet(number))

    @precondition(lambda self: self.field.host.silent)
    @rule()
    def speak(self) -> None:
        self.field.host.silent.clear()

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def slow(self, number: int) -> None:
        self.field.host.slow.add(self.any_nodelet(number))

    @precondition(lambda self: self.field.host.slow)
    @rule()
    def arrive(self) -> None:
        self.field.host.slow.clear()
        self.arrive_late()

    @rule(operation=st.sampled_from(["load", "connect", "unload", "ports"]), number=NUMBERS)
    def fail(self, operation: str, number: int) -> None:
        left = [number % 6]

        def fail(what: str, argument: str) -> None:
            if what == operation:
                left[0] -= 1
                if left[0] == 0:
                    raise HostError("it is broken")

        self.field.host.fail = fail

    @rule(topic=ORDINARY, there=st.booleans())
    def sensor(self, topic: str, there: bool) -> None:
        topics = self.field.host.topics
        (topics.add if there else topics.discard)(topic)
        self.witness.excuse()

    @rule(seconds=st.sampled_from([1.0, 10.0]))
    def wait(self, seconds: float) -> None:
        self.pass_time(seconds)

    # Invariants

    @invariant()
    def holds(self) -> None:
        assert self.witness.guilt == [], "the manager connected what does not fit"
        self.pass_time(0.4)

    def pass_time(self, seconds: float) -> None:
        for _ in range(2):
            self.field.tick(seconds / 2)
            assert self.witness.guilt == [], "the manager connected what does not fit"
        for _ in range(5):  # failed calls are tried again, after pauses that grow
            if self.witness.lasting() or self.witness.fed_while_pending():
                self.field.tick(10.0)
        assert not self.witness.lasting(), "and what others connected does not last"
        assert self.witness.fed_while_pending() == []

    # How it is done

    def given(self, name: str) -> Mapping[str, str]:
        record = self.field.manager.graph.find(name)
        return record.given if record is not None else {}

    def beginnings(self) -> List[str]:
        """Labels of nodelets without in-ports that claims need, as long as they are described."""
        known = {each.label for each in self.field.manager.library.all()}
        return sorted(
            {
                record.label
                for claim in self.field.living()
                for name in claim.nodelets
                for record in [self.field.manager.graph.find(name)]
                if record is not None and record.label in known
                if not any(port.direction == "in" for port in record.ports)
            }
        )

    def topics(self) -> List[str]:
        """Every topic to which a port is connected."""
        host = self.field.host
        return sorted(
            {
                port.topic
                for name in host.running
                for port in host.nodelet(name).ports.values()
                if port.topic and "/disconnected/" not in port.topic  # private topics
            }
            | {"/sensor", "/other_sensor"}
        )

    def arrive_late(self) -> None:
        """Let late connections arrive; wrong ones at nodelets made by hand count as people's."""
        self.field.host.arrive()
        by_hand = self.witness.by_hand
        self.witness.guilt = [
            (wrong, call)
            for wrong, call in self.witness.guilt
            if not by_hand & {wrong[0], wrong[3].partition(".")[0]}
        ]
        self.field.manager.look()

    def forgive(self) -> None:
        """Blame the manager for nothing that people have just done."""
        self.witness.guilt.clear()
        self.witness.excuse()


def check(count: int, steps: int, **kwds: bool) -> None:
    run_state_machine_as_test(
        Truth,
        settings=examples(
            count,
            stateful_step_count=steps,
            database=None,
            suppress_health_check=list(HealthCheck),
            **kwds,
        ),
    )


def test_nobody_receives_what_was_not_asked_for() -> None:
    check(40, 25, derandomize=True)


PLAIN_SENDER = ([], [["Ball(?b)"], ["Ball(?b)", "Ball(?c)"]], 2, True, False)
PLAIN_LISTENER = (["Frame(?c)", "Ball(blue)"], [["Image(left)"], ["Ball(blue)"]], 3, True, True)
HUNG_AND_NOT_DESCRIBED: List[Sequence[Any]] = [
    ("begin", True),
    ("sensor", "/sensor", True),
    ("describe_topic", "part f", "/sensor", ["Ball(red)", "Image(left)"]),
    ("hang", 0, True),
    ("vanish", 0),
    ("hang", 1, True),
    ("stock",),
]
LIVES: Dict[str, List[Sequence[Any]]] = {
    # Two send on a topic, so that its consumer is bound to nothing; one is disconnected.
    "a sender that leaves binds no variable of those that it left": [
        ("begin", True),
        ("spawn", "part c", [27, 20, 0, 1]),
    ],
    # A listener without variables remembers nothing: it stays if it wants the remaining stream.
    "a foreign sender is taken off though a listener further on is slow": [
        ("begin", True),
        ("slow", 0),
        ("spawn", "part d", [0, 2, 0, 0]),
        ("spawn", "part b", [10, 0, 0, 0]),
        ("spawn", "part d", [0, 0, 23, 0]),
        ("slow", 5),
        ("spawn", "part f", [1, 0, 5, 0]),
    ],
    # A slow nodelet with a variable stays where it is: it wants the remaining stream.
    "a foreign sender is taken off though a nodelet further on remembers": [
        ("begin", True),
        ("spawn", "part f", [0, 3, 0, 0]),
        ("slow", 1),
        ("slow", 3),
        ("spawn", "part d", [0, 2, 0, 0]),
    ],
    # It hung when its description went; its listener is back before it is disconnected.
    "what claims left on a topic that is described no more may send anything": (
        HUNG_AND_NOT_DESCRIBED
    ),
    "and so it may when the manager is killed": [*HUNG_AND_NOT_DESCRIBED, ("kill_dyknow",)],
    # One was given another individual for its variable than it receives.
    "nodelets come back as people connected them with each other": [
        ("spawn", "part c", [3, 1, 0, 0]),
        ("spawn", "part e", [1, 2, 0, 1]),
        ("kill", 0),
    ],
    # One cannot be disconnected before the other: neither waits for a stream that does not fit.
    "a stream that a person feeds back is repaired": [
        ("acquire", "Goal(red)", 1.0, True),
        ("spawn", "part f", [27, 11, 16, 22]),
    ],
    # Without part d, part e is made again, for another individual: it was called like the old.
    "a part is made beside a nodelet whose name is free for topics alone": [
        ("acquire", "Goal(?c)", 0.0, False),
        ("withdraw", 0),
        ("remove", "part d"),
    ],
    # At the end a late connection arrives in the same moment; people did the rest.
    "a nodelet that hung is back where a person sends something else by then": [
        ("begin", True),
        ("release", 0),
        ("remove", "part d"),
        ("vanish", 0),
        ("slow", 0),
        ("acquire", "Goal(?c)", 0.0, False),
        ("hang", 0, True),
        ("spawn", "part a", [18, 0, 0, 0]),
    ],
    # A person connects the camera of one claim to the topic of the camera of another claim.
    "one who comes to the topic of another individual is taken off": [
        ("begin", False),
        ("acquire", "Ball(blue)", 0.0, True),
        ("acquire", "Frame(left)", 0.0, False),
        ("connect", 0, 0, 3),
    ],
    "a sender with fixed topics stays on the topic of a client": [
        ("begin", True),
        ("describe", "part d", PLAIN_SENDER),
        ("spawn", "part d", [20, 15, 2, 13]),
    ],
    # Its claim's stream is lost, and not made again where the listener would receive it.
    "a listener with fixed topics receives nothing that it does not want": [
        ("begin", True),
        ("spawn", "part d", [28, 23, 9, 21]),
        ("describe", "part b", PLAIN_LISTENER),
        ("spawn", "part b", [5, 4, 12, 1]),
        ("destroy", 4),
    ],
}


@pytest.mark.parametrize("life", LIVES)
def test_of_a_life_that_once_went_wrong(life: str) -> None:
    Truth().relive(*LIVES[life])


@pytest.mark.long
def test_nobody_receives_what_was_not_asked_for_in_long_lives() -> None:
    check(100, 300)  # about ten seconds a life
