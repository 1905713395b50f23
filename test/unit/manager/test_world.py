# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The world at one moment: senders and receivers, and supplies of nodelets with variables."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Dict, List, Sequence, Set, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.manager.witness import Concepts, satisfies

from dyknow.errors import WrongStream
from dyknow.manager.claim import Claim
from dyknow.manager.claims.ends import Inlet, relay, supplied, ways_to_bind
from dyknow.manager.claims.world import World
from dyknow.manager.planning.problem import Demand
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import NO_ONTOLOGY, parse_tag
from dyknow.model.graph import State
from dyknow.model.streams import StreamRequest
from dyknow.model.transformation import IN, OUT, Parameter, Port, Transformation

CONCEPTS = Concepts({"left": "camera", "right": "camera"})
NAMES = ("left", "right", "red")
VARIABLES = ("?a", "?b")
GROUND = st.builds("{}({}, {})".format, st.just("A"), *[st.sampled_from(NAMES)] * 2)
PATTERN = st.builds(
    "{}({}, {})".format, st.just("A"), *[st.sampled_from([*NAMES, *VARIABLES, "?a: camera"])] * 2
)
INLETS = st.lists(
    st.tuples(
        st.lists(PATTERN, min_size=1, max_size=2, unique=True),
        st.lists(st.lists(GROUND, max_size=2, unique=True), min_size=1, max_size=2),
    ),
    max_size=2,
)
Inlets = List[Tuple[List[str], List[List[str]]]]


def is_way(names: Dict[str, str], inlets: Inlets) -> bool:
    """Whether each source sends, for each tag of its port, one of just these names."""
    return all(
        any(satisfies(tag, pattern, CONCEPTS, names) for tag in tags)
        for patterns, sources in inlets
        for tags in sources
        for pattern in patterns
    )


@given(INLETS, st.sampled_from([{}, {"?a": "left"}]), st.lists(PATTERN, max_size=2))
def test_all_ways_are_found_that_trying_all_names_finds(
    inlets: Inlets, known: Dict[str, str], outputs: Sequence[str]
) -> None:
    found = ways_to_bind(
        [known],
        [
            Inlet(
                Demand(frozenset(map(parse_tag, patterns))),
                tuple((tuple(map(parse_tag, tags)), "") for tags in sources),
            )
            for patterns, sources in inlets
        ],
        CONCEPTS,
    )
    bound = {each for each in VARIABLES if any(each in p for ps, _ in inlets for p in ps)}
    bound |= set(known)
    expected: Set[Tuple[Tuple[str, str], ...]] = set()
    for choice in itertools.product(NAMES, repeat=len(VARIABLES)):
        names = dict(zip(VARIABLES, choice))
        if {**names, **known} == names and is_way(names, inlets):
            expected.add(tuple(sorted((key, names[key]) for key in bound)))
    assert {tuple(sorted(way.items())) for way in found} == expected
    for tag in supplied(list(map(parse_tag, outputs)), found):
        assert tag.is_ground
    for way in found:
        for output in map(parse_tag, outputs):
            if set(output.variables) <= set(way):
                assert output.substitute(way) in supplied([output], found)


# In the graph

IMAGE = "sensor_msgs/Image"


def nodelet(name: str, ports: Dict[str, Tuple[str, str]], **given_: str) -> Record:
    """Make a record: for each port its tag and its topic; in-ports begin with ``in``."""
    declared = tuple(
        Port(port, IN if port.startswith("in") else OUT, IMAGE, (tag,))
        for port, (tag, _) in ports.items()
    )
    return Record(
        name,
        Transformation(name, "pkg/A", ports=declared),
        "/m",
        topics={port: topic for port, (_, topic) in ports.items() if topic},
        state=State.RUNNING,
        parameters=tuple(Parameter(f"?{key}", "string", text) for key, text in given_.items()),
    )


LEFT = nodelet("/left", {"out": ("Image(left)", "/left")})
RIGHT = nodelet("/right", {"out": ("Image(right)", "/right")})
POSES = nodelet("/poses", {"out": ("Pose(left)", "/poses")})
NEEDED = Claim("claim", StreamRequest("Ball(?c)"), wiring={"/tracker": {"in": "/nobody"}})


def tracker(image: str, pose: str = "", **given_: str) -> Record:
    ports = {"in": ("Image(?c)", image), "in2": ("Pose(?c)", pose), "out": ("Ball(?c)", "/ball")}
    return nodelet("/tracker", ports, **given_)


def viewer(tag: str) -> Record:
    return nodelet("/viewer", {"in": (tag, "/ball")})


def world(*records: Record) -> World:
    return World(NO_ONTOLOGY, {}, claims=(NEEDED,)).with_records(records)


def mismatches(*records: Record) -> List[str]:
    found = world(*records).all_mismatches
    return sorted(f"{producer.nodelet} {consumer.nodelet}" for _, producer, consumer in found)


def live(*records: Record) -> List[str]:
    streams = world(*records).live(records, ())
    return sorted(f"{stream.nodelet} {tag}" for stream, tags in streams for tag in tags)


LEFT_BEHIND = replace(tracker("/gone"), claimed=True)
BOTH = (LEFT, RIGHT, POSES)
TWIN = replace(LEFT, name="/twin")
BESIDE = replace(RIGHT, topics={"out": "/left"})
SECOND = nodelet("/second", {"in": ("Ball(?x)", "/ball"), "out": ("Goal(?x)", "/goal")})
END = nodelet("/end", {"in": ("Goal(right)", "/goal")})
ONE = nodelet("/one", {"in": ("A(?x)", "/a"), "out": ("B(?x)", "/b")})
TWO = nodelet("/two", {"in": ("B(?x)", "/b"), "out": ("A(?x)", "/a")})
RAW = nodelet("/raw", {"out": ("Raw(left)", "/raw")})
OTHER = nodelet("/other", {"out": ("Raw(right)", "/other")})
EYE = nodelet("/eye", {"in": ("Raw(left)", "/b")})


def relays(topic: str) -> Tuple[Record, Record]:
    """Two relays, one behind the other, that claim to send the messages of /raw."""
    made = relay("/raw", IMAGE, ("Raw(left)",))
    topics = {"/first": {"in": topic, "out": "/a"}, "/second": {"in": "/a", "out": "/b"}}
    first, second = (Record(each, made, "/m", topics=topics[each]) for each in topics)
    return first, second


MISLED = ["/first /second", "/other /first", "/second /eye"]
CONTRADICTION = ["/poses /tracker", "/right /tracker", "/tracker /viewer"]


@pytest.mark.parametrize(
    ("records", "wrong", "supply"),
    [
        ((*BOTH, tracker("/left", "/poses"), viewer("Ball(left)")), [], "Ball(left)"),
        (
            (*BOTH, tracker("/left", "/poses"), viewer("Ball(right)")),
            ["/tracker /viewer"],
            "Ball(left)",
        ),
        # In-ports contradict each other.
        ((*BOTH, tracker("/right", "/poses"), viewer("Ball(right)")), CONTRADICTION, ""),
        # It receives nothing, so it sends nothing.
        ((LEFT, POSES, replace(tracker("/nobody"), claimed=True), viewer("Ball(right)")), [], ""),
        ((LEFT, POSES, tracker(""), viewer("Ball(right)")), [], ""),
        # A user connected it to an unknown topic, or a claim left it there: it may send anything.
        ((LEFT, POSES, tracker("/nobody"), viewer("Ball(right)")), ["/tracker /viewer"], ""),
        ((LEFT_BEHIND, viewer("Ball(left)")), ["/tracker /viewer"], ""),
        # Its parameters fix the individual that it may receive.
        ((LEFT, RIGHT, tracker("/right", c="left")), ["/right /tracker"], ""),
        # Two send on one topic: of two individuals, unless another port or a parameter names one.
        ((LEFT, BESIDE, tracker("/left")), ["/left /tracker", "/right /tracker"], ""),
        ((LEFT, TWIN, POSES, tracker("/left", "/poses")), [], "Ball(left)"),
        ((LEFT, BESIDE, POSES, tracker("/left", "/poses")), ["/right /tracker"], ""),
        ((LEFT, BESIDE, tracker("/left", c="left")), ["/right /tracker"], ""),
        # Bindings pass through chains, and do not settle in circles.
        ((END, SECOND, tracker("/left", "/poses"), POSES, LEFT), ["/second /end"], "Ball(left)"),
        ((ONE, TWO), [], ""),
        # A relay is believed while it receives the stream that it claims, and all those behind it.
        ((RAW, *relays("/raw"), EYE), [], ""),
        ((OTHER, *relays("/other"), EYE), MISLED, ""),
        ((EYE, *reversed(relays("/other")), OTHER), MISLED, ""),
    ],
)
def test_a_supply_follows_from_the_inputs(
    records: Tuple[Record, ...], wrong: List[str], supply: str
) -> None:
    assert mismatches(*records) == wrong
    found = [each for each in live(*records) if each.split()[0] in ("/tracker", "/one", "/two")]
    assert found == ([f"/tracker {supply}"] if supply else [])
    assert ("/second Goal(left)" in live(*records)) is (SECOND in records)


def test_no_variable_is_connected_to_two_individuals() -> None:
    mixed = world(LEFT, BESIDE, tracker(""))
    assert mixed.fitting(replace(tracker("/left"), claimed=True))["in"] == ""
    with pytest.raises(WrongStream):
        mixed.in_the_way(tracker(""), {"in": "/left"})
    alone = world(LEFT, RIGHT, tracker("/left"))
    assert alone.in_the_way(RIGHT, {"out": "/left"}) == {"/tracker": {"in": ""}}


def test_latencies_add_up_from_what_feeds_a_nodelet() -> None:
    def stating(record: Record, latency: float) -> Record:
        assert record.transformation is not None
        ports = tuple(
            port._replace(latency=latency if port.direction == OUT else 0.0)
            for port in record.transformation.ports
        )
        return replace(record, transformation=record.transformation._replace(ports=ports))

    records = (
        stating(tracker("/left", "/poses"), 0.1),
        stating(LEFT, 0.02),
        stating(POSES, 0.2),
        stating(RIGHT, 0.0),
    )
    streams = world(*records).live(records, ())
    found = {stream.nodelet: stream.latency for stream, _ in streams}
    assert found == {"/tracker": 0.3, "/left": 0.02, "/poses": 0.2, "/right": 0.0}
