# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Imports of ontologies: catalogues, files, circles, and their errors."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any, Dict, List

import pytest
from clocks import patch_here
from unit.manager.test_ontology import BASE, FIRST_LINE, PREFIXES

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.ontologies.ontology import Ontology

CATALOGUE = "catalog-v001.xml"
NAMESPACE = 'xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog"'


@pytest.fixture(autouse=True)
def _no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a socket was opened")

    for name in ("socket", "create_connection", "getaddrinfo"):
        patch_here(monkeypatch, socket, name, refuse)


def ontology(name: str, *imports: str, text: str = "") -> str:
    """An ontology that imports other ontologies, with a class of its own name."""
    told = "".join(f"<http://o.org/{name}> owl:imports <{each}> .\n" for each in imports)
    return (
        f"{PREFIXES}<http://o.org/{name}> a owl:Ontology .\n{told}"
        f':{name} a owl:Class ; rdfs:label "{name}" .\n{text}'
    )


def catalogue(*entries: str) -> str:
    return (
        f'<?xml version="1.0"?>\n<catalog prefer="public" {NAMESPACE}>{"".join(entries)}</catalog>'
    )


def uri(name: str, place: str) -> str:
    return f'\n<uri id="User Entered Import Resolution" name="{name}" uri="{place}"/>'


def load(folder: Path, files: Dict[str, str], *named: str, **options: Any) -> Ontology:
    """Write files, and read those that are named."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return Ontology([str(folder / each) for each in named or ("main.ttl",)], **options)


def classes(found: Ontology, *names: str) -> List[str]:
    """Those of the names that the ontology knows."""
    return [name for name in names if found.canonical(name) == BASE + name]


#: As Protégé writes it.
PROTEGE = f"""<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<catalog prefer="public" {NAMESPACE}>
    <uri id="User Entered Import Resolution" name="http://o.org/a" uri="parts/a.ttl"/>
    <group id="Folder Repository, directory=, recursive=true, Auto-Update=true, version=2" \
prefer="public" xml:base="">
        <uri id="Automatically generated entry" name="http://o.org/b" uri="b%20b.ttl"/>
    </group>
    <group prefer="public" xml:base="parts/">
        <uri name="http://o.org/c" uri="c.ttl"/>
        <rewriteURI uriStartString="package://robot/" rewritePrefix="robot/owl/"/>
        <rewriteURI uriStartString="package://robot/old/" rewritePrefix="older/"/>
    </group>
</catalog>
"""


def test_the_catalogue_beside_the_file_is_asked(tmp_path: Path) -> None:
    imports = [f"http://o.org/{each}" for each in "abc"]
    found = load(
        tmp_path,
        {
            CATALOGUE: PROTEGE,
            "main.ttl": ontology(
                "main", *imports, "package://robot/d.ttl", "package://robot/old/e.ttl"
            ),
            "parts/a.ttl": ontology("a", text=":a rdfs:subClassOf :b ."),
            "b b.ttl": ontology("b", text=":b rdfs:subClassOf :d ."),
            "parts/c.ttl": ontology("c", text=":x a :a ; rdfs:label 'x' ."),
            "parts/robot/owl/d.ttl": ontology("d"),
            "parts/older/e.ttl": ontology("e"),
        },
    )

    assert found.individuals(BASE + "d") == ("x",)
    assert classes(found, "e") == ["e"], "the longest prefix counts"
    assert found.warnings == ()


def test_catalogues_that_are_named_are_asked_first(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        {
            CATALOGUE: catalogue(uri("http://o.org/a", "wrong.ttl")),
            "main.ttl": ontology("main", "http://o.org/a", "http://o.org/b"),
            "here/one.xml": catalogue('<nextCatalog catalog="two.xml"/>'),
            "here/two.xml": catalogue(
                '<nextCatalog catalog="one.xml"/>', uri("http://o.org/a", "../a.ttl")
            ),
            "here/three.xml": catalogue(uri("http://o.org/b", (tmp_path / "b.ttl").as_uri())),
            "a.ttl": ontology("a"),
            "b.ttl": ontology("b"),
        },
        catalogues=[str(tmp_path / "here" / each) for each in ("one.xml", "three.xml")],
    )

    assert classes(found, "main", "a", "b") == ["main", "a", "b"]


def test_a_file_that_is_named_is_what_others_import(tmp_path: Path) -> None:
    version = "<http://o.org/b> owl:versionIRI <http://o.org/b/2> ."
    found = load(
        tmp_path,
        {
            CATALOGUE: catalogue(uri("http://o.org/a", "wrong.ttl")),
            "main.ttl": ontology("main", "http://o.org/a#", "http://o.org/b/2"),
            "a.ttl": ontology("a"),
            "b.ttl": ontology("b", text=version),
        },
        *("main.ttl", "a.ttl", "b.ttl"),
    )

    assert found.warnings == ()


def test_a_relative_import_and_one_by_path_need_no_catalogue(tmp_path: Path) -> None:
    other = tmp_path / "b.ttl"
    found = load(
        tmp_path,
        {
            "main.ttl": ontology("main", "a.ttl", other.as_uri()),
            "a.ttl": ontology("a"),
            "b.ttl": ontology("b"),
        },
    )

    assert classes(found, "a", "b") == ["a", "b"]
    assert found.warnings == ()


def test_circles_of_imports_are_read_once(tmp_path: Path) -> None:
    entries = [uri(f"http://o.org/{each}", f"{each}.ttl") for each in ("main", "a", "b")]
    found = load(
        tmp_path,
        {
            CATALOGUE: catalogue(*entries, uri("http://o.org/alias", "./a.ttl")),
            "main.ttl": ontology("main", "http://o.org/main", "http://o.org/a"),
            "a.ttl": ontology("a", "http://o.org/b", text=":a rdfs:subClassOf [] ."),
            "b.ttl": ontology("b", "http://o.org/main", "http://o.org/alias"),
        },
    )

    assert [each.message for each in found.warnings] == [
        f"a class expression in the description of <{BASE}a> is not read"
    ]


def test_an_import_that_is_nowhere_is_told(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        {
            CATALOGUE: catalogue(
                uri("http://o.org/b", "https://o.org/b.owl"),
                uri("http://o.org/d", "file://elsewhere/d.ttl"),
                uri("http://o.org/e", "file:///e%00.ttl"),
            ),
            "main.ttl": ontology("main", *[f"http://o.org/{each}" for each in "abcde"], "no.ttl"),
        },
    )

    nowhere = [f"http://o.org/{each}" for each in "abcde"] + [(tmp_path / "no.ttl").as_uri()]
    assert [(each.line, each.message) for each in found.warnings] == [
        (
            line,
            f"owl:imports of <{each}> is not followed: no file that was named is this ontology, "
            "and no catalogue names a local file for it",
        )
        for line, each in enumerate(nowhere, FIRST_LINE + 1)
    ]


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("gone.ttl", "cannot be read: No such file"),
        ("broken.ttl", "is not valid turtle"),
        ("o.omn", "expected a file ending in .nt, .owl, .rdf, .ttl"),
        ("", "cannot be read: Is a directory|expected a file ending in"),
    ],
)
def test_an_import_that_cannot_be_read_is_named_with_its_importer(
    tmp_path: Path, place: str, reason: str
) -> None:
    files = {
        CATALOGUE: catalogue(uri("http://o.org/a", place)),
        "main.ttl": ontology("main", "http://o.org/a"),
        "broken.ttl": "nonsense",
        "o.omn": "Ontology: <http://o.org/a>",
    }
    with pytest.raises(OntologyFileError, match=reason) as caught:
        load(tmp_path, files)
    assert str(caught.value).endswith(f"(imported as <http://o.org/a> by {tmp_path}/main.ttl)")


def test_there_are_not_more_files_than_the_limit(tmp_path: Path) -> None:
    entries = [uri(f"http://o.org/{n}", f"{n}.ttl") for n in range(5)]
    files = {f"{n}.ttl": ontology(str(n), f"http://o.org/{n + 1}") for n in range(5)}
    files[CATALOGUE] = catalogue(*entries)

    assert len(load(tmp_path, files, "0.ttl").warnings) == 1
    with pytest.raises(OntologyFileError, match=r"/3\.ttl: is one file too many .* at most 3"):
        load(tmp_path, files, "0.ttl", limits=SpecificationLimits(ontology_files=3))


NESTED_ENTITIES = '<!DOCTYPE catalog [<!ENTITY a "x"><!ENTITY b "&a;&a;">]>'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not a valid catalogue: "),
        ("nonsense", "is not a valid catalogue: Start tag expected"),
        (f"<catalog {NAMESPACE}>", "is not a valid catalogue: "),
        ("<html/>", "line 1: begins with <html>; expected an OASIS <catalog>"),
        ("<catalog/>", "line 1: begins with <catalog>; expected an OASIS <catalog>"),
        (catalogue('\n<uri name="x"/>'), "line 3: <uri> without all of its attributes; expected"),
        (catalogue('<nextCatalog catalog="http://x.org/"/>'), "<http://x.org/>; expected a local"),
        (catalogue('<nextCatalog catalog="gone.xml"/>'), "gone.xml: cannot be read: No such file"),
        (catalogue(uri("http://o.org/b", "http://[::1/")), "is not a valid catalogue: .*IPv6"),
        (
            catalogue("<group>" * 300 + "</group>" * 300),
            "is not a valid catalogue: Excessive depth",
        ),
        (
            catalogue(f'<group xml:base="http://[x">{uri("http://o.org/b", "b.ttl")}</group>'),
            "is not a valid catalogue: .*IPv6",
        ),
        (NESTED_ENTITIES + f"<catalog {NAMESPACE}/>", "declares the entity 'a'; expected none"),
        ('<?xml version="1.0" encoding="nonsense"?><catalog/>', "is not a valid catalogue"),
    ],
)
def test_a_bad_catalogue_is_named(tmp_path: Path, text: str, reason: str) -> None:
    files = {CATALOGUE: text, "main.ttl": ontology("main", "http://o.org/a")}

    with pytest.raises(OntologyFileError, match=reason) as caught:
        load(tmp_path, files)
    assert caught.value.file.endswith(".xml")


def test_an_old_catalogue_has_a_document_type(tmp_path: Path) -> None:
    kind = (
        '<!DOCTYPE catalog PUBLIC "-//OASIS//DTD Entity" "http://www.oasis-open.org/catalog.dtd">'
    )
    text = kind + f"<catalog {NAMESPACE}>{uri('http://o.org/a', 'a.ttl')}</catalog>"
    main = ontology("main", "http://o.org/a")
    found = load(tmp_path, {CATALOGUE: text, "main.ttl": main, "a.ttl": ontology("a")})

    assert classes(found, "a", "b") == ["a"]


def test_a_catalogue_that_is_too_large_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(catalogue())

    with pytest.raises(OntologyFileError, match=r"c\.xml: is too large; expected at most 9 bytes"):
        Ontology([], catalogues=[str(tmp_path / "c.xml")], limits=SpecificationLimits(text_size=9))
