# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tags: which texts are terms, and which tags satisfy which demands."""

from __future__ import annotations

from typing import Dict, Optional, Set

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow.errors import InvalidTag, InvalidType
from dyknow.manager.planning.index import AtomIndex
from dyknow.manager.planning.patterns import Names, atoms_of, solutions
from dyknow.manager.planning.rules import pattern_of
from dyknow.manager.planning.supply import Demand, meets
from dyknow.manager.specifications.tags import (
    NoOntology,
    Term,
    matches,
    parse_tag,
    types_of,
    unify,
    unify_all,
)


class Kinds:
    """A small ontology: names and what is above them."""

    ABOVE = {
        "BallObject": {"WorldObject"},
        "nao1": {"NAO", "Robot"},
        "NAO": {"Robot"},
    }

    def names_above(self, name: str) -> frozenset[str]:
        return frozenset({name} | self.ABOVE.get(name, set()))

    def canonical(self, name: str) -> str:
        return name


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
NO_TYPES = st.just(())
GROUND = st.builds(Term, NAMES, st.lists(NAMES, max_size=2).map(tuple), NO_TYPES)
WANTED_ARGS = st.lists(st.one_of(NAMES, st.sampled_from(["?a", "?b"])), max_size=2).map(tuple)
WANTED = st.builds(Term, NAMES, WANTED_ARGS, NO_TYPES)


@given(
    st.lists(st.tuples(st.lists(GROUND, max_size=3), st.sampled_from(["", "t/A", "t/B", "*"]))),
    st.frozensets(WANTED, min_size=1, max_size=2),
    st.sampled_from(["", "t/A"]),
    st.booleans(),
)
def test_the_index_finds_what_matching_says(offers, tags, datatype, is_wide) -> None:  # type: ignore[no-untyped-def]
    ontology = Kinds()
    names = Names(ontology)
    index: AtomIndex[int] = AtomIndex(names, 0 if is_wide else 64)
    atoms = [atoms_of(terms, (), names) for terms, _ in offers]
    for number, each in enumerate(atoms):
        for atom in each:
            index.add(number, atom)
    pattern = pattern_of(tuple(tags), datatype, names)
    demand = Demand(tags, datatype)
    expected = {
        number
        for number, (terms, kind) in enumerate(offers)
        if meets(terms, kind, demand, ontology)
    }

    def found() -> Set[int]:
        return {
            number
            for number in index.find(pattern)
            if solutions(atoms[number], pattern, names)
            if datatype == "" or offers[number][1] in ("", "*", datatype)
        }

    assert found() == expected
    for number, each in list(enumerate(atoms))[::2]:
        for atom in each:
            index.remove(number, atom)
    assert found() == {number for number in expected if number % 2}


def test_without_an_ontology_a_name_is_itself() -> None:
    assert NoOntology().names_above("a") == {"a"}


@pytest.mark.parametrize(
    ("text", "term"),
    [
        ("Image(?c: Camera)", Term("Image", ("?c",), ("Camera",))),
        ("Image( ?c :Camera , cam1 )", Term("Image", ("?c", "cam1"), ("Camera", ""))),
        ("Image(?c: http://x.org/o#Camera)", Term("Image", ("?c",), ("http://x.org/o#Camera",))),
        ("Image(http://x.org/o#cam1, ?c)", Term("Image", ("http://x.org/o#cam1", "?c"))),
    ],
)
def test_types_are_kept_apart_from_variables_and_written_again(text: str, term: Term) -> None:
    assert parse_tag(text) == term
    assert parse_tag(str(term)) == term


@pytest.mark.parametrize("text", ["A(?x:)", "A(?x: )", "A(?: B)", "A(b, ?:)"])
def test_a_malformed_type_is_refused_as_one(text: str) -> None:
    with pytest.raises(InvalidType, match=r"expected \?variable: Concept"):
        parse_tag(text)


def test_variables_are_replaced_by_names_and_lose_their_types() -> None:
    term = parse_tag("Pose(?x: Robot, a, ?y, ?x)")
    assert term.variables == ("?x", "?y")
    assert str(term.substitute({"?y": "b"})) == "Pose(?x: Robot, a, b, ?x)"
    assert term.substitute({"?x": "nao1", "?y": "b"}) == Term("Pose", ("nao1", "a", "b", "nao1"))


@pytest.mark.parametrize(
    ("supplied", "demanded", "bindings", "expected"),
    [
        ("A(b, c)", "A(?x, ?y)", {}, {"?x": "b", "?y": "c"}),
        ("A(b)", "A(?x)", {"?x": "b", "?z": "d"}, {"?x": "b", "?z": "d"}),
        ("A(b)", "A(?x)", {"?x": "c"}, None),
        ("A(nao1)", "A(?x: Robot)", {}, {"?x": "nao1"}),
        ("A(Robot)", "A(?x: nao1)", {}, None),
        ("A(nao1, nao1)", "A(?x: Robot, ?x: NAO)", {}, {"?x": "nao1"}),
        ("A(NAO, NAO)", "A(?x: Robot, ?x: nao1)", {}, None),
    ],
)
def test_a_supplied_term_is_unified_under_bindings(
    supplied: str, demanded: str, bindings: Dict[str, str], expected: Optional[Dict[str, str]]
) -> None:
    assert unify(parse_tag(supplied), parse_tag(demanded), Kinds(), bindings) == expected


def test_names_of_one_entity_are_one_individual() -> None:
    class Synonyms(Kinds):
        def canonical(self, name: str) -> str:
            return "nao1" if name == "http://x.org/nao1" else name

    term = parse_tag("A(http://x.org/nao1)")
    assert unify(term, parse_tag("A(?x)"), Synonyms(), {"?x": "nao1"}) == {"?x": "nao1"}
    assert unify(term, parse_tag("A(?x)"), Kinds(), {"?x": "nao1"}) is None


def test_all_tags_are_matched_under_the_same_bindings() -> None:
    supplied = [parse_tag(text) for text in ("A(b)", "A(c)", "B(c)", "B(d)", "B(?e)")]
    demanded = [parse_tag("A(?x)"), parse_tag("B(?x)")]
    assert list(unify_all(supplied, demanded, Kinds())) == [{"?x": "c"}]
    apart = [parse_tag("A(?x)"), parse_tag("B(?y)")]
    assert len(list(unify_all(supplied, apart, Kinds()))) == 4


def test_types_add_up_over_the_occurrences() -> None:
    terms = [parse_tag("A(?x: Robot)"), parse_tag("B(?x: NAO, ?y)")]
    assert types_of(terms) == {"?x": {"Robot", "NAO"}}
