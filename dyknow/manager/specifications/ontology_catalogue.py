# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Catalogues: where the ontologies that others import are, as OASIS XML catalogues say it.

Editors of ontologies keep one named catalog-v001.xml beside the files. Read are `uri` and
`rewriteURI`, in groups too, with `xml:base`, and `nextCatalog`; other entries say nothing about
imports.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Dict, Iterable, List, Optional, Tuple
from urllib.parse import unquote, urljoin, urlsplit
from xml.parsers import expat

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.limits import SpecificationLimits

BESIDE = "catalog-v001.xml"
"""The catalogue that is read where an ontology lies."""

_NAMESPACE = "urn:oasis:names:tc:entity:xmlns:xml:catalog "
_BASE = "http://www.w3.org/XML/1998/namespace base"
#: The attributes that an entry must have.
_ENTRIES = {
    "uri": ("name", "uri"),
    "rewriteURI": ("uriStartString", "rewritePrefix"),
    "nextCatalog": ("catalog",),
}


class Catalogue:
    """URIs of ontologies, and where they are.

    Attributes:
        following: files of the catalogues to ask next.
    """

    def __init__(self, path: str, limits: SpecificationLimits) -> None:
        """Read a catalogue.

        Raises:
            OntologyFileError: it cannot be read, or is no catalogue.
        """
        self.following: List[str] = []
        self._path = path
        self._nesting = limits.nesting
        self._uris: Dict[str, str] = {}
        self._prefixes: List[Tuple[str, str]] = []
        self._bases = [Path(path).absolute().as_uri()]
        self._parser = expat.ParserCreate(namespace_separator=" ")
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.EntityDeclHandler = self._refuse_entity
        try:
            self._parser.Parse(read_bytes(path, limits.text_size), True)
        except (expat.ExpatError, LookupError, ValueError) as error:  # of encodings, of URIs
            raise OntologyFileError(path, f"is not a valid catalogue: {error}") from error

    def find(self, uri: str) -> Optional[str]:
        """Return the URI where an ontology is; None if it is not listed."""
        if uri in self._uris:
            return self._uris[uri]
        fitting = [each for each in self._prefixes if uri.startswith(each[0])]
        if not fitting:
            return None
        start, prefix = max(fitting, key=lambda each: len(each[0]))
        return prefix + uri[len(start) :]

    def _start(self, tag: str, attributes: Dict[str, str]) -> None:
        if len(self._bases) > self._nesting:
            raise self._error(f"elements nest deeper than {self._nesting}")
        base = urljoin(self._bases[-1], attributes.get(_BASE, ""))
        if len(self._bases) == 1 and tag != f"{_NAMESPACE}catalog":
            raise self._error(
                f"begins with <{tag.rpartition(' ')[2]}>; expected an OASIS <catalog>"
            )
        self._bases.append(base)
        name = tag[len(_NAMESPACE) :] if tag.startswith(_NAMESPACE) else ""
        if name not in _ENTRIES:
            return
        values = [attributes.get(each) for each in _ENTRIES[name]]
        if None in values:
            expected = " and ".join(_ENTRIES[name])
            raise self._error(f"<{name}> without all of its attributes; expected {expected}")
        *names, target = [str(value) for value in values]
        target = urljoin(base, target)
        if name == "uri":
            self._uris.setdefault(names[0], target)
        elif name == "rewriteURI":
            self._prefixes.append((names[0], target))
        else:
            path = local_path(target)
            if path is None:
                raise self._error(f"the next catalogue <{target}>; expected a local file")
            self.following.append(os.path.realpath(path))

    def _end(self, _: str) -> None:
        self._bases.pop()

    def _refuse_entity(self, name: str, *_: object) -> None:
        raise self._error(f"declares the entity '{name[:60]}'; expected none")

    def _error(self, reason: str) -> OntologyFileError:
        return OntologyFileError(self._path, f"line {self._parser.CurrentLineNumber}: {reason}")


class Catalogues:
    """Every catalogue that is asked, each read once."""

    def __init__(self, paths: Iterable[str], limits: SpecificationLimits) -> None:
        """Take the catalogues that are asked about all imports, in this order.

        Raises:
            OntologyFileError: one cannot be read.
        """
        self._limits = limits
        self._read: Dict[str, Catalogue] = {}
        self._paths = tuple(paths)
        for path in self._paths:
            self._get(path)

    def find(self, uri: str, importer: str) -> Optional[str]:
        """Return the local file of an ontology; None if no catalogue names one.

        Args:
            uri: what is imported.
            importer: the file that imports it; the catalogue beside it is asked too.

        Raises:
            OntologyFileError: a catalogue cannot be read.
        """
        beside = Path(importer).absolute().parent / BESIDE
        waiting = [*self._paths, *([str(beside)] if beside.is_file() else [])]
        asked = set()
        while waiting:
            path = waiting.pop(0)
            if path in asked:
                continue
            asked.add(path)
            catalogue = self._get(path)
            found = catalogue.find(uri)
            if found is not None:
                return local_path(found)
            waiting[:0] = catalogue.following
        return None

    def _get(self, path: str) -> Catalogue:
        if path not in self._read:
            self._read[path] = Catalogue(path, self._limits)
        return self._read[path]


def local_path(uri: str) -> Optional[str]:
    """Return the path of a file's URI; None if it is none of this host."""
    try:
        parts = urlsplit(uri)
    except ValueError:
        return None
    path = unquote(parts.path)
    is_local = parts.scheme == "file" and parts.netloc in ("", "localhost")
    return path if is_local and "\0" not in path else None


def read_bytes(path: str, limit: int) -> bytes:
    """Read a file.

    Raises:
        OntologyFileError: it cannot be read, or is larger than the limit.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise OntologyFileError(path, f"cannot be read: {error.strerror or error}") from error
    if len(data) > limit:
        raise OntologyFileError(path, f"is too large; expected at most {limit} bytes")
    return data
