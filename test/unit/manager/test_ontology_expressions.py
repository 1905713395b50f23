# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Class expressions of OWL: claims that follow from them, and no other claims."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import FrozenSet, Iterator, List, NamedTuple, Sequence, Tuple, Union

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples
from unit.manager.test_ontology import BASE, FIRST_LINE, PREFIXES, Load, loader

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.ontologies import statements as ontology_statements
from dyknow.manager.specifications.ontologies.ontology import Ontology


@pytest.fixture
def ontology(tmp_path: Path) -> Load:
    return loader(tmp_path)


def subsumed(found: Ontology, names: str) -> List[str]:
    """Pairs of different names of which the first is subsumed by the second, as `A<B`."""
    pairs = itertools.permutations(names.split(), 2)
    return sorted(f"{one}<{other}" for one, other in pairs if other in found.names_above(one))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (":C owl:equivalentClass [ owl:intersectionOf ( :A :B ) ] .", "C<A C<B"),
        (":C owl:unionOf ( :A :B ) .", "A<C B<C"),
        (
            ":C owl:unionOf ( :A :B ) . :A rdfs:subClassOf :D, :E . :B rdfs:subClassOf :D, :F .",
            "A<C A<D A<E B<C B<D B<F C<D",
        ),
        (
            ":A rdfs:subClassOf [ owl:unionOf ( :B :C ) ] . :B rdfs:subClassOf :D ."
            " :C owl:unionOf ( :E :F ) . :E rdfs:subClassOf :D . :F rdfs:subClassOf :D .",
            "A<D B<D C<D E<C E<D F<C F<D",
        ),
        (":C owl:disjointUnionOf ( :A :B ) .", "A<C B<C"),
        (":C rdfs:subClassOf [ owl:unionOf ( :A :B ) ] .", ""),
        ("[ owl:unionOf ( :A :B ) ] rdfs:subClassOf :C .", "A<C B<C"),
        (":C owl:unionOf ( :A ) .", "A<C C<A"),
        (":C owl:intersectionOf () . :D owl:unionOf () .", ""),
        (
            ":C owl:equivalentClass [ owl:intersectionOf ( :A"
            " [ owl:unionOf ( :B [ owl:intersectionOf ( :D :E ) ] ) ] ) ] ."
            " :F rdfs:subClassOf :A, :D, :E . :B rdfs:subClassOf :A .",
            "B<A B<C C<A F<A F<C F<D F<E",
        ),
        (
            ":C owl:equivalentClass [ owl:intersectionOf ( :A"
            " [ a owl:Restriction ; owl:onProperty :p ; owl:someValuesFrom :B ] ) ] .",
            "C<A",
        ),
        (
            ":D owl:equivalentClass [ owl:complementOf :A ] . :C rdfs:subClassOf :D .",
            "C<D",
        ),
        (":A owl:equivalentClass [ owl:oneOf ( :B :C ) ] . :D owl:oneOf ( :B ) .", "B<A B<D C<A"),
        (
            ":A owl:equivalentClass [ owl:intersectionOf ( :B [ owl:oneOf ( :C :D ) ] ) ] ."
            " :C a :A . :D a :B .",
            "A<B C<A C<B D<A D<B",
        ),
        # Data types are not classes.
        (
            ":A a rdfs:Datatype ; owl:equivalentClass [ a rdfs:Datatype ; owl:oneOf ( 1 2 ) ] ."
            " :B a rdfs:Datatype ; owl:unionOf ( :A :C ) . :D owl:equivalentClass 'text' .",
            "",
        ),
    ],
)
def test_what_an_expression_entails(ontology, text: str, expected: str) -> None:
    assert subsumed(ontology(text), "A B C D E F") == expected.split()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (":C owl:unionOf _:a . _:a rdf:first :A ; rdf:rest _:a .", "goes in a circle"),
        (
            ":C owl:unionOf _:a . :D owl:oneOf _:a . _:a rdf:first :A ; rdf:rest rdf:nil .",
            "part of two",
        ),
        (":C owl:intersectionOf _:a . _:a rdf:first :A .", "1 rdf:first and 0 rdf:rest after 0"),
        (
            ":C owl:intersectionOf _:a . _:a rdf:first :A, :B ; rdf:rest rdf:nil .",
            "2 rdf:first and 1 rdf:rest after 0 members; expected one of each until rdf:nil",
        ),
        (":C owl:oneOf :A .", "0 rdf:first and 0 rdf:rest"),
    ],
)
def test_a_malformed_list_is_refused(ontology, text: str, reason: str) -> None:
    with pytest.raises(OntologyFileError, match=rf"o0\.ttl: the list of owl:\w+ of .*{reason}"):
        ontology(text)


def deep(count: int) -> Iterator[str]:
    """Intersections in intersections; individual x is in the innermost, y in the outermost."""
    for n in range(count):
        yield f"_:e{n} owl:intersectionOf ( :P{n} _:e{n + 1} ) . :y a :P{n} ."
    yield ":C owl:equivalentClass _:e0 . :x a :C ."
    yield f"_:e{count} rdfs:subClassOf :D . :y a _:e{count} ."


def chains(count: int) -> Iterator[str]:
    """Long chains of classes and of properties; individual x has a relative by the first one."""
    for n in range(count):
        yield f":p{n} rdfs:subClassOf :p{n + 1} ; rdfs:subPropertyOf :p{n + 1} ."
    yield f":p{count} rdfs:domain :Domain . :x a owl:NamedIndividual ; :p0 :x ."
    yield ":Some rdfs:subClassOf [ owl:onProperty :p0 ; owl:someValuesFrom :p0 ] ."
    last = f"[ owl:onProperty :p{count} ; owl:someValuesFrom :p{count} ]"
    yield f":Wider owl:equivalentClass {last} ."


def wide(count: int) -> Iterator[str]:
    """A union and an intersection of many classes, too many for rdflib 4 as `( ... )`."""
    for word, whole in (("unionOf", "U"), ("intersectionOf", "I")):
        yield f":{whole} owl:{word} _:{whole}0 ."
        for n in range(count):
            rest = f"_:{whole}{n + 1}" if n + 1 < count else "rdf:nil"
            yield f"_:{whole}{n} rdf:first :P{n} ; rdf:rest {rest} ."
    yield ":x a :I . :y a :P7 ."


def test_deep_wide_and_long_expressions_take_no_time(ontology: Load) -> None:
    started = time.process_time()
    found = ontology("\n".join(deep(1500)))
    assert found.individuals(BASE + "C") == ("x", "y")
    assert found.individuals(BASE + "D") == ("x", "y")
    assert "P1499" in found.names_above("C")
    found = ontology("\n".join(wide(3000)))
    assert found.individuals(BASE + "I") == ("x",)
    assert found.individuals(BASE + "U") == ("x", "y")
    assert "U" in found.names_above("I")
    assert "P1" not in found.names_above("U")
    found = ontology("\n".join(chains(5000)))
    assert "p5000" in found.names_above("p0")
    assert "Wider" in found.names_above("Some")
    assert "Domain" in found.names_above("Some")
    assert found.individuals(BASE + "Domain") == ("x",)
    assert time.process_time() - started < 60.0


def test_too_many_unions_are_told(ontology, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ontology_statements, "VISITS", 1)
    found = ontology(":C owl:unionOf ( :A :B ) .")

    assert "C" in found.names_above("A")
    assert found.warnings[-1].message.startswith("too many unions to find all superclasses")
    assert found.warnings[-1].line == FIRST_LINE


# The property: a checker of models that shares no code and no idea with the hierarchy


class Combined(NamedTuple):
    """A class expression."""

    word: str
    members: Tuple[Expression, ...]


Expression = Union[str, Combined]

CLASSES, INDIVIDUALS = ("A", "B", "C", "D"), ("x", "y", "z")
#: One kind of element: the classes that it is in, and the individuals that it is.
Kind = FrozenSet[str]
Axiom = Tuple[str, Expression, Expression]


def named() -> st.SearchStrategy[Expression]:
    return st.sampled_from(CLASSES)


def expressions(words: Sequence[str]) -> st.SearchStrategy[Expression]:
    nested = st.deferred(lambda: named() | combined)
    boolean = st.sampled_from([word for word in words if word != "oneOf"])
    combined = st.builds(
        lambda word, members: Combined(word, tuple(members)),
        boolean,
        st.lists(nested, min_size=1, max_size=3),
    )
    if "oneOf" in words:
        members = st.lists(st.sampled_from(INDIVIDUALS), min_size=1, max_size=2)
        combined |= st.builds(lambda each: Combined("oneOf", tuple(each)), members)
    return named() | combined


def axioms(words: Sequence[str]) -> st.SearchStrategy[List[Axiom]]:
    classes = expressions(words)
    stated = st.tuples(st.sampled_from(["<", "="]), classes, classes)
    typed = st.tuples(st.just("a"), st.sampled_from(INDIVIDUALS), classes)
    return st.lists(stated | typed, max_size=6)


def written(expression: Expression) -> str:
    if isinstance(expression, str):
        return f":{expression}"
    members = " ".join(map(written, expression.members))
    return f"[ a owl:Class ; owl:{expression.word} ( {members} ) ]"


PREDICATES = {"<": "rdfs:subClassOf", "=": "owl:equivalentClass", "a": "a"}


def turtle(stated: Sequence[Axiom]) -> str:
    declared = [f":{each} a owl:Class ." for each in CLASSES]
    declared += [f":{each} a owl:NamedIndividual ." for each in INDIVIDUALS]
    told = [f"{written(one)} {PREDICATES[word]} {written(other)} ." for word, one, other in stated]
    return PREFIXES + "\n".join(declared + told)


def holds(expression: Expression, kind: Kind) -> bool:
    """Whether an element of a kind is in a class, or is an individual."""
    if isinstance(expression, str):
        return expression in kind
    together = all if expression.word == "intersectionOf" else any
    return together(holds(each, kind) for each in expression.members)


def allowed(kind: Kind, stated: Sequence[Axiom]) -> bool:
    """Whether an element of a kind contradicts nothing that is stated."""
    for word, one, other in stated:
        is_one, is_other = holds(one, kind), holds(other, kind)
        if (is_one and not is_other) or (word == "=" and is_one != is_other):
            return False
    return True


def kinds_in_models(stated: Sequence[Axiom]) -> List[Kind]:
    """The kinds of elements that some model has, where each individual is one element."""
    names = (*CLASSES, *INDIVIDUALS)
    subsets = (itertools.combinations(names, size) for size in range(len(names) + 1))
    possible = map(frozenset, itertools.chain.from_iterable(subsets))
    kinds = [kind for kind in possible if allowed(kind, stated)]
    blocks = {kind.intersection(INDIVIDUALS) for kind in kinds}

    def can_be_completed(individuals: FrozenSet[str]) -> bool:
        rest = sorted(set(INDIVIDUALS) - individuals)
        return not rest or any(
            rest[0] in block and not block & individuals and can_be_completed(individuals | block)
            for block in blocks
        )

    return [kind for kind in kinds if can_be_completed(kind.intersection(INDIVIDUALS))]


def entailed(stated: Sequence[Axiom]) -> FrozenSet[Tuple[str, str]]:
    """Every subsumption and every type that holds in all models."""
    kinds = kinds_in_models(stated)
    return frozenset(
        (lower, upper)
        for lower, upper in itertools.product((*CLASSES, *INDIVIDUALS), CLASSES)
        if all(upper in kind for kind in kinds if lower in kind)
    )


def claimed(stated: Sequence[Axiom], folder: Path) -> FrozenSet[Tuple[str, str]]:
    """The ontology's claims, by each of its two ways to query them."""
    path = folder / "o.ttl"
    path.write_text(turtle(stated))
    found = Ontology([str(path)])
    pairs = itertools.product((*CLASSES, *INDIVIDUALS), CLASSES)
    claims = frozenset((one, other) for one, other in pairs if other in found.names_above(one))
    listed = {(each, kind) for kind in CLASSES for each in found.individuals(BASE + kind)}
    assert listed == {pair for pair in claims if pair[0] in INDIVIDUALS}
    return claims


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("ontologies")


@examples(150)
@given(stated=axioms(["intersectionOf", "unionOf", "oneOf"]))
def test_nothing_is_claimed_that_is_not_entailed(folder: Path, stated: List[Axiom]) -> None:
    assert claimed(stated, folder) <= entailed(stated)


@examples(150)
@given(stated=axioms(["intersectionOf"]))
def test_all_that_intersections_entail_is_claimed(folder: Path, stated: List[Axiom]) -> None:
    assert claimed(stated, folder) == entailed(stated)


def test_the_checker_of_models_knows_what_a_model_is() -> None:
    union: Axiom = ("=", "C", Combined("unionOf", ("A", "B")))
    assert entailed([union]) >= {("A", "C"), ("B", "C")}
    assert ("C", "A") not in entailed([union])
    assert ("C", "D") in entailed([union, ("<", "A", "D"), ("<", "B", "D")])
    one: Axiom = ("=", "A", Combined("oneOf", ("x",)))
    assert ("x", "A") in entailed([one])
    assert ("y", "B") in entailed([one, ("a", "y", "A"), ("a", "x", "B")])


# Restrictions and properties

SOME = "[ a owl:Restriction ; owl:onProperty {} ; {} ]"
NO_NUMBER = 'owl:minCardinality "²"'
VALUES = "owl:someValuesFrom {}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # A relative is also one of each class above its own, by each property above.
        (
            ":p rdfs:subPropertyOf :q ; rdfs:domain :A . :B a owl:Class ; rdfs:subClassOf :C ."
            f" :D rdfs:subClassOf {SOME.format(':p', VALUES.format(':B'))} ."
            f" :E owl:equivalentClass {SOME.format(':q', VALUES.format(':C'))} ."
            f" :F owl:equivalentClass {SOME.format(':p', VALUES.format(':F'))} .",
            "B<C D<A D<E F<A",
        ),
        # Restrictions to none, or to at most some relatives, do not imply one.
        (
            f":A rdfs:subClassOf {SOME.format(':p', 'owl:minCardinality 0')} ."
            f" :B rdfs:subClassOf {SOME.format(':p', 'owl:maxCardinality 1')} ."
            f" :C rdfs:subClassOf {SOME.format(':p', 'owl:allValuesFrom :A')} ."
            f" :D owl:equivalentClass {SOME.format(':p', 'owl:minCardinality 2')} ."
            f" :E rdfs:subClassOf {SOME.format(':p', 'owl:minCardinality 1')} ."
            f" :G rdfs:subClassOf {SOME.format(':p', NO_NUMBER)} ."
            " :p rdfs:domain :F .",
            "D<F E<F",
        ),
        # Inverse and equivalent properties have each other's domains and ranges.
        (
            ":p owl:inverseOf :q . :q owl:equivalentProperty :r ."
            " :p rdfs:domain :A ; rdfs:range :B . :s a owl:SymmetricProperty ; rdfs:domain :C ."
            " :D a owl:NamedIndividual ; :r :E ; :s :F . :E a owl:NamedIndividual ."
            " :F a owl:NamedIndividual .",
            "D<B D<C E<A F<C",
        ),
        (
            ":p owl:inverseOf :q . :q owl:equivalentProperty :r ."
            " :p rdfs:domain :A ; rdfs:range :B . :C a owl:Class ."
            f" :D rdfs:subClassOf {SOME.format('[ owl:inverseOf :p ]', VALUES.format(':C'))} ."
            f" :E owl:equivalentClass {SOME.format(':r', VALUES.format(':A'))} .",
            "D<B D<E E<B",
        ),
        # Domains and ranges are classes of the ends of a property; literals have none.
        (
            ":p rdfs:subPropertyOf :q ; rdfs:domain :A . :q rdfs:range :B ."
            " :r rdfs:domain :C ; rdfs:range rdfs:Literal ."
            " :D a owl:NamedIndividual ; :p :E ; :r 'nose' . :E a owl:NamedIndividual .",
            "D<A D<C E<B",
        ),
    ],
)
def test_what_restrictions_and_properties_entail(ontology, text: str, expected: str) -> None:
    assert subsumed(ontology(text), "A B C D E F") == expected.split()


@pytest.mark.parametrize(
    "some",
    [
        "owl:hasValue :x",
        "owl:minCardinality 1",
        "owl:cardinality 2",
        pytest.param(f'owl:minCardinality "{"9" * 5000}"', id="very many"),
        "owl:minQualifiedCardinality 3 ; owl:onClass :Other",
        "owl:qualifiedCardinality 1 ; owl:onDataRange rdfs:Literal",
    ],
)
def test_a_number_of_relatives_is_some_relative(ontology, some: str) -> None:
    found = ontology(
        f":A rdfs:subClassOf [ a owl:Restriction ; owl:onProperty :p ; {some} ] .\n"
        ":p rdfs:domain :Domain .\n"
        ":Some owl:equivalentClass [ a owl:Restriction ; owl:onProperty :p ;"
        " owl:someValuesFrom owl:Thing ] . :Others owl:equivalentClass [ a owl:Restriction ;"
        " owl:onProperty :p ; owl:minQualifiedCardinality 1 ; owl:onClass :Other ] .\n"
        ":Other a owl:Class ."
    )
    assert "Domain" in found.names_above("A")
    assert "Some" in found.names_above("A")
    assert ("Others" in found.names_above("A")) == (":Other" in some)
    assert "A" not in found.names_above("Some")


def test_that_two_are_the_same_is_not_read_and_a_warning(ontology) -> None:
    found = ontology(":a a :Camera . :b a :Robot ; owl:sameAs :a .")
    assert "Robot" not in found.names_above("a")
    assert any("owl:sameAs in the description of" in each.message for each in found.warnings)
