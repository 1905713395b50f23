# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tags: which texts are terms, and which tags satisfy which demands."""

from __future__ import annotations

from typing import Set

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.manager.witness import Concepts

from dyknow.errors import InvalidTag
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, Plan, meets
from dyknow.manager.specifications.tags import Term, parse_tag, unify
from dyknow.model.transformation import OUT, Port, Transformation

KINDS = Concepts({"BallObject": "WorldObject", "nao1": "NAO", "NAO": "Robot"})


@pytest.mark.parametrize(
    ("text", "term"),
    [
        ("Odometry", Term("Odometry")),
        ("RawRGB(cam1)", Term("RawRGB", ("cam1",))),
        ("  Pose ( ball ,  field 2 ) ", Term("Pose", ("ball", "field 2"))),
        ("BallObject(?robot)", Term("BallObject", ("?robot",))),
        ("http://x.org/o#Ball(a)", Term("http://x.org/o#Ball", ("a",))),
    ],
)
def test_terms_are_read(text: str, term: Term) -> None:
    assert parse_tag(text) == term


@pytest.mark.parametrize(
    "text",
    ["", " ", "A(", "A)", "A()", "A(,)", "A(b,)", "A(b)c", "A(B(c))", "?x(a)", "A(?)", "(a)"],
)
def test_what_is_no_term_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(InvalidTag) as raised:
        parse_tag(text)
    assert text in str(raised.value)
    assert "expected" in str(raised.value)


def test_too_long_and_too_many_are_refused() -> None:
    with pytest.raises(InvalidTag, match="characters"):
        parse_tag("A" * 5000)
    with pytest.raises(InvalidTag, match="arguments"):
        parse_tag("A(" + ",".join("abcdefghijklmnopq") + ")")


@pytest.mark.parametrize(
    ("supplied", "demanded", "fits"),
    [
        ("Raw(cam1)", "Raw(cam1)", True),
        ("Raw(cam1)", "Raw(cam2)", False),
        ("Raw(cam1)", "Raw", False),
        ("Raw(cam1)", "Raw(?c)", True),
        ("Near(a, b)", "Near(?x, ?x)", False),
        ("Near(a, a)", "Near(?x, ?x)", True),
        ("BallObject(nao1)", "WorldObject(nao1)", True),
        ("WorldObject(nao1)", "BallObject(nao1)", False),
        ("BallObject(nao1)", "WorldObject(Robot)", True),
        ("BallObject(Robot)", "WorldObject(nao1)", False),
    ],
)
def test_supplied_satisfies_demanded(supplied: str, demanded: str, fits: bool) -> None:
    found = unify(parse_tag(supplied), parse_tag(demanded), KINDS)
    assert (found is not None) is fits


NAMES = st.sampled_from(["A", "BallObject", "WorldObject", "nao1", "NAO", "Robot", "x"])
NO_TYPES = st.just(())
GROUND = st.builds(Term, NAMES, st.lists(NAMES, max_size=2).map(tuple), NO_TYPES)
WANTED_ARGS = st.lists(st.one_of(NAMES, st.sampled_from(["?a", "?b"])), max_size=2).map(tuple)
WANTED = st.builds(Term, NAMES, WANTED_ARGS, NO_TYPES)


@given(
    st.lists(st.tuples(st.lists(GROUND, max_size=3), st.sampled_from(["", "t/A", "t/B", "*"]))),
    st.frozensets(WANTED, min_size=1, max_size=2),
    st.sampled_from(["", "t/A"]),
)
def test_the_library_finds_what_matching_says(offers, tags, datatype) -> None:  # type: ignore[no-untyped-def]
    demand = Demand(tags, datatype)
    planner = Planner(KINDS)
    made = [
        Transformation(str(number), "p/X", ports=(Port("out", OUT, kind, tuple(map(str, terms))),))
        for number, (terms, kind) in enumerate(offers)
    ]
    planner.know(made)
    expected = {
        str(number)
        for number, (terms, kind) in enumerate(offers)
        if meets(terms, kind, demand, KINDS)
    }

    def found() -> Set[str]:
        labels: Set[str] = set()
        while isinstance(answer := planner.plan(demand, exclude=labels), Plan):
            labels.add(answer.goal.label)
        return labels

    assert found() == expected
    planner.know(made[1::2])
    assert found() == {label for label in expected if int(label) % 2}
