# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ontologies: the individuals of classes, and the subclass relation.

The files are read once, with rdflib, into plain dictionaries. Only local files are read:
`owl:imports` is not followed, so imported files must be named too. Named classes are read, with
their named sub- and superclasses; `warnings` lists the statements that are not.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Dict, FrozenSet, Iterable, List, Sequence, Set, Tuple

import rdflib
from rdflib import OWL, RDF, RDFS

from dyknow.errors import IndividualsError, OntologyFileError, Problem, UnknownConcept
from dyknow.manager.specifications.entities import check_entities
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.manager.specifications.ontology_remarks import language_order, local_name, remarks_on

FORMATS = {".ttl": "turtle", ".owl": "xml", ".rdf": "xml", ".nt": "nt"}
"""The formats that are read, by the file's extension."""

_BUILT_IN = (
    "http://www.w3.org/2002/07/owl#",
    "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "http://www.w3.org/2000/01/rdf-schema#",
)
_Edges = Dict[str, Set[str]]


class Ontology:
    """The classes and individuals of a set of files.

    Classes and individuals are named by their URI or by their `rdfs:label`; those without a
    label also by the last part of their URI. Thus the functor and the arguments of a tag such as
    `BallObject(nao1)` are names.

    Attributes:
        warnings: The statements of the files that are not read.
    """

    def __init__(self, graph: rdflib.Graph, warnings: Sequence[Problem] = ()) -> None:
        self.warnings: Tuple[Problem, ...] = tuple(warnings)
        self._labels: Dict[str, Set[str]] = {}
        self._by_language: Dict[str, Dict[str, Set[str]]] = {}
        self._blank: Set[str] = set()
        self._superclasses: _Edges = {}
        self._subclasses: _Edges = {}
        self._types: _Edges = {}
        self._instances: _Edges = {}
        self._read(graph)
        self._by_name: _Edges = {}
        self._name_all()
        self._above: Dict[str, FrozenSet[str]] = {}

    def individuals(self, concept: str) -> Tuple[str, ...]:
        """Return the labels of the individuals of a class and of its subclasses.

        An individual without a label is named by the last part of its URI. Of labels in several
        languages the one without a language counts, else the English one, else the first by the
        code of its language.

        Args:
            concept: The URI of the class.

        Returns:
            The labels, sorted; empty if there is no individual.

        Raises:
            UnknownConcept: No class has this URI.
            IndividualsError: An individual has several labels in one language, or shares its
                label with another one. It names all such individuals.
        """
        reasons: List[str] = []
        owners: Dict[str, str] = {}
        for individual in self._of(concept):
            labels = self._terms(individual)
            if len(labels) != 1:
                listed = ", ".join(f"'{label}'" for label in labels) or "none"
                reasons.append(f"<{individual}> has the labels {listed}; expected exactly one")
            elif labels[0] in owners:
                other = owners[labels[0]]
                reasons.append(f"<{other}> and <{individual}> share the label '{labels[0]}'")
            else:
                owners[labels[0]] = individual
        if reasons:
            raise IndividualsError(concept, reasons)
        return tuple(sorted(owners))

    def unlabelled(self, concept: str) -> Tuple[str, ...]:
        """Return the URIs of the individuals of a class that have no label.

        Raises:
            UnknownConcept: No class has this URI.
        """
        return tuple(each for each in self._of(concept) if not self._by_language.get(each))

    def is_subsumed(self, supplied: str, demanded: str) -> bool:
        """Whether a supplied functor or argument satisfies a demanded one.

        Args:
            supplied: A label or URI, or a word that the ontology does not know.
            demanded: The same.

        Returns:
            True if both are the same word, or `supplied` names a subclass or an instance of
            what `demanded` names.
        """
        return supplied == demanded or demanded in self.names_above(supplied)

    def names_above(self, name: str) -> FrozenSet[str]:
        """Return every name that subsumes a name, for an index of supplied tags.

        Args:
            name: A label or URI, or a word that the ontology does not know.

        Returns:
            The name itself, its synonyms, and the names of the classes above it.
        """
        known = self._above.get(name)
        if known is None:
            starts = self._by_name.get(name, set())
            classes = set(starts)
            for start in starts:
                classes |= self._types.get(start, set())
            names = {name}
            for uri in _reachable(classes, self._superclasses):
                names |= self._names(uri)
            known = self._above[name] = frozenset(names)
        return known

    def canonical(self, name: str) -> str:
        """Return the URI of what a name means; the name itself if that is nothing, or several."""
        meant = self._by_name.get(name, ())
        return next(iter(meant)) if len(meant) == 1 else name

    def _of(self, concept: str) -> List[str]:
        if concept not in self._superclasses:
            raise UnknownConcept(concept)
        found: Set[str] = set()
        for kind in _reachable([concept], self._subclasses):
            found |= self._instances.get(kind, set())
        return sorted(found)

    def _terms(self, individual: str) -> List[str]:
        """The labels in the preferred language, of which there should be one."""
        by_language = self._by_language.get(individual)
        if by_language:
            return sorted(by_language[min(by_language, key=language_order)])
        return [] if individual in self._blank else [local_name(individual)]

    def _read(self, graph: rdflib.Graph) -> None:
        for kind in (OWL.Class, RDFS.Class):
            for node in graph.subjects(RDF.type, kind):
                if isinstance(node, rdflib.URIRef):
                    self._add_class(str(node))
        for lower, upper in graph.subject_objects(RDFS.subClassOf):
            self._add_subclass(lower, upper)
        for one, other in graph.subject_objects(OWL.equivalentClass):
            self._add_subclass(one, other)
            self._add_subclass(other, one)
        for node, kind in graph.subject_objects(RDF.type):
            if isinstance(kind, rdflib.URIRef) and not str(kind).startswith(_BUILT_IN):
                self._add_class(str(kind))
                self._types.setdefault(str(node), set()).add(str(kind))
                self._instances.setdefault(str(kind), set()).add(str(node))
                if isinstance(node, rdflib.BNode):
                    self._blank.add(str(node))
        for node, label in graph.subject_objects(RDFS.label):
            text = str(label).strip()
            if text:
                self._labels.setdefault(str(node), set()).add(text)
                languages = self._by_language.setdefault(str(node), {})
                languages.setdefault(getattr(label, "language", None) or "", set()).add(text)

    def _add_class(self, uri: str) -> None:
        self._superclasses.setdefault(uri, set())
        self._subclasses.setdefault(uri, set())

    def _add_subclass(self, lower: rdflib.term.Node, upper: rdflib.term.Node) -> None:
        # Restrictions and other class expressions are blank nodes; they have no name to match.
        if isinstance(lower, rdflib.URIRef) and isinstance(upper, rdflib.URIRef):
            self._add_class(str(lower))
            self._add_class(str(upper))
            self._superclasses[str(lower)].add(str(upper))
            self._subclasses[str(upper)].add(str(lower))

    def _names(self, uri: str) -> Set[str]:
        names = {uri} | self._labels.get(uri, set())
        if len(names) == 1 and uri not in self._blank:
            names.add(local_name(uri))
        return names

    def _name_all(self) -> None:
        for uri in sorted({*self._superclasses, *self._types, *self._labels}):
            for name in self._names(uri):
                self._by_name.setdefault(name, set()).add(uri)


def load_ontology(paths: Iterable[str], limits: SpecificationLimits = DEFAULT_LIMITS) -> Ontology:
    """Read an ontology from local files.

    Args:
        paths: The files; the format follows from the extension: .ttl, .owl, .rdf or .nt.
        limits: The caps on each file.

    Raises:
        OntologyFileError: A file cannot be read, or is not of its extension's format.
    """
    everything = rdflib.Graph()
    warnings: List[Problem] = []
    for path in paths:
        graph = rdflib.Graph()
        data = _load(graph, os.fspath(path), limits)
        warnings.extend(remarks_on(graph, os.fspath(path), data))
        everything += graph
    return Ontology(everything, warnings)


def _load(graph: rdflib.Graph, path: str, limits: SpecificationLimits) -> bytes:
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise OntologyFileError(path, f"expected a file ending in {', '.join(sorted(FORMATS))}")
    try:
        with open(path, "rb") as file:
            data = file.read(limits.ontology_size + 1)
    except OSError as error:
        raise OntologyFileError(path, f"cannot be read: {error.strerror or error}") from error
    if len(data) > limits.ontology_size:
        raise OntologyFileError(
            path, f"is too large; expected at most {limits.ontology_size} bytes"
        )
    try:
        if kind == "xml":
            check_entities(data, limits)
        # Given bytes instead of a location, rdflib has nothing to fetch.
        graph.parse(data=data, format=kind, publicID=Path(path).absolute().as_uri())
    except Exception as error:  # the exceptions of rdflib's parsers have no common base
        reason = " ".join(str(error).split())
        raise OntologyFileError(path, f"is not valid {kind}: {reason[:300]}") from error
    return data


def _reachable(starts: Iterable[str], edges: _Edges) -> Set[str]:
    """Return the starts and everything that can be reached from them; cycles are allowed."""
    reached = set(starts)
    waiting = list(reached)
    while waiting:
        for other in edges.get(waiting.pop(), ()):
            if other not in reached:
                reached.add(other)
                waiting.append(other)
    return reached
