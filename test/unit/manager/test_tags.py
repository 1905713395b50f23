# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tags: which texts are terms, and which tags satisfy which demands."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow.errors import InvalidTag
from dyknow.manager.planning.supply import Demand, Supply
from dyknow.manager.specifications.tags import NoOntology, Term, matches, parse_tag


class Kinds:
    """A small ontology: names and what is above them."""

    ABOVE = {
        "BallObject": {"WorldObject"},
        "nao1": {"NAO", "Robot"},
        "NAO": {"Robot"},
    }

    def names_above(self, name: str) -> frozenset[str]:
        return frozenset({name} | self.ABOVE.get(name, set()))


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
    assert matches(parse_tag(supplied), parse_tag(demanded), Kinds()) is fits


NAMES = st.sampled_from(["A", "BallObject", "WorldObject", "nao1", "NAO", "Robot", "x"])
GROUND = st.builds(Term, NAMES, st.lists(NAMES, max_size=2).map(tuple))
WANTED = st.builds(
    Term, NAMES, st.lists(st.one_of(NAMES, st.sampled_from(["?a", "?b"])), max_size=2).map(tuple)
)


@given(
    st.lists(st.tuples(st.lists(GROUND, max_size=3), st.sampled_from(["", "t/A", "t/B", "*"]))),
    st.frozensets(WANTED, min_size=1, max_size=2),
    st.sampled_from(["", "t/A"]),
    st.integers(0, 64),
)
def test_the_index_finds_exactly_what_matching_says(offers, tags, datatype, most_keys) -> None:  # type: ignore[no-untyped-def]
    ontology = Kinds()
    supply: Supply[int] = Supply(ontology, most_keys=most_keys)
    for number, (terms, kind) in enumerate(offers):
        supply.add(number, terms, kind)
    expected = [
        number
        for number, (terms, kind) in enumerate(offers)
        if all(any(matches(term, wanted, ontology) for term in terms) for wanted in tags)
        and (not datatype or kind in ("", "*", datatype))
    ]
    demand = Demand(tags, datatype)
    assert sorted(supply.suppliers(demand)) == expected
    for number, (terms, _) in list(enumerate(offers))[::2]:
        supply.remove(number, terms)
    assert sorted(supply.suppliers(demand)) == [each for each in expected if each % 2]


def test_without_an_ontology_a_name_is_itself() -> None:
    assert NoOntology().names_above("a") == {"a"}
