# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads the statements of an ontology about classes and individuals.

Class expressions are blank nodes: classes without a name that take part in the hierarchy. Of
restrictions only owl:someValuesFrom is read. Any other one is a class of which nothing is known,
so an intersection with one is a subclass of its other parts and contains nothing by itself.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Iterator, NamedTuple, Sequence

import rdflib
from rdflib import OWL, RDF, RDFS

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.ontology_files import OntologyFile, merged
from dyknow.manager.specifications.ontology_hierarchy import Hierarchy
from dyknow.manager.specifications.ontology_names import local_name, node_key

Node = rdflib.term.Node

#: Most classes to visit when the consequences of unions and relatives are found.
VISITS = 5_000_000

_BUILT_IN = (str(OWL), str(RDF), str(RDFS))
_XSD = ("http://www.w3.org/2001/XMLSchema#",)
_CLASSES = (OWL.Class, RDFS.Class)
_INDIVIDUALS = (OWL.NamedIndividual, OWL.Thing)
_BOOLEANS = (OWL.intersectionOf, OWL.unionOf, OWL.disjointUnionOf, OWL.oneOf)


class Unread(NamedTuple):
    """A statement that is skipped: the file, whom it describes, the word that names it there."""

    path: str
    owner: str
    word: str


class OntologyStatements:
    """The statements of an ontology's files.

    Attributes:
        hierarchy: the classes.
        types: the classes of each individual, as stated; those of superclasses follow.
        unread: the skipped statements.
        is_complete: whether all consequences of unions and relatives were found.
    """

    def __init__(self, files: Sequence[OntologyFile]) -> None:
        """Read the statements, or raise OntologyFileError for a malformed list."""
        self.hierarchy = Hierarchy()
        self.types: dict[str, set[str]] = defaultdict(set)
        self._files = files
        self._graph = merged(files)
        #: Expressions by the class, individual or expression that they describe.
        self._described: dict[Node, list[rdflib.BNode]] = defaultdict(list)
        self._data = {
            node
            for kind in (RDFS.Datatype, OWL.DataRange)
            for node in self._graph.subjects(RDF.type, kind)
        }
        self._read_types()
        self._read_subclasses()
        self._read_lists()
        self.unread = sorted({*self._unread_expressions(), *self._same_individuals()})
        self._read_domains_and_ranges()
        self.is_complete = self._complete(VISITS)

    def _read_types(self) -> None:
        for node, kind in self._graph.subject_objects(RDF.type):
            if kind in _CLASSES:
                if isinstance(node, rdflib.URIRef):
                    self.hierarchy.add(str(node))
            elif kind in _INDIVIDUALS:
                self.types[node_key(node)]
            elif not isinstance(kind, rdflib.Literal) and not str(kind).startswith(_BUILT_IN):
                self.hierarchy.add(node_key(kind))
                self.types[node_key(node)].add(node_key(kind))
                self._describe(node, kind)

    def _read_subclasses(self) -> None:
        for lower, upper in self._graph.subject_objects(RDFS.subClassOf):
            self._add_subclass(lower, upper)
        for one, other in self._graph.subject_objects(OWL.equivalentClass):
            self._add_subclass(one, other)
            self._add_subclass(other, one)

    def _add_subclass(self, lower: Node, upper: Node) -> None:
        if self._is_class(lower) and self._is_class(upper):
            self.hierarchy.add_subclass(node_key(lower), node_key(upper))
            self._describe(lower, upper)
            self._describe(upper, lower)

    def _is_class(self, node: Node) -> bool:
        return not isinstance(node, rdflib.Literal) and node not in self._data

    def _describe(self, node: Node, expression: Node) -> None:
        if isinstance(expression, rdflib.BNode):
            self._described[node].append(expression)

    def _read_lists(self) -> None:
        seen: set[Node] = set()
        for predicate in _BOOLEANS:
            for node, head in self._graph.subject_objects(predicate):
                try:
                    members = self._list_members(head, seen)
                except ValueError as error:
                    word = local_name(str(predicate))
                    what = (
                        f"<{node}>"
                        if isinstance(node, rdflib.URIRef)
                        else "a class without a name"
                    )
                    raise OntologyFileError(
                        self._file_of(node), f"the list of owl:{word} of {what}: {error}"
                    ) from error
                if all(map(self._is_class, (node, *members))):
                    self._add_expression(node, predicate, members)

    def _list_members(self, head: Node, seen: set[Node]) -> list[Node]:
        """Return the members of an RDF list, or raise ValueError.

        It must be complete and share no node with itself or with the lists ``seen`` before.
        """
        members: list[Node] = []
        while head != RDF.nil:
            firsts = list(self._graph.objects(head, RDF.first))
            rests = list(self._graph.objects(head, RDF.rest))
            if len(firsts) != 1 or len(rests) != 1:
                raise ValueError(
                    f"{len(firsts)} rdf:first and {len(rests)} rdf:rest after {len(members)} "
                    "members; expected one of each until rdf:nil"
                )
            if head in seen:
                raise ValueError(
                    "a list that goes in a circle, or is part of two; expected its own"
                )
            seen.add(head)
            members += firsts
            head = rests[0]
        return members

    def _add_expression(self, node: Node, predicate: Node, members: list[Node]) -> None:
        key, parts = node_key(node), [node_key(member) for member in members]
        self.hierarchy.add(key)
        if predicate == OWL.oneOf:
            for part in parts:
                self.types[part].add(key)
            return
        for member in members:
            self._describe(node, member)
        if predicate == OWL.intersectionOf:
            self.hierarchy.add_intersection(key, parts)
        else:
            self.hierarchy.add_union(key, parts)

    def _unread_expressions(self) -> Iterator[Unread]:
        """Find the expressions of unread kinds, from the named nodes that they describe."""
        seen: set[Node] = set()
        for owner in [node for node in self._described if isinstance(node, rdflib.URIRef)]:
            waiting: list[Node] = [owner]
            while waiting:
                found: set[Node] = set(self._described.get(waiting.pop(), ()))
                found -= seen
                seen |= found
                waiting += found
                for each in found:
                    if not any((each, word, None) in self._graph for word in _BOOLEANS):
                        yield Unread(self._file_of(each), str(owner), self._word(each))

    def _same_individuals(self) -> Iterator[Unread]:
        for file in self._files:
            for node in file.graph.subjects(OWL.sameAs):
                yield Unread(file.path, node_key(node), "sameAs")

    def _word(self, expression: Node) -> str:
        if (expression, RDF.type, OWL.Restriction) in self._graph:
            return "Restriction"
        return "complementOf" if (expression, OWL.complementOf, None) in self._graph else ""

    def _file_of(self, node: Node) -> str:
        """Return the first file that states something of a node, else the first one."""
        stating = (each.path for each in self._files if (node, None, None) in each.graph)
        return next(stating, self._files[0].path)

    def _read_domains_and_ranges(self) -> None:
        """Take the domain and the range of each property as types of the related individuals."""
        graph, types = self._graph, self.types
        #: Superclasses of the individuals that have some value of a property.
        self._domains: dict[Node, set[str]] = defaultdict(set)
        for predicate in (RDFS.domain, RDFS.range):
            for name, value in graph.subject_objects(predicate):
                if not self._is_class(value) or str(value).startswith(_BUILT_IN + _XSD):
                    continue
                key = node_key(value)
                for each in graph.transitive_subjects(RDFS.subPropertyOf, name):
                    if predicate == RDFS.domain:
                        self._domains[each].add(key)
                    place = graph.subjects if predicate == RDFS.domain else graph.objects
                    for node in place(predicate=each):
                        if not isinstance(node, rdflib.Literal) and node_key(node) in types:
                            types[node_key(node)].add(key)
                            self.hierarchy.add(key)

    def _complete(self, visits: int) -> bool:
        """Add the consequences of unions and of someValuesFrom, within a number of visits.

        A class with some relative of one class has some relative of each class above it.
        """
        relatives = self._some_values()
        by_property: dict[Node, list[tuple[str, str]]] = defaultdict(list)
        for key, name, filler in relatives:
            by_property[name].append((key, filler))
            for domain in self._domains[name]:
                self.hierarchy.add_subclass(key, domain)
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
                for upper in self._graph.transitive_objects(name, RDFS.subPropertyOf):
                    for wider, kind in by_property.get(upper, ()):
                        if kind in above and wider not in known:
                            self.hierarchy.add_subclass(key, wider)
                            changed = True
        return True

    def _some_values(self) -> list[tuple[str, rdflib.URIRef, str]]:
        """Return the classes that owl:someValuesFrom describes: key, property and class."""
        return sorted(
            (node_key(node), name, node_key(filler))
            for node, filler in self._graph.subject_objects(OWL.someValuesFrom)
            for name in self._graph.objects(node, OWL.onProperty)
            if isinstance(name, rdflib.URIRef) and not isinstance(filler, rdflib.Literal)
        )
