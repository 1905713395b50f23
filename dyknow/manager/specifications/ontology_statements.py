# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads the statements of an ontology about classes and individuals.

Class expressions are blank nodes, and classes without a name: statements about them take part in
the hierarchy. Of restrictions owl:someValuesFrom takes
part too; any other one is a class of which nothing is known, so an intersection with one is a
subclass of its other parts and contains nothing by itself.
"""

from __future__ import annotations

from typing import Dict, Iterator, List, NamedTuple, Sequence, Set, Tuple

import rdflib
from rdflib import OWL, RDF, RDFS

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.ontology_files import OntologyFile
from dyknow.manager.specifications.ontology_hierarchy import VISITS, Hierarchy
from dyknow.manager.specifications.ontology_names import list_members, local_name, node_key

_BUILT_IN = (
    "http://www.w3.org/2002/07/owl#",
    "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "http://www.w3.org/2000/01/rdf-schema#",
)
_XSD = ("http://www.w3.org/2001/XMLSchema#",)
_CLASSES = (OWL.Class, RDFS.Class)
_INDIVIDUALS = (OWL.NamedIndividual, OWL.Thing)
_DATA = (RDFS.Datatype, OWL.DataRange)
_UNIONS = (OWL.unionOf, OWL.disjointUnionOf)
_BOOLEANS = (OWL.intersectionOf, *_UNIONS, OWL.oneOf)


class UnreadExpression(NamedTuple):
    """A class expression that is not read."""

    owner: str
    """The class or individual that it describes."""
    word: str
    """The word that names it in the file; empty if there is none."""


class OntologyStatements:
    """The statements of an ontology's files.

    Attributes:
        hierarchy: the classes.
        types: the classes of each individual, as stated; those of superclasses follow.
    """

    def __init__(self) -> None:
        self.hierarchy = Hierarchy()
        self.types: Dict[str, Set[str]] = {}
        self._graphs: List[rdflib.Graph] = []

    def read(self, file: OntologyFile) -> List[UnreadExpression]:
        """Take the statements of a file.

        Returns:
            The skipped expressions, each once.

        Raises:
            OntologyFileError: a list in the file is malformed.
        """
        self._graphs.append(file.graph)
        return _Reading(file, self.hierarchy, self.types).unread

    def complete(self, visits: int = VISITS) -> bool:
        """Add the consequences of properties and of unions.

        Domains and ranges are classes of the related individuals. A class with some relative of
        one class has some relative of each class above it.

        Args:
            visits: the classes to visit at most.

        Returns:
            Whether that was enough; else only some consequences were found.
        """
        properties = _Properties(self._graphs)
        self._add_relatives(properties)
        relatives = properties.some_values()
        for key, name, _ in relatives:
            for domain in properties.of(name, RDFS.domain):
                self.hierarchy.add_subclass(key, domain)
        by_property: Dict[str, List[Tuple[str, str]]] = {}
        for key, name, filler in relatives:
            by_property.setdefault(name, []).append((key, filler))
        changed = True
        while changed:
            changed = False
            if not self.hierarchy.complete_unions(visits):
                return False
            for key, name, filler in relatives:
                above, known = self.hierarchy.above((filler,)), self.hierarchy.above((key,))
                visits -= len(above) + len(known)
                if visits < 0:
                    return False
                for upper in properties.above(name):
                    for wider, kind in by_property.get(upper, ()):
                        if kind in above and wider not in known:
                            self.hierarchy.add_subclass(key, wider)
                            changed = True
        return True

    def _add_relatives(self, properties: _Properties) -> None:
        """Take the domains and ranges of properties as types of the individuals they relate."""
        for graph in self._graphs:
            for predicate in set(graph.predicates()):
                domains = properties.of(str(predicate), RDFS.domain)
                ranges = properties.of(str(predicate), RDFS.range)
                if not domains and not ranges:
                    continue
                for node, value in graph.subject_objects(predicate):
                    if node_key(node) in self.types:
                        self.types[node_key(node)] |= domains
                    if not isinstance(value, rdflib.Literal) and node_key(value) in self.types:
                        self.types[node_key(value)] |= ranges
                for each in domains | ranges:
                    self.hierarchy.add(each)


class _Properties:
    """The properties of an ontology, with their statements."""

    def __init__(self, graphs: Sequence[rdflib.Graph]) -> None:
        self._graphs = graphs
        self._stated: Dict[Tuple[rdflib.URIRef, str], Set[str]] = {}
        data = {
            node for graph in graphs for kind in _DATA for node in graph.subjects(RDF.type, kind)
        }
        for graph in graphs:
            for predicate in (RDFS.subPropertyOf, RDFS.domain, RDFS.range):
                for node, value in graph.subject_objects(predicate):
                    is_class = value not in data and not str(value).startswith(_BUILT_IN + _XSD)
                    if isinstance(node, rdflib.URIRef) and is_class:
                        key = node_key(value)
                        self._stated.setdefault((predicate, str(node)), set()).add(key)

    def above(self, name: str) -> Set[str]:
        """Return the properties above one, itself included."""
        found = {name}
        waiting = [name]
        while waiting:
            more = self._stated.get((RDFS.subPropertyOf, waiting.pop()), set()) - found
            found |= more
            waiting.extend(more)
        return found

    def of(self, name: str, predicate: rdflib.URIRef) -> Set[str]:
        """Return the domains, or the ranges, of a property."""
        stated = [self._stated.get((predicate, each), set()) for each in self.above(name)]
        return set().union(*stated)

    def some_values(self) -> List[Tuple[str, str, str]]:
        """Return the classes that owl:someValuesFrom describes: key, property and class."""
        return sorted(
            (node_key(node), str(name), node_key(filler))
            for graph in self._graphs
            for node, filler in graph.subject_objects(OWL.someValuesFrom)
            for name in graph.objects(node, OWL.onProperty)
            if isinstance(name, rdflib.URIRef) and not isinstance(filler, rdflib.Literal)
        )


class _Reading:
    """The reading of one file."""

    def __init__(
        self, file: OntologyFile, hierarchy: Hierarchy, types: Dict[str, Set[str]]
    ) -> None:
        self._file = file
        self._graph = file.graph
        self._hierarchy = hierarchy
        self._types = types
        #: Expressions by the class, individual or expression that they describe.
        self._described: List[Tuple[rdflib.term.Node, rdflib.BNode]] = []
        self._data = {node for kind in _DATA for node in file.graph.subjects(RDF.type, kind)}
        self._read_types()
        self._read_subclasses()
        self._read_lists()
        self.unread = sorted({*self._unread(), *self._same()})

    def _read_types(self) -> None:
        hierarchy, types = self._hierarchy, self._types
        for node, kind in self._graph.subject_objects(RDF.type):
            if kind in _CLASSES:
                if isinstance(node, rdflib.URIRef):
                    hierarchy.add(str(node))
            elif kind in _INDIVIDUALS:
                types.setdefault(node_key(node), set())
            elif isinstance(kind, rdflib.BNode) or (
                isinstance(kind, rdflib.URIRef) and not str(kind).startswith(_BUILT_IN)
            ):
                key = node_key(kind)
                hierarchy.add(key)
                types.setdefault(node_key(node), set()).add(key)
                self._describe(node, kind)

    def _read_subclasses(self) -> None:
        for lower, upper in self._graph.subject_objects(RDFS.subClassOf):
            self._add_subclass(lower, upper)
        for one, other in self._graph.subject_objects(OWL.equivalentClass):
            self._add_subclass(one, other)
            self._add_subclass(other, one)

    def _add_subclass(self, lower: rdflib.term.Node, upper: rdflib.term.Node) -> None:
        if self._is_class(lower) and self._is_class(upper):
            self._hierarchy.add_subclass(node_key(lower), node_key(upper))
            self._describe(lower, upper)
            self._describe(upper, lower)

    def _is_class(self, node: rdflib.term.Node) -> bool:
        return not isinstance(node, rdflib.Literal) and node not in self._data

    def _read_lists(self) -> None:
        seen: Set[rdflib.term.Node] = set()
        for predicate in _BOOLEANS:
            for node, head in self._graph.subject_objects(predicate):
                try:
                    members = list_members(self._graph, head, seen)
                except ValueError as error:
                    word = local_name(str(predicate))
                    raise OntologyFileError(
                        self._file.path, f"the list of owl:{word} of {_written(node)}: {error}"
                    ) from error
                self._add_expression(node, predicate, members)

    def _add_expression(
        self,
        node: rdflib.term.Node,
        predicate: rdflib.URIRef,
        members: List[rdflib.term.Node],
    ) -> None:
        if not all(self._is_class(each) for each in (node, *members)):
            return  # a data type and its values
        key = node_key(node)
        self._hierarchy.add(key)
        if predicate == OWL.oneOf:
            for member in members:
                self._types.setdefault(node_key(member), set()).add(key)
            return
        for member in members:
            self._describe(node, member)
        parts = [node_key(member) for member in members]
        if predicate == OWL.intersectionOf:
            self._hierarchy.add_intersection(key, parts)
        else:
            self._hierarchy.add_union(key, parts)

    def _describe(self, node: rdflib.term.Node, expression: rdflib.term.Node) -> None:
        if isinstance(expression, rdflib.BNode):
            self._described.append((node, expression))

    def _unread(self) -> Iterator[UnreadExpression]:
        """Find the expressions of unread kinds, from the named nodes that they describe."""
        inner: Dict[rdflib.term.Node, List[rdflib.BNode]] = {}
        for node, expression in self._described:
            inner.setdefault(node, []).append(expression)
        seen: Set[rdflib.term.Node] = set()
        for owner in [node for node in inner if isinstance(node, rdflib.URIRef)]:
            waiting: List[rdflib.term.Node] = [owner]
            while waiting:
                for each in inner.get(waiting.pop(), ()):
                    if each in seen:
                        continue
                    seen.add(each)
                    waiting.append(each)
                    if not self._is_read(each):
                        yield UnreadExpression(str(owner), self._word(each))

    def _same(self) -> Iterator[UnreadExpression]:
        """Find owl:sameAs, which is skipped."""
        for node, _ in self._graph.subject_objects(OWL.sameAs):
            yield UnreadExpression(node_key(node), "sameAs")

    def _is_read(self, expression: rdflib.BNode) -> bool:
        return any((expression, each, None) in self._graph for each in _BOOLEANS)

    def _word(self, expression: rdflib.BNode) -> str:
        if (expression, RDF.type, OWL.Restriction) in self._graph:
            return "Restriction"
        return "complementOf" if (expression, OWL.complementOf, None) in self._graph else ""


def _written(node: rdflib.term.Node) -> str:
    return f"<{node}>" if isinstance(node, rdflib.URIRef) else "a class without a name"
