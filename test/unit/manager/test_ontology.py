# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ontologies: files that are read and refused, names of classes and individuals, and remarks."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any, Callable, List, Tuple

import pytest
from clocks import patch_here
from unit.manager.planning.examples import demand, make, planner_with

from dyknow.errors import (
    IndividualsError,
    LabelsError,
    OntologyError,
    OntologyFileError,
    UnknownConcept,
)
from dyknow.manager.specifications.ontologies.ontology import Ontology

BASE, OTHER = "http://example.org/#", "http://other.org/#"
PREFIXES = f"""
@prefix : <{BASE}> .
@prefix o: <{OTHER}> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix skos: <http://www.w3.org/2004/02/skos/core#> .
"""
#: The line that follows the prefixes.
FIRST_LINE = PREFIXES.count("\n") + 1
Load = Callable[..., Ontology]


def loader(folder: Path) -> Load:
    """Return a function that loads texts in Turtle, each as a file of its own."""

    def load(*texts: str, **options: Any) -> Ontology:
        paths = [folder / f"o{number}.ttl" for number in range(len(texts))]
        for path, text in zip(paths, texts):
            path.write_text(PREFIXES + text, encoding="utf-8")
        return Ontology([str(path) for path in paths], **options)

    return load


@pytest.fixture
def ontology(tmp_path: Path) -> Load:
    return loader(tmp_path)


def messages(found: Ontology) -> List[str]:
    return [each.message for each in found.warnings]


# Names


@pytest.mark.parametrize("name", ["Goalie", "x"])
def test_a_concept_that_is_not_there(ontology: Load, name: str) -> None:
    found = ontology(":C a owl:Class . :x a :C . :Empty a owl:Class .")

    assert found.individuals(BASE + "Empty") == ()
    with pytest.raises(UnknownConcept, match=f"no class <.*#{name}>"):
        found.individuals(BASE + name)


def test_a_missing_label_falls_back_to_the_end_of_the_uri(ontology: Load) -> None:
    found = ontology(
        ':C a owl:Class . :a a :C . :b a :C ; rdfs:label " " . :c a :C ; rdfs:label "sea" .'
        "<http://example.org/things/d> a :C ."
    )

    assert found.individuals(BASE + "C") == ("a", "b", "d", "sea")
    unlabelled = (BASE + "a", BASE + "b", "http://example.org/things/d")
    assert found.unlabelled(BASE + "C") == unlabelled
    assert "C" in found.names_above("a")
    assert "C" not in found.names_above("c")


@pytest.mark.parametrize(
    ("text", "reasons"),
    [
        (
            ':b a :C ; rdfs:label "b", "bee" .',
            [f"<{BASE}b> has the labels 'b', 'bee'; expected exactly one"],
        ),
        (
            ':a a :C . :b a :C ; rdfs:label "a" .',
            [f"<{BASE}a> has no label, and 'a' means <{BASE}b> too"],
        ),
        (
            ':x a :C . o:x a :C . :y a :C . o:y a :C ; rdfs:label "y" .',
            [
                f"<{BASE}x> has no label, and 'x' means <{OTHER}x> too",
                f"<{BASE}y> has no label, and 'y' means <{OTHER}y> too",
                f"<{OTHER}x> has no label, and 'x' means <{BASE}x> too",
            ],
        ),
    ],
)
def test_individuals_without_a_name_of_their_own_serve_no_template(
    ontology: Load, text: str, reasons: List[str]
) -> None:
    found = ontology(":C a owl:Class . " + text)

    with pytest.raises(IndividualsError) as caught:
        found.individuals(BASE + "C")
    assert len(caught.value.reasons) == len(reasons)
    assert all(map(str.endswith, caught.value.reasons, reasons))


@pytest.mark.parametrize(
    ("language", "labels", "term"),
    [
        ("en", 'rdfs:label "kamera"@sv, "camera"@en', "camera"),
        ("en", 'rdfs:label "cam", "camera"@en', "camera"),
        ("en", 'rdfs:label "cam", "camera"@en-GB', "cam"),
        ("en", 'rdfs:label "kamera"@sv, "camera"@en-GB', "camera"),
        ("en-GB", 'rdfs:label "a"@en-GB, "b"@en, "c"', "a"),
        ("en-GB", 'rdfs:label "b"@en, "c", "d"@en-US', "b"),
        ("EN-gb", 'rdfs:label "a"@en-gb, "b"', "a"),
        ("sv", 'rdfs:label "kamera"@sv, "camera"@en, "cam"', "kamera"),
        ("sv", 'rdfs:label "camera"@en, "cam"', "cam"),
        ("sv", 'rdfs:label "camera"@en, "Kamera"@de', "camera"),
        ("sv", 'rdfs:label "appareil"@fr, "Kamera"@de', "Kamera"),
        ("en", 'rdfs:label "cam"@en, "cam"@sv, "cam"', "cam"),
        ("en", 'skos:prefLabel "cam"', "cam"),
        ("en", 'skos:prefLabel "cam" ; rdfs:label "camera"', "camera"),
        ("en", 'skos:prefLabel "cam"@en ; rdfs:label "kamera"@sv', "cam"),
    ],
)
def test_the_term_is_the_label_in_the_preferred_language(
    ontology: Load, language: str, labels: str, term: str
) -> None:
    text = f':C a owl:Class ; skos:prefLabel "Class" . :x a :C ; {labels} .'
    found = ontology(text, language=language)

    assert found.individuals(BASE + "C") == (term,)
    assert found.written(f"{BASE}x") == term
    for label in labels.split('"')[1::2]:
        assert found.canonical(label) == f"{BASE}x"
        assert "Class" in found.names_above(label)


@pytest.mark.parametrize("language", ["", "English please", "en_GB", "en-", "a" * 9])
def test_a_language_that_is_none(ontology: Load, language: str) -> None:
    with pytest.raises(OntologyError, match="is no language; expected a code such as en or en-GB"):
        ontology("", language=language)


def test_all_names_of_an_individual_have_the_same_canonical_one(ontology: Load) -> None:
    found = ontology(
        ':C a owl:Class ; rdfs:label "Cam" . :x a :C ; rdfs:label "one"@en, "ett"@sv ;'
        ' skos:prefLabel "first" . :y a :C . [] a :C ; rdfs:label "blank" .'
    )

    assert {found.canonical(name) for name in ("one", "ett", "first", BASE + "x")} == {BASE + "x"}
    assert found.canonical("y") == found.canonical(BASE + "y") == BASE + "y"
    assert found.canonical("Cam") == found.canonical(BASE + "C") == BASE + "C"
    assert found.canonical("x") == "x"
    assert found.canonical("blank") == "blank"
    assert found.names_above("blank") == {"blank", "Cam", BASE + "C"}
    assert found.individuals(BASE + "C") == ("blank", "one", "y")


def test_plans_write_names_in_the_preferred_language(ontology: Load) -> None:
    found = ontology(
        ':Camera a owl:Class ; rdfs:label "Kamera"@de, "camera"@en . :Lidar a owl:Class .'
        ':l a :Camera ; rdfs:label "left camera"@en, "Kamera links"@de .'
    )
    planner = planner_with([make("l", [], ["Image(Kamera links)"])], found)
    assert planner.bindings(demand("Image(?c)")) == ([(("?c", "left camera"),)], True)
    why = "left camera is a camera, not a Lidar"
    assert why in str(planner.plan(demand("Image(?c: Lidar)")))


def test_equivalent_classes_are_two_that_may_have_the_same_label(ontology: Load) -> None:
    found = ontology(
        ':S a owl:Class ; rdfs:label "Sensor" . o:S owl:equivalentClass :S ;'
        ' rdfs:label "Sensor" ; rdfs:subClassOf o:D . :x a o:S . o:D rdfs:label "Device" .'
        ":E owl:equivalentClass :F ."
    )

    assert "Sensor" in found.names_above("x")
    assert "Device" in found.names_above("Sensor")
    assert OTHER + "S" in found.names_above(BASE + "S")
    assert found.canonical("E") != found.canonical("F")
    assert found.names_above("E") == found.names_above("F") == {"E", "F", BASE + "E", BASE + "F"}


@pytest.mark.parametrize(("kind", "what"), [("owl:Class", "classes"), (":C", "individuals")])
def test_equal_labels_are_refused(ontology: Load, kind: str, what: str) -> None:
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


def test_a_term_goes_before_a_label_in_another_language(ontology: Load) -> None:
    found = ontology(
        ':C a owl:Class . :a a :C ; rdfs:label "gift"@en . '
        ':b a :C ; rdfs:label "poison"@en, "gift"@de . '
        ':c a :C ; rdfs:label "c"@en, "both"@de . :d a :C ; rdfs:label "d"@en, "both"@de .'
    )

    assert found.canonical("gift") == BASE + "a"
    assert found.names_above(BASE + "b") == {"poison", BASE + "b", "C", BASE + "C"}
    assert found.canonical("both") == "both"
    assert "C" not in found.names_above("both")


def test_a_label_that_is_shared_in_another_language_alone_names_neither(ontology: Load) -> None:
    found = ontology(
        ':Rosa a owl:Class ; rdfs:label "Cobertura"@pt .\n'
        ':Nut a owl:Class ; rdfs:label "Cobertura"@pt .\n'
        ':Topping a owl:Class ; rdfs:label "Topping"@en, "Cobertura"@pt .\n'
        ':left a :Nut ; rdfs:label "noz"@pt . :right a :Nut ; rdfs:label "noz"@pt .\n'
    )
    for name in ("Rosa", "Nut", "Topping"):
        assert found.canonical(name) == BASE + name
    said = f"the label 'Cobertura' of <{BASE}Nut> in 'pt' is that of another one too"
    assert any(each.startswith(said) for each in messages(found))
    assert found.individuals(BASE + "Nut") == ("left", "right")


def test_equal_last_parts_of_uris_are_names_of_neither(ontology: Load) -> None:
    found = ontology(
        ":C a owl:Class . :D a owl:Class . o:D a owl:Class .\n"
        ':y a :C . o:y a :C ; rdfs:label "y" .'
    )

    assert found.names_above("D") == {"D"}
    assert found.names_above(BASE + "D") == {BASE + "D"}
    assert found.canonical("y") == OTHER + "y"
    told = "have no label, and 'D' names none of them"
    assert f"<{BASE}D>, <{OTHER}D> {told}" in messages(found)


def test_a_class_and_an_individual_may_share_a_name_and_that_is_told(ontology: Load) -> None:
    found = ontology(
        ':Ball rdfs:subClassOf :Thing ; rdfs:label "ball" . :Thing rdfs:label "Thing" .'
        ':b a :Toy ; rdfs:label "ball" . :Toy rdfs:label "Toy" .'
    )

    assert found.canonical("ball") == BASE + "b"
    assert "Thing" in found.names_above("ball")
    assert "Toy" in found.names_above("ball")
    assert "Thing" not in found.names_above(BASE + "b")
    assert "Toy" not in found.names_above(BASE + "Ball")
    assert found.written(BASE + "b") == "ball"
    assert found.written(BASE + "Ball") == BASE + "Ball", "'ball' would be the individual"
    assert messages(found) == [f"'ball' names the class <{BASE}Ball> and the individual <{BASE}b>"]


# Remarks

RESTRICTIONS = """\
:Ball a owl:Class ; rdfs:label "Ball" ;
  rdfs:subClassOf :Thing ,
    [ a owl:Restriction ; owl:onProperty :p ; owl:someValuesFrom :Colour ] .
:Goal rdfs:label "Goal" ; owl:equivalentClass [ a owl:Class ; owl:intersectionOf ( :Thing
  [ a owl:Class ; owl:unionOf ( :Other
    [ a owl:Restriction ; owl:onProperty :p ; owl:minCardinality 1 ] ) ] ) ] .
:Other rdfs:label "Other" ; rdfs:subClassOf
  [ a owl:Class ; owl:complementOf :Ball ] .
:Thing a owl:Class ; rdfs:label "Thing" .
:red rdfs:label "red" ; a
  [ a owl:Restriction ; owl:onProperty :p ; owl:hasValue :green ] .
[ a owl:Restriction ; owl:onProperty :p ; owl:allValuesFrom :x ] rdfs:subClassOf :Thing .
:p rdfs:domain [ a owl:Restriction ; owl:onProperty :q ; owl:hasValue :x ] .
"""


def test_a_warning_names_the_restriction_and_whether_it_is_read_in_part(ontology: Load) -> None:
    found = ontology(RESTRICTIONS)

    told = "owl:{} in the description of <http://example.org/#{}> is {}"
    assert [(each.line - FIRST_LINE, each.message) for each in found.warnings] == [
        (2, told.format("someValuesFrom", "Ball", "read in part")),
        (5, told.format("minCardinality", "Goal", "read in part")),
        (7, told.format("complementOf", "Other", "not read")),
        (10, told.format("hasValue", "red", "read in part")),
        (11, told.format("allValuesFrom", "Thing", "not read")),
    ]
    assert "Thing" in found.names_above("Ball")
    assert "Thing" in found.names_above("Goal")
    assert "Goal" not in found.names_above("Thing")
    assert found.names_above("Other") == {"Other", BASE + "Other"}


def test_remarks_are_counted_beyond_a_hundred(ontology: Load) -> None:
    found = ontology(
        "".join(f":c{n} rdfs:label 'c{n}' ; rdfs:subClassOf [] .\n" for n in range(130))
    )

    assert len(found.warnings) == 101
    assert found.warnings[0].line == FIRST_LINE
    said = f"a class expression in the description of <{BASE}c0> is not read"
    assert found.warnings[0].message == said
    assert found.warnings[-1].message == "30 more such remarks"


def test_a_language_that_is_missing_is_told(ontology: Load) -> None:
    found = ontology(
        ':C rdfs:label "C"@de ; a owl:Class .\n'
        ':x a :C ;\n  rdfs:label "Kamera"@de, "kamera"@sv .\n'
        ':y a :C ; rdfs:label "y", "ypsilon"@de .'
    )

    [warning] = found.warnings
    assert warning.line == FIRST_LINE + 2
    assert warning.message == (
        f"<{BASE}x> has labels in several languages (de, sv), none in 'en'; its term is 'Kamera'"
    )


def test_what_has_no_label_is_told_once_for_each_file(ontology: Load) -> None:
    found = ontology(
        ':A a owl:Class . :B a owl:Class ; rdfs:label "B" .\n' + ":a a :A . :b a :B . :c a :C .\n",
        ":A1 rdfs:subClassOf :A .\n:p rdfs:domain :A . :b rdfs:comment 'other file' .",
    )

    told = "no label, so that the last part of the URI is the name: "
    assert [(each.file[-6:], each.line, each.message) for each in found.warnings] == [
        (
            "o0.ttl",
            FIRST_LINE,
            told + ", ".join(f"<{BASE}{each}>" for each in ("A", "C", "a", "b", "c")),
        ),
        ("o1.ttl", FIRST_LINE, told + f"<{BASE}A1>"),
    ]
    many = ontology("".join(f":a{n} a owl:Class . " for n in range(9)))
    assert messages(many)[0].endswith(f"<{BASE}a4> and 4 more")


# Files

RDF = """<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [
{entities}
]>
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
         xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#">
  <rdf:Description rdf:about="http://example.org/a">
    <rdf:type rdf:resource="http://example.org/C"/>
    <rdfs:label>{label}</rdfs:label>
  </rdf:Description>
</rdf:RDF>
"""


def entity(name: str, value: str) -> str:
    return f'<!ENTITY {name} "{value}">'


@pytest.mark.parametrize("extension", [".owl", ".rdf"])
def test_nothing_is_fetched_and_no_other_file_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, extension: str
) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("SECRET")
    places = {"secret": secret.as_uri(), "remote": "http://localhost:1/remote"}
    entities = "".join(f'<!ENTITY {name} SYSTEM "{uri}">' for name, uri in places.items())
    path = tmp_path / f"o{extension}"
    path.write_text(RDF.format(entities=entities, label="cam&secret;&remote;1"))

    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError("a socket was opened")

    for name in ("socket", "create_connection", "getaddrinfo"):
        patch_here(monkeypatch, socket, name, refuse)

    assert Ontology([str(path)]).individuals("http://example.org/C") == ("cam1",)


NESTED = "\n".join(
    [
        entity("a", "a" * 10),
        *(entity(one, f"&{of};" * 10) for one, of in zip("bcdefgh", "abcdefg")),
    ]
)
LARGE = entity("a", "x" * 100_000), "&a;" * 2000


@pytest.mark.parametrize(
    ("content", "encoding", "reason"),
    [
        ((NESTED, "&h;"), "utf-8", "the entity 'b' contains others"),
        ((entity("a", "&#38;b;"), "&a;"), "utf-8", "the entity 'a' contains others"),
        (LARGE, "utf-8", "expand to 200000000 bytes"),
        (("<!ENTITY % a \"<!ENTITY b 'c'>\"> %a;", "&b;"), "utf-8", "'a' is one for declarations"),
        (LARGE, "utf-16", "UTF-16"),
    ],
)
def test_entities_that_explode_are_refused_before_they_do(
    tmp_path: Path, content: Tuple[str, str], encoding: str, reason: str
) -> None:
    path = tmp_path / "o.owl"
    text = RDF.format(entities=content[0], label=content[1])
    path.write_bytes(text.replace("?>", f' encoding="{encoding}"?>', 1).encode(encoding))

    with pytest.raises(OntologyFileError, match=reason):
        Ontology([str(path)])


def test_one_statement_of_rdf_needs_no_root(tmp_path: Path) -> None:
    path = tmp_path / "o.owl"
    path.write_text(
        '<owl:Class xmlns:owl="http://www.w3.org/2002/07/owl#" rdf:about="urn:C" '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"/>'
    )
    assert Ontology([str(path)]).is_class("urn:C")


def test_an_individual_without_a_name_is_left_out(ontology: Load) -> None:
    found = ontology(':C a owl:Class . :l a :C ; rdfs:label "left" . :r :has [ a :C ] .')
    assert found.individuals(BASE + "C") == ("left",)
    (anonymous,) = found.unlabelled(BASE + "C")
    assert anonymous.startswith("_:")


def test_entities_are_shorthands_for_namespaces(tmp_path: Path) -> None:
    path = tmp_path / "o.owl"
    text = RDF.format(entities=entity("ns", "http://example.org/"), label="cam")
    path.write_text(text.replace('"http://example.org/C"', '"&ns;D"'))

    assert Ontology([str(path)]).individuals("http://example.org/D") == ("cam",)


OWL_XML = """<?xml version="1.0"?>
<!DOCTYPE owl:Ontology>
<owl:Ontology xmlns:owl="http://www.w3.org/2002/07/owl#" ontologyIRI="http://example.org/o">
  <owl:Declaration><owl:Class IRI="#Camera"/></owl:Declaration>
</owl:Ontology>"""
XHTML = """<html xmlns="http://www.w3.org/1999/xhtml"><head><title>404 not found</title></head>
<body><p>There is no such file.</p></body></html>"""


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("o.ttl", "<u:a> <u:p> " + "[ <u:p> " * 5000 + "]" * 5000, "nests too deeply"),
        ("o.ttl", "@prefix : <http://x> .\n:a nonsense", "is not valid turtle: .*line 2"),
        ("o.owl", "<rdf:RDF", "is not valid xml"),
        ("o.owl", "# mine\nPrefix(:=<urn:a>)\nOntology(<urn:a>)", "is in OWL functional syntax"),
        ("o.owl", "Prefix: : <urn:a>\nOntology: <urn:a>", "is in Manchester syntax"),
        ("o.owl", '<?xml version="1.0"?>\n<Ontology/>', "is in OWL/XML"),
        ("o.owl", "<!-- a -->" * 40 + "<Error/>", "it begins with <Error>"),
        ("o.owl", OWL_XML, "it begins as OWL/XML, which is not read; expected <rdf:RDF>"),
        ("o.rdf", XHTML, "it begins with <html>; expected <rdf:RDF>"),
        ("o.owl", "<!DOCTYPE html><html><body/></html>", "it begins with <html>"),
        ("o.owl", "<Error><Code>NoSuchKey</Code></Error>", "it begins with <Error>"),
        ("o.owl", "@prefix : <urn:a> .", "is in Turtle, whose ending is .ttl; expected RDF/XML"),
        ("o.ttl", "<rdf:RDF></rdf:RDF>", "is in RDF/XML, whose endings are .owl and .rdf"),
        ("o.nt", "what is this", "is not valid nt"),
        ("o.ttl", "\0", "is not valid turtle"),
        ("o.json", "{}", "expected a file ending in .nt, .owl, .rdf, .ttl"),
        ("o.ttl", None, "cannot be read: No such file"),
    ],
)
def test_a_bad_file_is_named(tmp_path: Path, name: str, content: str, reason: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content)

    with pytest.raises(OntologyFileError, match=reason) as caught:
        Ontology([str(path)])
    assert caught.value.file == str(path)
