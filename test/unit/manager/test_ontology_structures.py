# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ontologies built as those in use are: sensors, robot parts, household robots, pizzas."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow.manager.specifications.ontology import load_ontology

PREFIXES = """\
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix skos: <http://www.w3.org/2004/02/skos/core#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
"""


def catalogue(**places: str) -> str:
    entries = "".join(f'<uri name="http://t.org/{name}" uri="{places[name]}"/>' for name in places)
    return f'<catalog xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">{entries}</catalog>'


# A small core and modules that import it: hash and slash namespaces, labels in several languages,
# restrictions with blank classes everywhere, an alignment with classes of the same names

CORE = """
@prefix c: <http://t.org/core/> .
<http://t.org/core> a owl:Ontology ; owl:versionIRI <http://t.org/core/1.0> .
c:Sensor a owl:Class, rdfs:Class ; rdfs:label "Sensor"@en, "Sensore"@it ;
  skos:definition "A device that observes."@en .
c:Observation a owl:Class ; rdfs:label "Observation"@en, "Osservazione"@it .
c:Platform a owl:Class ; rdfs:label "Platform"@en .
c:FeatureOfInterest a owl:Class ; rdfs:label "Feature Of Interest"@en .
c:hosts a owl:ObjectProperty ; rdfs:label "hosts"@en ;
  rdfs:domain [ a owl:Class ; owl:unionOf ( c:Platform c:Sensor ) ] .
"""
SYSTEMS = """
@prefix c: <http://t.org/core/> .
@prefix s: <http://t.org/systems/> .
<http://t.org/systems> a owl:Ontology ; owl:imports <http://t.org/core/1.0> .
s:System a owl:Class ; rdfs:label "System"@en .
c:Sensor rdfs:subClassOf s:System ,
  [ a owl:Restriction ; owl:onProperty s:detects ; owl:allValuesFrom s:Stimulus ] ,
  [ a owl:Restriction ; owl:onProperty c:made ; owl:someValuesFrom
    [ a owl:Class ; owl:unionOf ( c:Observation s:Stimulus ) ] ] .
s:Stimulus a owl:Class ; rdfs:label "Stimulus"@en .
"""
ALIGNMENT = """
@prefix c: <http://t.org/core/> .
@prefix old: <http://t.org/old#> .
@prefix : <http://t.org/lab#> .
<http://t.org/lab> a owl:Ontology ; owl:imports <http://t.org/systems> .
old:Sensor a owl:Class ; rdfs:label "Sensor" ; owl:equivalentClass c:Sensor .
:Camera rdfs:subClassOf old:Sensor ; rdfs:label "Camera"@en .
:front a :Camera, owl:NamedIndividual ; rdfs:label "front camera"@en, "camera frontale"@it .
"""


@pytest.fixture
def folder(tmp_path: Path):
    def write(**files: str) -> Path:
        for name, text in files.items():
            is_turtle = not text.lstrip().startswith("<?xml") and not text.startswith("<catalog")
            ending = "ttl" if is_turtle else "owl"
            path = tmp_path / (f"{name}.{ending}" if name != "catalogue" else "catalog-v001.xml")
            path.write_text((PREFIXES if is_turtle else "") + text, encoding="utf-8")
        return tmp_path

    return write


def test_a_vocabulary_of_sensors_in_modules(folder) -> None:
    files = folder(
        core=CORE,
        systems=SYSTEMS,
        lab=ALIGNMENT,
        catalogue=catalogue(systems="systems.ttl", **{"core/1.0": "core.ttl"}),
    )
    found = load_ontology([str(files / "lab.ttl")])

    assert found.individuals("http://t.org/core/Sensor") == ("front camera",)
    assert found.is_subsumed("front camera", "System")
    assert found.is_subsumed("camera frontale", "Sensore")
    assert not found.is_subsumed("Sensor", "Stimulus")
    assert found.canonical("camera frontale") == "http://t.org/lab#front"
    assert [each.message for each in found.warnings] == [
        "owl:allValuesFrom in the description of <http://t.org/core/Sensor> is not read",
        "owl:someValuesFrom in the description of <http://t.org/core/Sensor> is read in part",
    ]
    italian = load_ontology([str(files / "lab.ttl")], language="it")
    assert italian.individuals("http://t.org/old#Sensor") == ("camera frontale",)


# Robot parts: local names alone, individuals of the upper ontology, definitions by intersection

PARTS = """<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [
  <!ENTITY owl "http://www.w3.org/2002/07/owl#">
  <!ENTITY p "http://t.org/parts.owl#">
]>
<rdf:RDF xmlns="http://t.org/parts.owl#" xml:base="http://t.org/parts.owl"
  xmlns:owl="http://www.w3.org/2002/07/owl#" xmlns:xsd="http://www.w3.org/2001/XMLSchema#"
  xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
  xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#">
<owl:Ontology rdf:about="http://t.org/parts.owl"/>
<owl:Class rdf:about="&p;Device"/>
<owl:Class rdf:about="&p;Agent"/>
<owl:Class rdf:about="&p;RobotPart">
  <owl:equivalentClass>
    <owl:Class>
      <owl:unionOf rdf:parseType="Collection">
        <rdf:Description rdf:about="&p;RobotSensingPart"/>
        <rdf:Description rdf:about="&p;RobotActuatingPart"/>
      </owl:unionOf>
    </owl:Class>
  </owl:equivalentClass>
  <rdfs:subClassOf rdf:resource="&p;Device"/>
</owl:Class>
<owl:Class rdf:about="&p;Robot">
  <owl:equivalentClass>
    <owl:Class>
      <owl:intersectionOf rdf:parseType="Collection">
        <rdf:Description rdf:about="&p;Device"/>
        <rdf:Description rdf:about="&p;Agent"/>
      </owl:intersectionOf>
    </owl:Class>
  </owl:equivalentClass>
  <rdfs:subClassOf>
    <owl:Restriction>
      <owl:onProperty rdf:resource="&p;hasPart"/>
      <owl:someValuesFrom rdf:resource="&p;RobotPart"/>
    </owl:Restriction>
  </rdfs:subClassOf>
</owl:Class>
<owl:Class rdf:about="&p;RobotSensingPart"/>
<owl:Class rdf:about="&p;RobotActuatingPart"/>
<owl:NamedIndividual rdf:about="&p;nao"><rdf:type rdf:resource="&p;Device"/>
  <rdf:type rdf:resource="&p;Agent"/></owl:NamedIndividual>
<owl:NamedIndividual rdf:about="&p;arm">
  <rdf:type rdf:resource="&p;RobotActuatingPart"/></owl:NamedIndividual>
</rdf:RDF>
"""


def test_a_vocabulary_of_robot_parts(folder) -> None:
    found = load_ontology([str(folder(parts=PARTS) / "parts.owl")])

    assert found.individuals("http://t.org/parts.owl#Robot") == ("nao",)
    assert found.individuals("http://t.org/parts.owl#RobotPart") == ("arm",)
    assert found.individuals("http://t.org/parts.owl#Device") == ("arm", "nao")
    assert found.is_subsumed("nao", "Robot")
    assert not found.is_subsumed("arm", "Robot")
    assert [each.message for each in found.warnings] == [
        "no label, so that the last part of the URI is the name: "
        + ", ".join(
            f"<http://t.org/parts.owl#{each}>"
            for each in ("Agent", "Device", "Robot", "RobotActuatingPart", "RobotPart")
        )
        + " and 3 more",
        "owl:someValuesFrom in the description of <http://t.org/parts.owl#Robot> is read in part",
    ]


# A household robot: imports by package, individuals of a map with restrictions as types


# Pizzas: definitions by restrictions, values in a partition, labels in two languages

PIZZAS = """
@prefix : <http://t.org/pizza#> .
<http://t.org/pizza> a owl:Ontology .
:Pizza a owl:Class ; rdfs:label "Pizza"@en ; skos:prefLabel "Pizza"@en ;
  owl:disjointWith :Topping .
:Topping a owl:Class ; rdfs:label "Topping"@en, "Cobertura"@pt .
:Cheese rdfs:subClassOf :Topping ; rdfs:label "Cheese"@en, "Queijo"@pt .
:Spiciness rdfs:label "Spiciness"@en ; owl:disjointUnionOf ( :Hot :Mild ) .
:Hot a owl:Class ; rdfs:label "Hot"@en . :Mild a owl:Class ; rdfs:label "Mild"@en .
:CheesyPizza rdfs:label "Cheesy pizza"@en ; owl:equivalentClass [ a owl:Class ;
  owl:intersectionOf ( :Pizza
    [ a owl:Restriction ; owl:onProperty :hasTopping ; owl:someValuesFrom :Cheese ] ) ] .
:Margherita rdfs:label "Margherita"@en ; rdfs:subClassOf :NamedPizza ,
  [ a owl:Restriction ; owl:onProperty :hasTopping ; owl:someValuesFrom :Cheese ] .
:NamedPizza rdfs:label "Named pizza"@en ; rdfs:subClassOf :Pizza .
:Vegetarian rdfs:label "Vegetarian"@en ; owl:equivalentClass [ a owl:Class ;
  owl:intersectionOf ( :Pizza [ a owl:Class ; owl:complementOf :Meaty ] ) ] .
:Meaty a owl:Class ; rdfs:label "Meaty"@en ; rdfs:subClassOf :Pizza .
:Country rdfs:label "Country"@en ; owl:equivalentClass [ a owl:Class ;
  owl:intersectionOf ( :Domain [ a owl:Class ; owl:oneOf ( :Italy :Germany ) ] ) ] .
:Domain a owl:Class ; rdfs:label "Domain"@en .
:Italy a :Country . :Germany a :Domain .
[ a owl:AllDifferent ; owl:distinctMembers ( :Italy :Germany ) ] .
"""


SUBSUMED = [
    ("Cheesy pizza", "Pizza"),
    ("Margherita", "Cheesy pizza"),
    ("Margherita", "Pizza"),
    ("Vegetarian", "Pizza"),
    ("Queijo", "Cobertura"),
    ("Hot", "Spiciness"),
    ("Italy", "Domain"),
    ("Germany", "Country"),
]
NOT_SUBSUMED = [("Pizza", "Cheesy pizza"), ("Meaty", "Vegetarian"), ("Spiciness", "Hot")]


def test_pizzas(folder) -> None:
    found = load_ontology([str(folder(pizza=PIZZAS) / "pizza.ttl")])

    assert [pair for pair in SUBSUMED + NOT_SUBSUMED if found.is_subsumed(*pair)] == SUBSUMED
    assert found.individuals("http://t.org/pizza#Country") == ("Germany", "Italy")
    told = "owl:{} in the description of <http://t.org/pizza#{}> is {}"
    assert sorted(each.message for each in found.warnings) == [
        "no label, so that the last part of the URI is the name: <http://t.org/pizza#Germany>, "
        "<http://t.org/pizza#Italy>",
        told.format("complementOf", "Vegetarian", "not read"),
        told.format("someValuesFrom", "CheesyPizza", "read in part"),
        told.format("someValuesFrom", "Margherita", "read in part"),
    ]
