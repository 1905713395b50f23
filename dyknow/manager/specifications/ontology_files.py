# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads the files of an ontology: those that are named, and those that they import.

Only local files are read, once each. An import is satisfied by a file that is named and is that
ontology, else by the file that a catalogue names, else by a `file:` URI itself.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Dict, Iterable, Iterator, List, NamedTuple, Set, Tuple

import rdflib
from rdflib import OWL, RDF

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.entities import check_entities
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.ontology_catalogue import Catalogues, local_path, read_bytes

FORMATS = {".ttl": "turtle", ".owl": "xml", ".rdf": "xml", ".nt": "nt"}
"""The formats that are read, by the file's extension."""

_NAMES = {"turtle": "Turtle", "xml": "RDF/XML", "nt": "N-Triples"}
_XML = r"(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*"
#: How files begin, their format, and its name.
_BEGINNINGS = (
    (r"(Prefix|Ontology)\s*\(", "", "OWL functional syntax, which is not read"),
    (r"(Prefix|Ontology):", "", "Manchester syntax, which is not read"),
    (_XML + r"<Ontology\b", "", "OWL/XML, which is not read"),
    (r"(@prefix|@base|PREFIX|BASE)\s", "turtle", "Turtle, whose ending is .ttl"),
    (_XML + r"<rdf:RDF\b", "xml", "RDF/XML, whose endings are .owl and .rdf"),
)
#: Bytes that are looked at to find the format.
_BEGINNING = 10_000


class OntologyFile(NamedTuple):
    """A file, parsed."""

    path: str
    data: bytes
    graph: rdflib.Graph


class OntologyFiles:
    """The files of an ontology.

    Attributes:
        files: those that are named, then those that they import.
        missing: imports that no file satisfies, with the paths of the files that ask for them.
    """

    def __init__(
        self, paths: Iterable[str], catalogues: Iterable[str], limits: SpecificationLimits
    ) -> None:
        """Read the files.

        Args:
            paths: the files that are named.
            catalogues: catalogues to ask beside those that lie beside the files.
            limits: the caps on each file, and on their number.

        Raises:
            OntologyFileError: a file cannot be read, or is not of its extension's format.
        """
        self._limits = limits
        self._catalogues = Catalogues(catalogues, limits)
        self._by_path: Dict[str, OntologyFile] = {}
        self._known: Set[str] = set()
        for path in paths:
            self._read(os.fspath(path))
        imports: List[Tuple[str, str]] = []
        for file in self._growing():
            imports += self._follow(file)
        self.files = list(self._by_path.values())
        self.missing = [each for each in imports if _plain(each[0]) not in self._known]

    def _growing(self) -> Iterator[OntologyFile]:
        """Go through the files, those included that are read meanwhile."""
        done = 0
        while done < len(self._by_path):
            files = list(self._by_path.values())[done:]
            done += len(files)
            yield from files

    def _follow(self, file: OntologyFile) -> List[Tuple[str, str]]:
        """Read the files that a file imports; return its imports that none is found for."""
        missing = []
        for uri in sorted(str(each) for each in file.graph.objects(None, OWL.imports)):
            if _plain(uri) in self._known:
                continue
            path = self._catalogues.find(uri, file.path)
            if path is None:
                path = local_path(uri)
                if path is None or not os.path.exists(path):
                    missing.append((uri, file.path))
                    continue
            self._read(path, f" (imported as <{uri}> by {file.path})")
            self._known.add(_plain(uri))
        return missing

    def _read(self, path: str, why: str = "") -> None:
        real = os.path.realpath(path)
        if real in self._by_path:
            return
        if len(self._by_path) == self._limits.ontology_files:
            raise OntologyFileError(
                path, f"is one file too many{why}; expected at most {self._limits.ontology_files}"
            )
        try:
            file = _parse(path, self._limits)
        except OntologyFileError as error:
            raise OntologyFileError(path, error.reason + why) from error
        self._by_path[real] = file
        for node in file.graph.subjects(RDF.type, OWL.Ontology):
            self._known.add(_plain(str(node)))
            self._known.update(map(_plain, map(str, file.graph.objects(node, OWL.versionIRI))))


def _plain(uri: str) -> str:
    """Return an ontology's URI as it is compared: some write it like a namespace."""
    return uri.rstrip("#")


def _check_format(path: str, data: bytes, kind: str) -> None:
    """Refuse a file that begins as one in another format than its ending says.

    Raises:
        OntologyFileError: it does.
    """
    lines = (line.strip() for line in data[:_BEGINNING].decode("utf-8", "replace").splitlines())
    text = "\n".join(line for line in lines if line and not line.startswith("#"))
    for beginning, its_kind, name in _BEGINNINGS:
        if its_kind != kind and re.match(beginning, text):
            raise OntologyFileError(path, f"is in {name}; expected {_NAMES[kind]}")


def _parse(path: str, limits: SpecificationLimits) -> OntologyFile:
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise OntologyFileError(path, f"expected a file ending in {', '.join(sorted(FORMATS))}")
    data = read_bytes(path, limits.ontology_size)
    _check_format(path, data, kind)
    graph = rdflib.Graph()
    try:
        if kind == "xml":
            check_entities(data, limits)
        # Given bytes instead of a location, rdflib has nothing to fetch.
        graph.parse(data=data, format=kind, publicID=Path(path).absolute().as_uri())
    except RecursionError as error:
        raise OntologyFileError(path, "nests too deeply; expected flatter expressions") from error
    except Exception as error:  # the exceptions of rdflib's parsers have no common base
        reason = " ".join(str(error).split())
        raise OntologyFileError(path, f"is not valid {kind}: {reason[:300]}") from error
    return OntologyFile(path, data, graph)
