# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Names of classes and individuals: labels by language, canonical names, and names in doubt."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List

import pytest

from dyknow.errors import IndividualsError, LabelsError, OntologyError
from dyknow.manager.specifications.ontology import Ontology, load_ontology

BASE = "http://example.org/#"
PREFIXES = f"""\
@prefix : <{BASE}> .
@prefix o: <http://other.org/#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix skos: <http://www.w3.org/2004/02/skos/core#> .
"""


@pytest.fixture
def ontology(tmp_path: Path):
    def load(text: str, *others: str, **options: Any) -> Ontology:
        paths = []
        for number, each in enumerate((text, *others)):
            path = tmp_path / f"o{number}.ttl"
            path.write_text(PREFIXES + each, encoding="utf-8")
            paths.append(str(path))
        return load_ontology(paths, **options)

    return load


def messages(found: Ontology) -> List[str]:
    return [each.message for each in found.warnings]


@pytest.mark.parametrize(
    ("language", "labels", "term"),
    [
        ("en", '"kamera"@sv, "camera"@en', "camera"),
        ("en", '"cam", "camera"@en', "camera"),
        ("en", '"cam", "camera"@en-GB', "cam"),
        ("en", '"kamera"@sv, "camera"@en-GB', "camera"),
        ("en-GB", '"a"@en-GB, "b"@en, "c"', "a"),
        ("en-GB", '"b"@en, "c", "d"@en-US', "b"),
        ("EN-gb", '"a"@en-gb, "b"', "a"),
        ("sv", '"kamera"@sv, "camera"@en, "cam"', "kamera"),
        ("sv", '"camera"@en, "cam"', "cam"),
        ("sv", '"camera"@en, "Kamera"@de', "camera"),
        ("sv", '"appareil"@fr, "Kamera"@de', "Kamera"),
        ("en", '"cam"@en, "cam"@sv, "cam"', "cam"),
    ],
)
def test_the_term_is_the_label_in_the_preferred_language(
    ontology, language: str, labels: str, term: str
) -> None:
    found = ontology(f":C a owl:Class . :x a :C ; rdfs:label {labels} .", language=language)

    assert found.individuals(BASE + "C") == (term,)
    for label in labels.split('"')[1::2]:
        assert found.canonical(label) == f"{BASE}x"
        assert found.is_subsumed(label, "C")


@pytest.mark.parametrize("language", ["", "English please", "en_GB", "en-", "a" * 9])
def test_a_language_that_is_none(ontology, language: str) -> None:
    with pytest.raises(OntologyError, match="is no language; expected a code such as en or en-GB"):
        ontology("", language=language)


def test_a_language_that_is_missing_is_told(ontology) -> None:
    found = ontology(
        ':C rdfs:label "C"@de ; a owl:Class .\n'
        ':x a :C ;\n  rdfs:label "Kamera"@de, "kamera"@sv .\n'
        ':y a :C ; rdfs:label "y", "ypsilon"@de .'
    )

    [warning] = found.warnings
    assert warning.line == 8
    assert warning.message == (
        f"<{BASE}x> has labels in several languages (de, sv), none in 'en'; its term is 'Kamera'"
    )


@pytest.mark.parametrize(
    ("labels", "term"),
    [
        ('skos:prefLabel "cam"', "cam"),
        ('skos:prefLabel "cam" ; rdfs:label "camera"', "camera"),
        ('skos:prefLabel "cam"@en ; rdfs:label "kamera"@sv', "cam"),
    ],
)
def test_a_preferred_label_of_skos_counts_after_that_of_rdfs(
    ontology, labels: str, term: str
) -> None:
    found = ontology(f':C a owl:Class ; skos:prefLabel "C" . :x a :C ; {labels} .')

    assert found.individuals(BASE + "C") == (term,)
    assert found.unlabelled(BASE + "C") == ()
    assert found.is_subsumed("cam", "C")
    assert messages(found) == []


def test_what_has_no_label_is_told_once_for_each_file(ontology) -> None:
    found = ontology(
        ':A a owl:Class . :B a owl:Class ; rdfs:label "B" .\n' + ":a a :A . :b a :B . :c a :C .\n",
        ":A1 rdfs:subClassOf :A .\n:p rdfs:domain :A . :b rdfs:comment 'other file' .",
    )

    assert [(each.file[-6:], each.line, each.message) for each in found.warnings] == [
        (
            "o0.ttl",
            6,
            "no label, so that the last part of the URI is the name: "
            f"<{BASE}A>, <{BASE}C>, <{BASE}a>, <{BASE}b>, <{BASE}c>",
        ),
        (
            "o1.ttl",
            6,
            f"no label, so that the last part of the URI is the name: <{BASE}A1>",
        ),
    ]
    many = ontology("".join(f":a{n} a owl:Class . " for n in range(9)))
    assert messages(many)[0].endswith(f"<{BASE}a4> and 4 more")


class TestCanonical:
    def test_all_names_of_an_individual_have_the_same(self, ontology) -> None:
        found = ontology(
            ':C a owl:Class ; rdfs:label "Cam" . :x a :C ; rdfs:label "one"@en, "ett"@sv ;'
            ' skos:prefLabel "first" . :y a :C .'
        )

        names = ("one", "ett", "first", BASE + "x")
        assert {found.canonical(name) for name in names} == {BASE + "x"}
        assert found.canonical("y") == found.canonical(BASE + "y") == BASE + "y"
        assert found.canonical("Cam") == found.canonical(BASE + "C") == BASE + "C"
        assert found.canonical("x") == "x"

    def test_equivalent_classes_are_two(self, ontology) -> None:
        found = ontology(":C owl:equivalentClass :D .")

        assert found.canonical("C") != found.canonical("D")
        assert (
            found.names_above("C") == found.names_above("D") == {"C", "D", BASE + "C", BASE + "D"}
        )

    def test_a_blank_node_has_its_label_alone(self, ontology) -> None:
        found = ontology(':C a owl:Class . [] a :C ; rdfs:label "cam" .')

        assert found.canonical("cam") == "cam"
        assert found.names_above("cam") == {"cam", "C", BASE + "C"}
        assert found.individuals(BASE + "C") == ("cam",)


class TestSharedNames:
    @pytest.mark.parametrize(("kind", "what"), [("owl:Class", "classes"), (":C", "individuals")])
    def test_equal_labels_are_refused(self, ontology, kind: str, what: str) -> None:
        with pytest.raises(LabelsError) as caught:
            ontology(
                f':C a owl:Class . :a a {kind} ; rdfs:label "cam"@en .',
                f':b a {kind} ; rdfs:label "cam" . :c a {kind} ; skos:prefLabel "cam" .',
            )

        shown = [reason.replace(reason.split("o0.ttl")[0], "") for reason in caught.value.reasons]
        assert len(shown) == 2
        assert shown[0].startswith(f"o0.ttl: the {what} <{BASE}a> and <{BASE}b> in ")
        assert shown[0].endswith("o1.ttl share the label 'cam'")
        assert str(caught.value).endswith("; expected a label of its own for each")

    def test_equivalent_classes_may_have_the_same_label(self, ontology) -> None:
        found = ontology(
            ':S a owl:Class ; rdfs:label "Sensor" . o:S owl:equivalentClass :S ;'
            ' rdfs:label "Sensor" ; rdfs:subClassOf o:D . :x a o:S . o:D rdfs:label "Device" .'
        )

        assert found.is_subsumed("x", "Sensor")
        assert found.is_subsumed("Sensor", "Device")
        assert found.is_subsumed(BASE + "S", "http://other.org/#S")

    def test_a_term_goes_before_a_label_in_another_language(self, ontology) -> None:
        found = ontology(
            ':C a owl:Class . :a a :C ; rdfs:label "gift"@en . '
            ':b a :C ; rdfs:label "poison"@en, "gift"@de . '
            ':c a :C ; rdfs:label "c"@en, "both"@de . :d a :C ; rdfs:label "d"@en, "both"@de .'
        )

        assert found.canonical("gift") == BASE + "a"
        assert found.names_above(BASE + "b") == {"poison", BASE + "b", "C", BASE + "C"}
        assert found.canonical("both") == "both"
        assert not found.is_subsumed("both", "C")

    def test_equal_last_parts_of_uris_are_names_of_neither(self, ontology) -> None:
        found = ontology(
            ":C a owl:Class . :D a owl:Class . o:D a owl:Class . :x a :C . o:x a :C .\n"
            ':y a :C . o:y a :C ; rdfs:label "y" .'
        )

        assert found.names_above("D") == {"D"}
        assert found.names_above(BASE + "D") == {BASE + "D"}
        assert found.canonical("y") == "http://other.org/#y"
        told = "have no label, and 'D' names none of them"
        assert f"<{BASE}D>, <http://other.org/#D> {told}" in messages(found)
        with pytest.raises(IndividualsError) as caught:
            found.individuals(BASE + "C")
        assert caught.value.reasons == (
            f"<{BASE}x> has no label, and 'x' means <http://other.org/#x> too",
            f"<{BASE}y> has no label, and 'y' means <http://other.org/#y> too",
            f"<http://other.org/#x> has no label, and 'x' means <{BASE}x> too",
        )

    def test_a_class_and_an_individual_may_share_a_name_and_that_is_told(self, ontology) -> None:
        found = ontology(
            ':Ball rdfs:subClassOf :Thing ; rdfs:label "ball" . :Thing rdfs:label "Thing" .'
            ':b a :Toy ; rdfs:label "ball" . :Toy rdfs:label "Toy" .'
        )

        assert found.canonical("ball") == BASE + "b"
        assert found.is_subsumed("ball", "Thing")
        assert found.is_subsumed("ball", "Toy")
        assert not found.is_subsumed(BASE + "b", "Thing")
        assert not found.is_subsumed(BASE + "Ball", "Toy")
        assert messages(found) == [
            f"'ball' names the class <{BASE}Ball> and the individual <{BASE}b>"
        ]


def test_classes_that_share_a_label_in_another_language_alone_are_named_by_their_uris(
    ontology,
) -> None:
    found = ontology(
        ':Rosa a owl:Class ; rdfs:label "Cobertura"@pt .\n'
        ':Nut a owl:Class ; rdfs:label "Cobertura"@pt .\n'
        ':Topping a owl:Class ; rdfs:label "Topping"@en, "Cobertura"@pt .\n'
    )
    for name in ("Rosa", "Nut"):
        assert found.canonical(name) == BASE + name
    assert found.canonical("Topping") == BASE + "Topping"
    said = f"the label 'Cobertura' of <{BASE}Nut> in 'pt' is that of another one too"
    assert any(each.startswith(said) for each in messages(found))
    with pytest.raises(LabelsError):
        ontology(':A a owl:Class ; rdfs:label "X"@en . :B a owl:Class ; rdfs:label "X"@en .')


def test_individuals_that_share_a_label_in_another_language_alone(ontology) -> None:
    found = ontology(
        ":Camera a owl:Class .\n"
        ':left a :Camera ; rdfs:label "kamera"@sv .\n'
        ':right a :Camera ; rdfs:label "kamera"@sv .\n'
    )
    assert found.individuals(BASE + "Camera") == ("left", "right")
