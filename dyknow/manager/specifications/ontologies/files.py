# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads the files of an ontology: those that are named, and those that they import.

Only local files are read, once each. An import is satisfied by a file that is named and is that
ontology, else by the file that a catalogue names, else by a `file:` URI itself.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections import Counter
from pathlib import Path
from typing import Iterable, Mapping, NamedTuple
from urllib.parse import unquote, urljoin, urlsplit
from xml.parsers import expat

import rdflib
from lxml import etree
from rdflib import OWL, RDF

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.limits import SpecificationLimits

_FORMATS = {".ttl": "turtle", ".owl": "xml", ".rdf": "xml", ".nt": "nt"}
_NAMES = {"turtle": "Turtle", "xml": "RDF/XML", "nt": "N-Triples"}
_XML = r"(<\?xml[^>]*>\s*)?(<!--(?:(?!-->).)*-->\s*)*"
#: How files begin, their format, and its name.
_BEGINNINGS = (
    (r"(Prefix|Ontology)\s*\(", "", "OWL functional syntax, which is not read"),
    (r"(Prefix|Ontology):", "", "Manchester syntax, which is not read"),
    (_XML + r"<Ontology\b", "", "OWL/XML, which is not read"),
    (r"(@prefix|@base|PREFIX|BASE)\s", "turtle", "Turtle, whose ending is .ttl"),
    (_XML + r"<rdf:RDF\b", "xml", "RDF/XML, whose endings are .owl and .rdf"),
)
#: Bytes in which the beginning is searched.
_BEGINNING = 10_000

_REFERENCE = re.compile(rb"&([^;&<>#\s]+);")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff", b"\x00<", b"<\x00")

#: The catalogue that is read where an ontology lies.
_BESIDE = "catalog-v001.xml"
_NAMESPACE = "{urn:oasis:names:tc:entity:xmlns:xml:catalog}"
#: The entries of catalogues that are read, in groups too; each must have these attributes.
_ENTRIES = {
    "uri": ("name", "uri"),
    "rewriteURI": ("uriStartString", "rewritePrefix"),
    "nextCatalog": ("catalog",),
}


class OntologyFile(NamedTuple):
    """A file, parsed."""

    path: str
    data: bytes
    graph: rdflib.Graph


class OntologyFiles:
    """The files of an ontology."""

    def __init__(
        self, paths: Iterable[str], catalogues: Iterable[str], limits: SpecificationLimits
    ) -> None:
        """Read the files, or raise OntologyFileError.

        The catalogues take precedence over those that lie beside the files.
        """
        self._limits = limits
        self._read_catalogues: dict[str, _Catalogue] = {}
        self._catalogues = tuple(catalogues)
        for path in self._catalogues:
            self._catalogue(path)
        self.files: list[OntologyFile] = []  # those that are named, then those that they import
        self._paths: set[str] = set()
        self._known: set[str] = set()
        for path in paths:
            self._read(os.fspath(path))
        imports: list[tuple[str, str]] = []
        for file in self.files:  # it grows meanwhile
            imports += self._follow(file)
        #: Imports that no file satisfies, with the paths of the importing files.
        self.missing = [each for each in imports if _plain(each[0]) not in self._known]
        graphs = [file.graph for file in self.files] or [rdflib.Graph()]
        #: A view of all their statements.
        self.graph: rdflib.Graph = rdflib.graph.ReadOnlyGraphAggregate(graphs)

    def home(self, node: rdflib.term.Node) -> str:
        """Return the path of the first file that states something of a node, else the first."""
        stating = (each.path for each in self.files if (node, None, None) in each.graph)
        return next(stating, self.files[0].path)

    def _follow(self, file: OntologyFile) -> list[tuple[str, str]]:
        """Read the imports of a file; return those for which no file is found."""
        missing = []
        for uri in sorted(str(each) for each in file.graph.objects(None, OWL.imports)):
            if _plain(uri) in self._known:
                continue
            path = self._find(uri, file.path)
            if path is None:
                path = _local_path(uri)
                if path is None or not os.path.exists(path):
                    missing.append((uri, file.path))
                    continue
            self._read(path, f" (imported as <{uri}> by {file.path})")
            self._known.add(_plain(uri))
        return missing

    def _read(self, path: str, why: str = "") -> None:
        real = os.path.realpath(path)
        if real in self._paths:
            return
        if len(self.files) == self._limits.ontology_files:
            raise OntologyFileError(
                path, f"is one file too many{why}; expected at most {self._limits.ontology_files}"
            )
        try:
            file = _parse(path, self._limits)
        except OntologyFileError as error:
            raise OntologyFileError(path, error.reason + why) from error
        self._paths.add(real)
        self.files.append(file)
        for node in file.graph.subjects(RDF.type, OWL.Ontology):
            self._known.add(_plain(str(node)))
            self._known.update(map(_plain, map(str, file.graph.objects(node, OWL.versionIRI))))

    def _find(self, uri: str, importer: str) -> str | None:
        """Return the local file that a catalogue names for an import."""
        beside = Path(importer).absolute().parent / _BESIDE
        waiting = [*self._catalogues, *([str(beside)] if beside.is_file() else [])]
        asked = set()
        while waiting:
            path = waiting.pop(0)
            if path in asked:
                continue
            asked.add(path)
            catalogue = self._catalogue(path)
            found = catalogue.find(uri)
            if found is not None:
                return _local_path(found)
            waiting[:0] = catalogue.following
        return None

    def _catalogue(self, path: str) -> _Catalogue:
        if path not in self._read_catalogues:
            self._read_catalogues[path] = _Catalogue(path, self._limits)
        return self._read_catalogues[path]


class _Catalogue:
    """URIs of ontologies and their places, as an OASIS XML catalogue lists them."""

    def __init__(self, path: str, limits: SpecificationLimits) -> None:
        self.following: list[str] = []  # paths of the catalogues to ask next
        self._path = path
        self._uris: dict[str, str] = {}
        self._prefixes: dict[str, str] = {}
        parser = etree.XMLParser(resolve_entities=False, load_dtd=False, no_network=True)
        data = _read_bytes(path, limits.text_size)
        try:
            root = etree.fromstring(data, parser, base_url=Path(path).absolute().as_uri())
            if root.tag != f"{_NAMESPACE}catalog":
                found = etree.QName(root).localname
                raise self._error(root, f"begins with <{found}>; expected an OASIS <catalog>")
            dtd = root.getroottree().docinfo.internalDTD
            for entity in dtd.iterentities() if dtd is not None else ():
                raise self._error(root, f"declares the entity '{entity.name[:60]}'; expected none")
            for name in _ENTRIES:
                for entry in root.iter(_NAMESPACE + name):
                    self._add(name, entry)
        except (etree.XMLSyntaxError, ValueError) as error:  # of XML, of URIs
            raise OntologyFileError(path, f"is not a valid catalogue: {error}") from error

    def _add(self, name: str, entry: etree._Element) -> None:
        values = [entry.get(each) for each in _ENTRIES[name]]
        if None in values:
            expected = " and ".join(_ENTRIES[name])
            raise self._error(
                entry, f"<{name}> without all of its attributes; expected {expected}"
            )
        target = urljoin(entry.base or "", values[-1])
        if name == "uri":
            self._uris.setdefault(values[0], target)
        elif name == "rewriteURI":
            self._prefixes.setdefault(values[0], target)
        else:
            path = _local_path(target)
            if path is None:
                raise self._error(entry, f"the next catalogue <{target}>; expected a local file")
            self.following.append(os.path.realpath(path))

    def find(self, uri: str) -> str | None:
        """Return the URI where an ontology is; None if it is not listed."""
        if uri in self._uris:
            return self._uris[uri]
        longest = max(filter(uri.startswith, self._prefixes), key=len, default=None)
        return None if longest is None else self._prefixes[longest] + uri[len(longest) :]

    def _error(self, element: etree._Element, reason: str) -> OntologyFileError:
        return OntologyFileError(self._path, f"line {element.sourceline}: {reason}")


def _plain(uri: str) -> str:
    """Return an ontology's URI as it is compared: some write it like a namespace."""
    return uri.rstrip("#")


def _local_path(uri: str) -> str | None:
    """Return the path of a file's URI; None if it is none of this host."""
    try:
        parts = urlsplit(uri)
    except ValueError:
        return None
    path = unquote(parts.path)
    is_local = parts.scheme == "file" and parts.netloc in ("", "localhost")
    return path if is_local and "\0" not in path else None


def _read_bytes(path: str, limit: int) -> bytes:
    try:
        with open(path, "rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise OntologyFileError(path, f"cannot be read: {error.strerror or error}") from error
    if len(data) > limit:
        raise OntologyFileError(path, f"is too large; expected at most {limit} bytes")
    return data


def _parse(path: str, limits: SpecificationLimits) -> OntologyFile:
    kind = _FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise OntologyFileError(path, f"expected a file ending in {', '.join(sorted(_FORMATS))}")
    data = _read_bytes(path, limits.ontology_size)
    _check_format(path, data, kind)
    graph = rdflib.Graph()
    try:
        if kind == "xml":
            _check_xml(data, limits)
        # Given bytes instead of a location, rdflib has nothing to fetch.
        graph.parse(data=data, format=kind, publicID=Path(path).absolute().as_uri())
    except RecursionError as error:
        raise OntologyFileError(
            path, "nests too deeply; expected flatter expressions and shorter lists"
        ) from error
    except Exception as error:  # the exceptions of rdflib's parsers have no common base
        reason = " ".join(str(error).split())
        raise OntologyFileError(path, f"is not valid {kind}: {reason[:300]}") from error
    return OntologyFile(path, data, graph)


def _check_format(path: str, data: bytes, kind: str) -> None:
    """Refuse a file that begins as one in another format than its ending says."""
    lines = (line.strip() for line in data[:_BEGINNING].decode("utf-8", "replace").splitlines())
    text = "\n".join(line for line in lines if line and not line.startswith("#"))
    for beginning, its_kind, name in _BEGINNINGS:
        if its_kind != kind and re.match(beginning, text):
            raise OntologyFileError(path, f"is in {name}; expected {_NAMES[kind]}")


class _Begun(Exception):
    """The first element has begun: entities are only declared before it."""


def _check_xml(data: bytes, limits: SpecificationLimits) -> None:
    """Raise ValueError for XML that would expand, or is no RDF, such as a page that was fetched.

    Entities must not contain entities, nor expand to more than the limit. A text that is not
    well-formed passes: the parser that follows refuses it.
    """
    sizes: dict[bytes, int] = {}
    wrong_root = ""

    def declare(name: str, is_parameter: bool, value: str | None, *_: object) -> None:
        if value is None:  # an external entity, which is not read
            return
        if is_parameter or "&" in value:
            what = "is one for declarations" if is_parameter else "contains others"
            raise ValueError(f"the entity '{name[:60]}' {what}; expected plain text in it")
        sizes.setdefault(name.encode("utf-8"), len(value.encode("utf-8")))

    def begin(name: str, attributes: Mapping[str, str]) -> None:
        nonlocal wrong_root
        if name != f"{RDF} RDF" and not any(each.startswith(f"{RDF} ") for each in attributes):
            is_owl = name == f"{OWL} Ontology"
            tag = name.split(" ")[-1][:60]
            found = "as OWL/XML, which is not read" if is_owl else f"with <{tag}>"
            wrong_root = f"it begins {found}; expected <rdf:RDF>"
        raise _Begun

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.EntityDeclHandler = declare
    parser.StartElementHandler = begin
    with contextlib.suppress(_Begun, expat.ExpatError):
        parser.Parse(data, True)
    if sizes and data[:2] in _UTF_16:
        raise ValueError("entities in UTF-16; expected UTF-8")
    counts = Counter(match.group(1) for match in _REFERENCE.finditer(data)) if sizes else {}
    expanded = sum(count * sizes.get(name, 0) for name, count in counts.items())
    if expanded > limits.expanded_entities:
        raise ValueError(
            f"its entities expand to {expanded} bytes; expected at most {limits.expanded_entities}"
        )
    if wrong_root:
        raise ValueError(wrong_root)
