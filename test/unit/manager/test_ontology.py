# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ontologies: individuals, labels, subsumption, and malformed files."""

import socket
from pathlib import Path

import pytest

from dyknow.errors import IndividualsError, OntologyFileError, UnknownConcept
from dyknow.manager.specifications.ontology import load_ontology

EXAMPLES = Path(__file__).parents[3] / "examples"
SOCCER = "http://dyknow.example.org/soccer#"
PREFIXES = """
@prefix : <http://example.org/#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""


@pytest.fixture
def soccer():
    return load_ontology([str(EXAMPLES / "ontologies" / "soccer.ttl")])


@pytest.fixture
def ontology(tmp_path):
    def load(text):
        path = tmp_path / "o.ttl"
        path.write_text(PREFIXES + text, encoding="utf-8")
        return load_ontology([str(path)])

    return load


def test_individuals_are_sorted_and_those_of_subclasses_included(soccer):
    assert soccer.individuals(SOCCER + "Camera") == ("bottom_camera", "ceiling_camera")
    assert soccer.individuals(SOCCER + "Robot") == ("nao",)
    assert soccer.individuals(SOCCER + "GoalObject") == ()


@pytest.mark.parametrize("name", ["Goalie", "nao"])
def test_a_concept_that_is_not_there(soccer, name):
    with pytest.raises(UnknownConcept, match=f"no class <.*#{name}>"):
        soccer.individuals(SOCCER + name)


@pytest.mark.parametrize(
    ("supplied", "demanded", "answer"),
    [
        ("BallObject", "WorldObject", True),
        ("WorldObject", "BallObject", False),
        ("BallObject", "BallObject", True),
        ("nao", "Robot", True),
        ("Robot", "nao", False),
        ("nao", "bottom_camera", False),
        ("nao", SOCCER + "SoccerRobot", True),
        (SOCCER + "nao", "Nao", True),
        ("BallObject", "Camera", False),
        ("unheard_of", "unheard_of", True),
        ("unheard_of", "Robot", False),
    ],
)
def test_subsumption_by_label_and_by_uri(soccer, supplied, demanded, answer):
    assert soccer.is_subsumed(supplied, demanded) is answer


def test_a_missing_label_falls_back_to_the_end_of_the_uri(ontology):
    found = ontology(
        ':C a owl:Class . :a a :C . :b a :C ; rdfs:label " " . :c a :C ; rdfs:label "sea" .'
        "<http://example.org/things/d> a :C ."
    )

    assert found.individuals("http://example.org/#C") == ("a", "b", "d", "sea")
    assert found.unlabelled("http://example.org/#C") == (
        "http://example.org/#a",
        "http://example.org/#b",
        "http://example.org/things/d",
    )
    assert found.is_subsumed("a", "C")
    assert not found.is_subsumed("c", "C")


def test_a_fallback_shares_no_name_with_a_label(ontology):
    found = ontology(':C a owl:Class . :a a :C . :b a :C ; rdfs:label "a" . [] a :C .')

    with pytest.raises(IndividualsError) as caught:
        found.individuals("http://example.org/#C")
    assert len(caught.value.reasons) == 2
    assert (
        "<http://example.org/#a> has no label, and 'a' means <http://example.org/#b> too"
        in caught.value.reasons
    )
    assert [
        each
        for each in caught.value.reasons
        if each.endswith("has the labels none; expected exactly one")
    ]


RESTRICTIONS = """
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


def test_a_warning_names_the_restriction_and_whether_it_is_read_in_part(ontology):
    found = ontology(RESTRICTIONS)

    told = "owl:{} in the description of <http://example.org/#{}> is {}"
    assert [(each.line, each.message) for each in found.warnings] == [
        (8, told.format("someValuesFrom", "Ball", "read in part")),
        (11, told.format("minCardinality", "Goal", "read in part")),
        (13, told.format("complementOf", "Other", "not read")),
        (16, told.format("hasValue", "red", "read in part")),
        (17, told.format("allValuesFrom", "Thing", "not read")),
    ]
    assert found.is_subsumed("Ball", "Thing")
    assert found.is_subsumed("Goal", "Thing")
    assert not found.is_subsumed("Thing", "Goal")
    assert found.names_above("Other") == {"Other", "http://example.org/#Other"}


def test_remarks_are_counted_beyond_a_hundred(ontology):
    found = ontology(
        "".join(f":c{n} rdfs:label 'c{n}' ; rdfs:subClassOf [] .\n" for n in range(130))
    )

    assert len(found.warnings) == 101
    assert found.warnings[0].line == 5
    assert found.warnings[0].message == (
        "a class expression in the description of <http://example.org/#c0> is not read"
    )
    assert found.warnings[-1].message == "30 more such remarks"


def test_two_labels_in_one_language_serve_no_template(ontology):
    found = ontology(':C a owl:Class . :b a :C ; rdfs:label "b", "bee" .')

    with pytest.raises(IndividualsError) as caught:
        found.individuals("http://example.org/#C")
    assert caught.value.reasons == (
        "<http://example.org/#b> has the labels 'b', 'bee'; expected exactly one",
    )
    assert found.canonical("b") == found.canonical("bee") == "http://example.org/#b"


OWL = """<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [
  <!ENTITY xsd "http://www.w3.org/2001/XMLSchema#">
  <!ENTITY secret SYSTEM "{secret}">
  <!ENTITY remote SYSTEM "http://localhost:1/remote">
]>
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
         xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#"
         xmlns:owl="http://www.w3.org/2002/07/owl#">
  <owl:Ontology rdf:about="http://example.org/">
    <owl:imports rdf:resource="http://localhost:1/imported.owl"/>
  </owl:Ontology>
  <rdf:Description rdf:about="http://example.org/a">
    <rdf:type rdf:resource="http://example.org/C"/>
    <rdfs:label>cam&secret;&remote;1</rdfs:label>
  </rdf:Description>
</rdf:RDF>
"""


@pytest.mark.parametrize("extension", [".owl", ".rdf"])
def test_nothing_is_fetched_and_no_other_file_is_read(tmp_path, monkeypatch, extension):
    secret = tmp_path / "secret.txt"
    secret.write_text("SECRET")
    path = tmp_path / f"o{extension}"
    path.write_text(OWL.format(secret=secret.as_uri()))

    def refuse(*args, **kwargs):
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)

    assert load_ontology([str(path)]).individuals("http://example.org/C") == ("cam1",)


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


def entity(name, value):
    return f'<!ENTITY {name} "{value}">'


NESTED = "\n".join(
    [
        entity("a", "a" * 10),
        *(entity(one, f"&{of};" * 10) for one, of in zip("bcdefgh", "abcdefg")),
    ]
)


@pytest.mark.parametrize(
    ("entities", "label", "reason"),
    [
        (NESTED, "&h;", "the entity 'b' contains others"),
        (entity("a", "&#38;b;"), "&a;", "the entity 'a' contains others"),
        (entity("a", "x" * 100_000), "&a;" * 2000, "expand to 200000000 bytes"),
        ("<!ENTITY % a \"<!ENTITY b 'c'>\"> %a;", "&b;", "'a' is one for declarations"),
    ],
)
def test_entities_that_explode_are_refused_before_they_do(tmp_path, entities, label, reason):
    path = tmp_path / "o.owl"
    path.write_text(RDF.format(entities=entities, label=label))

    with pytest.raises(OntologyFileError, match=reason):
        load_ontology([str(path)])


def test_exploding_entities_hide_in_no_encoding(tmp_path):
    path = tmp_path / "o.owl"
    text = RDF.format(entities=entity("a", "x" * 100_000), label="&a;" * 2000)
    path.write_bytes(text.replace("?>", ' encoding="utf-16"?>', 1).encode("utf-16"))

    with pytest.raises(OntologyFileError, match="UTF-16"):
        load_ontology([str(path)])


def test_entities_are_shorthands_for_namespaces(tmp_path):
    path = tmp_path / "o.owl"
    text = RDF.format(entities=entity("ns", "http://example.org/"), label="cam")
    path.write_text(text.replace('"http://example.org/C"', '"&ns;D"'))

    assert load_ontology([str(path)]).individuals("http://example.org/D") == ("cam",)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("o.ttl", "<u:a> <u:p> " + "[ <u:p> " * 5000 + "]" * 5000, "nests too deeply"),
        ("o.ttl", "@prefix : <http://x> .\n:a nonsense", "is not valid turtle: .*line 2"),
        ("o.owl", "<rdf:RDF", "is not valid xml"),
        ("o.owl", "# mine\nPrefix(:=<urn:a>)\nOntology(<urn:a>)", "is in OWL functional syntax"),
        ("o.owl", "Prefix: : <urn:a>\nOntology: <urn:a>", "is in Manchester syntax"),
        ("o.owl", '<?xml version="1.0"?>\n<Ontology/>', "is in OWL/XML"),
        ("o.owl", "@prefix : <urn:a> .", "is in Turtle, whose ending is .ttl; expected RDF/XML"),
        ("o.ttl", "<rdf:RDF></rdf:RDF>", "is in RDF/XML, whose endings are .owl and .rdf"),
        ("o.nt", "what is this", "is not valid nt"),
        ("o.ttl", "\0", "is not valid turtle"),
        ("o.json", "{}", "expected a file ending in .nt, .owl, .rdf, .ttl"),
        ("o.ttl", None, "cannot be read: No such file"),
    ],
)
def test_a_bad_file_is_named(tmp_path, name, content, reason):
    path = tmp_path / name
    if content is not None:
        path.write_text(content)

    with pytest.raises(OntologyFileError, match=reason) as caught:
        load_ontology([str(path)])
    assert caught.value.file == str(path)
