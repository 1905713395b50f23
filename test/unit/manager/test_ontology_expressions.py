# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Class expressions of OWL: what follows from them, and that nothing else is claimed."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import FrozenSet, Iterator, List, NamedTuple, Sequence, Tuple, Union

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications import ontology_statements
from dyknow.manager.specifications.ontology import Ontology, load_ontology

BASE = "http://example.org/#"
PREFIXES = f"""
@prefix : <{BASE}> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""


@pytest.fixture
def ontology(tmp_path: Path):
    def load(text: str) -> Ontology:
        path = tmp_path / "o.ttl"
        path.write_text(PREFIXES + text, encoding="utf-8")
        return load_ontology([str(path)])

    return load


def subsumed(found: Ontology, names: str) -> List[str]:
    """Pairs of different names of which the first is subsumed by the second, as `A<B`."""
    pairs = itertools.permutations(names.split(), 2)
    return sorted(f"{one}<{other}" for one, other in pairs if found.is_subsumed(one, other))


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
        # Data types are no classes.
        (
            ":A a rdfs:Datatype ; owl:equivalentClass [ a rdfs:Datatype ; owl:oneOf ( 1 2 ) ] ."
            " :B a rdfs:Datatype ; owl:unionOf ( :A :C ) . :D owl:equivalentClass 'text' .",
            "",
        ),
    ],
)
def test_what_an_expression_entails(ontology, text: str, expected: str) -> None:
    assert subsumed(ontology(text), "A B C D E F") == expected.split()


def test_an_intersection_has_the_individuals_that_are_in_all_parts(ontology) -> None:
    found = ontology(
        ":C owl:equivalentClass [ owl:intersectionOf ( :A :B ) ] . :B1 rdfs:subClassOf :B ."
        ":C1 rdfs:subClassOf :C . :U owl:unionOf ( :C :V ) . :V a owl:Class ."
        ":ab a :A, :B1 . :a a :A . :b a :B1 . :c a :C1 ."
    )

    assert found.individuals(BASE + "C") == ("ab", "c")
    assert found.individuals(BASE + "U") == ("ab", "c")
    assert found.individuals(BASE + "A") == ("a", "ab", "c")
    assert [each for each in ("a", "ab", "b", "c") if found.is_subsumed(each, "C")] == ["ab", "c"]


def test_one_of_makes_its_members_individuals(ontology) -> None:
    found = ontology(
        ':Colour owl:equivalentClass [ owl:oneOf ( :red :green ) ] . :red rdfs:label "rot" .'
        ":Warm owl:oneOf ( :red ) ; rdfs:subClassOf :Nice ."
    )

    assert found.individuals(BASE + "Colour") == ("green", "rot")
    assert found.individuals(BASE + "Nice") == ("rot",)
    assert found.is_subsumed("green", "Colour")
    assert not found.is_subsumed("green", "Warm")
    assert not found.is_subsumed("Warm", "green")


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
    with pytest.raises(OntologyFileError, match=rf"o\.ttl: the list of owl:\w+ of .*{reason}"):
        ontology(text)


N_TRIPLES = {
    prefix: f"<http://www.w3.org/{place}#"
    for prefix, place in (
        ("owl", "2002/07/owl"),
        ("rdf", "1999/02/22-rdf-syntax-ns"),
        ("rdfs", "2000/01/rdf-schema"),
    )
}
OWL, RDF, RDFS = N_TRIPLES["owl"], N_TRIPLES["rdf"], N_TRIPLES["rdfs"]


def deep(count: int) -> Iterator[str]:
    """Intersections in intersections; individual x is in the innermost, y in the outermost."""
    for n in range(count):
        yield f"_:e{n} {OWL}intersectionOf> _:l{n} ."
        yield f"_:l{n} {RDF}first> <{BASE}P{n}> . _:l{n} {RDF}rest> _:m{n} ."
        yield f"_:m{n} {RDF}first> _:e{n + 1} . _:m{n} {RDF}rest> {RDF}nil> ."
        yield f"<{BASE}y> {RDF}type> <{BASE}P{n}> ."
    yield f"<{BASE}C> {OWL}equivalentClass> _:e0 . <{BASE}x> {RDF}type> <{BASE}C> ."
    yield f"_:e{count} {RDFS}subClassOf> <{BASE}D> . <{BASE}y> {RDF}type> _:e{count} ."


def wide(count: int) -> Iterator[str]:
    """A union and an intersection of many classes."""
    for word, whole in (("unionOf", "U"), ("intersectionOf", "I")):
        yield f"<{BASE}{whole}> {OWL}{word}> _:{whole}0 ."
        for n in range(count):
            rest = f"_:{whole}{n + 1}" if n + 1 < count else f"{RDF}nil>"
            yield f"_:{whole}{n} {RDF}first> <{BASE}P{n}> . _:{whole}{n} {RDF}rest> {rest} ."
    yield f"<{BASE}x> {RDF}type> <{BASE}I> . <{BASE}y> {RDF}type> <{BASE}P7> ."


def lines(triples: Iterator[str]) -> str:
    return "\n".join(" .\n".join(each.split(" . ")) for each in triples) + "\n"


def test_deep_and_wide_expressions_take_no_time(tmp_path: Path) -> None:
    deep_file, wide_file = tmp_path / "deep.nt", tmp_path / "wide.nt"
    deep_file.write_text(lines(deep(1500)))
    wide_file.write_text(lines(wide(3000)))

    started = time.process_time()
    found = load_ontology([str(deep_file)])
    assert found.individuals(BASE + "C") == ("x", "y")
    assert found.individuals(BASE + "D") == ("x", "y")
    assert found.is_subsumed("C", "P1499")
    found = load_ontology([str(wide_file)])
    assert found.individuals(BASE + "I") == ("x",)
    assert found.individuals(BASE + "U") == ("x", "y")
    assert found.is_subsumed("I", "U")
    assert not found.is_subsumed("U", "P1")
    assert time.process_time() - started < 60.0


def test_too_many_unions_are_told(ontology, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ontology_statements, "VISITS", 1)
    found = ontology(":C owl:unionOf ( :A :B ) .")

    assert found.is_subsumed("A", "C")
    assert found.warnings[-1].message.startswith("too many unions to find all superclasses")
    assert found.warnings[-1].line == 6


# The property: a checker of models that shares no code and no idea with the hierarchy


class Combined(NamedTuple):
    """A class expression."""

    word: str
    members: Tuple[Expression, ...]


Expression = Union[str, Combined]

CLASSES, INDIVIDUALS = ("A", "B", "C", "D"), ("x", "y", "z")
#: One kind of element: the classes that it is in, and the individuals that it is.
Kind = Tuple[FrozenSet[str], FrozenSet[str]]
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
    """Whether an element of a kind is in a class."""
    classes, individuals = kind
    if isinstance(expression, str):
        return expression in classes
    if expression.word == "oneOf":
        return any(each in individuals for each in expression.members)
    together = all if expression.word == "intersectionOf" else any
    return together(holds(each, kind) for each in expression.members)


def subsets(names: Sequence[str]) -> List[FrozenSet[str]]:
    sizes = range(len(names) + 1)
    return [frozenset(each) for size in sizes for each in itertools.combinations(names, size)]


def allowed(kind: Kind, stated: Sequence[Axiom]) -> bool:
    """Whether an element of a kind contradicts nothing that is stated."""
    for word, one, other in stated:
        if word == "a":
            fits = one not in kind[1] or holds(other, kind)
        elif word == "<":
            fits = not holds(one, kind) or holds(other, kind)
        else:
            fits = holds(one, kind) == holds(other, kind)
        if not fits:
            return False
    return True


def kinds_in_models(stated: Sequence[Axiom]) -> List[Kind]:
    """The kinds of elements that some model has, where each individual is one element."""
    kinds = [
        kind
        for kind in itertools.product(subsets(CLASSES), subsets(INDIVIDUALS))
        if allowed(kind, stated)
    ]
    blocks = {individuals for _, individuals in kinds if individuals}

    def can_be_completed(individuals: FrozenSet[str]) -> bool:
        rest = sorted(set(INDIVIDUALS) - individuals)
        if not rest:
            return True
        return any(
            rest[0] in block and not block & individuals and can_be_completed(individuals | block)
            for block in blocks
        )

    return [kind for kind in kinds if can_be_completed(kind[1])]


def entailed(stated: Sequence[Axiom]) -> FrozenSet[Tuple[str, str]]:
    """Every subsumption and every type that holds in all models."""
    kinds = kinds_in_models(stated)
    found = set()
    for upper in CLASSES:
        for lower in CLASSES:
            if all(upper in classes for classes, _ in kinds if lower in classes):
                found.add((lower, upper))
        for individual in INDIVIDUALS:
            if all(upper in classes for classes, names in kinds if individual in names):
                found.add((individual, upper))
    return frozenset(found)


def claimed(stated: Sequence[Axiom], folder: Path) -> FrozenSet[Tuple[str, str]]:
    """What the ontology says, by both of its ways."""
    path = folder / "o.ttl"
    path.write_text(turtle(stated))
    found = load_ontology([str(path)])
    pairs = itertools.product((*CLASSES, *INDIVIDUALS), CLASSES)
    claims = frozenset(pair for pair in pairs if found.is_subsumed(*pair))
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
    assert ("y", "B") not in entailed([("a", "y", "A"), ("a", "x", "B")])


def test_what_has_some_relative_has_one_of_each_class_above_it(ontology) -> None:
    found = ontology(
        ":teaches rdfs:subPropertyOf :knows ; rdfs:domain :Teacher .\n"
        ":Lecture a owl:Class ; rdfs:subClassOf :Course .\n"
        ":Lecturer rdfs:subClassOf :Person,"
        " [ a owl:Restriction ; owl:onProperty :teaches ; owl:someValuesFrom :Lecture ] .\n"
        ":Learned owl:equivalentClass [ owl:intersectionOf ( :Person"
        " [ a owl:Restriction ; owl:onProperty :knows ; owl:someValuesFrom :Course ] ) ] .\n"
        ":Knowing owl:equivalentClass"
        " [ a owl:Restriction ; owl:onProperty :teaches ; owl:someValuesFrom :Person ] .\n"
    )
    assert found.is_subsumed("Lecturer", "Learned")
    assert found.is_subsumed("Lecturer", "Teacher")
    assert found.is_subsumed("Knowing", "Teacher")
    assert not found.is_subsumed("Lecturer", "Knowing")
    assert not found.is_subsumed("Learned", "Lecturer")
    assert not found.is_subsumed("Person", "Learned")


@pytest.mark.parametrize(
    "some",
    [
        "owl:hasValue :x",
        "owl:minCardinality 1",
        "owl:cardinality 2",
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
    assert found.is_subsumed("A", "Domain")
    assert found.is_subsumed("A", "Some")
    assert found.is_subsumed("A", "Others") == (":Other" in some)
    assert not found.is_subsumed("Some", "A")


def test_none_and_at_most_some_relatives_are_no_relative(ontology) -> None:
    restriction = "[ a owl:Restriction ; owl:onProperty :p ; {} ]"
    found = ontology(
        f":A rdfs:subClassOf {restriction.format('owl:minCardinality 0')} .\n"
        f":B rdfs:subClassOf {restriction.format('owl:maxCardinality 1')} .\n"
        f":C rdfs:subClassOf {restriction.format('owl:allValuesFrom :A')} .\n"
        f":D owl:equivalentClass {restriction.format('owl:minCardinality 2')} .\n"
        f":E rdfs:subClassOf {restriction.format('owl:minCardinality 1')} .\n"
        ":p rdfs:domain :F ."
    )
    assert subsumed(found, "A B C D E F") == ["D<F", "E<F"]


def test_inverse_and_equivalent_properties_have_each_others_domains_and_ranges(ontology) -> None:
    found = ontology(
        ":sees owl:inverseOf :seenBy . :seenBy owl:equivalentProperty :watchedBy .\n"
        ":sees rdfs:domain :Camera ; rdfs:range :Ball . :near a owl:SymmetricProperty .\n"
        ":near rdfs:domain :Place .\n"
        ":Goal rdfs:subClassOf [ a owl:Restriction ; owl:onProperty [ owl:inverseOf :sees ] ;"
        " owl:someValuesFrom :Robot ] . :Robot a owl:Class .\n"
        ":Seen owl:equivalentClass [ a owl:Restriction ; owl:onProperty :watchedBy ;"
        " owl:someValuesFrom :Camera ] .\n"
        ":a a owl:NamedIndividual ; :watchedBy :b ; :near :c . :b a owl:NamedIndividual .\n"
        ":c a owl:NamedIndividual ."
    )
    assert found.is_subsumed("a", "Ball")
    assert found.is_subsumed("b", "Camera")
    assert not found.is_subsumed("a", "Camera")
    assert found.is_subsumed("c", "Place")
    assert found.is_subsumed("Goal", "Ball")
    assert found.is_subsumed("Goal", "Seen")  # what sees it is a camera
    assert not found.is_subsumed("Robot", "Camera")


LONG = 5000
CHAINS = [
    *((f":p{n}", "rdfs:subClassOf", f":p{n + 1}") for n in range(LONG)),
    *((f":p{n}", "rdfs:subPropertyOf", f":p{n + 1}") for n in range(LONG)),
    (f":p{LONG}", "rdfs:domain", ":Domain"),
    (":x", "rdf:type", "owl:NamedIndividual"),
    (":x", ":p0", ":x"),
    (":Some", "rdfs:subClassOf", "_:some"),
    ("_:some", "owl:onProperty", ":p0"),
    ("_:some", "owl:someValuesFrom", ":p0"),
    (":Wider", "owl:equivalentClass", "_:wider"),
    ("_:wider", "owl:onProperty", f":p{LONG}"),
    ("_:wider", "owl:someValuesFrom", f":p{LONG}"),
]


def uri(name: str) -> str:
    prefix, _, local = name.partition(":")
    return name if prefix == "_" else f"{N_TRIPLES[prefix] if prefix else '<' + BASE}{local}>"


def rdf_xml(triples: Sequence[Tuple[str, str, str]]) -> str:
    def node(name: str, word: str) -> str:
        blank = name.startswith("_:")
        return f'rdf:nodeID="{name[2:]}"' if blank else f'rdf:{word}="{uri(name)[1:-1]}"'

    spaces = " ".join(f'xmlns:{prefix}="{each[1:]}"' for prefix, each in N_TRIPLES.items())
    told = "\n".join(
        f"<rdf:Description {node(one, 'about')}>"
        f"<{name.lstrip(':')} {node(other, 'resource')}/></rdf:Description>"
        for one, name, other in triples
    )
    return f'<rdf:RDF xmlns="{BASE}" {spaces}>\n{told}\n</rdf:RDF>\n'


@pytest.mark.parametrize(
    ("ending", "text"),
    [
        ("ttl", PREFIXES + "".join(f"{' '.join(each)} .\n" for each in CHAINS)),
        ("nt", "".join(f"{' '.join(map(uri, each))} .\n" for each in CHAINS)),
        ("owl", rdf_xml(CHAINS)),
    ],
    ids=["Turtle", "N-Triples", "RDF/XML"],
)
def test_long_chains_of_classes_and_of_properties(tmp_path: Path, ending: str, text: str) -> None:
    path = tmp_path / f"o.{ending}"
    path.write_text(text)

    found = load_ontology([str(path)])
    assert found.is_subsumed("p0", f"p{LONG}")
    assert found.is_subsumed("x", "Domain")
    assert found.is_subsumed("Some", "Wider")
    assert found.is_subsumed("Some", "Domain")
    assert found.individuals(BASE + "Domain") == ("x",)


def test_domains_and_ranges_are_classes_of_what_a_property_relates(ontology) -> None:
    found = ontology(
        ":sees rdfs:subPropertyOf :senses ; rdfs:domain :Camera .\n"
        ":senses rdfs:range :Thing . :named rdfs:domain :Named ; rdfs:range rdfs:Literal .\n"
        ":nose a owl:NamedIndividual ; :sees :ball ; :named 'nose' . :ball a owl:NamedIndividual ."
    )
    assert found.is_subsumed("nose", "Camera")
    assert found.is_subsumed("nose", "Named")
    assert found.is_subsumed("ball", "Thing")
    assert not found.is_subsumed("ball", "Camera")


def test_that_two_are_the_same_is_not_read_and_a_warning(ontology) -> None:
    found = ontology(":a a :Camera . :b a :Robot ; owl:sameAs :a .")
    assert not found.is_subsumed("a", "Robot")
    assert any("owl:sameAs in the description of" in each.message for each in found.warnings)
