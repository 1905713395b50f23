# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads the statements of an ontology about classes and individuals.

Class expressions are blank nodes: classes without a name that take part in the hierarchy. Of
restrictions those are read by which a class has some relative. Any other one is a class of which
nothing is known, so an intersection with one is a subclass of its other parts and contains nothing
by itself.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import rdflib
from rdflib import OWL, RDF, RDFS

from dyknow.errors import OntologyFileError
from dyknow.manager.specifications.ontologies.files import OntologyFiles
from dyknow.manager.specifications.ontologies.hierarchy import Hierarchy
from dyknow.manager.specifications.ontologies.names import local_name, node_key
from dyknow.manager.specifications.ontologies.remarks import Remarks

Node = rdflib.term.Node

#: Most classes to visit when the consequences of unions and relatives are found.
VISITS = 5_000_000

_BUILT_IN = (str(OWL), str(RDF), str(RDFS))
_XSD = ("http://www.w3.org/2001/XMLSchema#",)
_CLASSES = (OWL.Class, RDFS.Class)
_INDIVIDUALS = (OWL.NamedIndividual, OWL.Thing)
_BOOLEANS = (OWL.intersectionOf, OWL.unionOf, OWL.disjointUnionOf, OWL.oneOf)
_ANYTHING = str(OWL.Thing)
#: Restrictions by which a class has some relative if their number is not zero.
_COUNTS = (
    OWL.minCardinality,
    OWL.minQualifiedCardinality,
    OWL.cardinality,
    OWL.qualifiedCardinality,
)
#: Restrictions by which a class has some relative: read for classes, not for individuals.
_RELATIVES = (OWL.someValuesFrom, OWL.hasValue, *_COUNTS)
#: Expressions that are not read wholly.
_WORDS = (
    *_RELATIVES,
    OWL.allValuesFrom,
    OWL.maxCardinality,
    OWL.maxQualifiedCardinality,
    OWL.hasSelf,
    OWL.complementOf,
)


class _Relatives(NamedTuple):
    """Each member of a class has a relative, by a property or its inverse, in another class."""

    key: str
    name: str
    filler: str
    is_exact: bool  # whether everything with such a relative is in the class


class OntologyStatements:
    """The statements of an ontology's files."""

    def __init__(self, files: OntologyFiles, remarks: Remarks) -> None:
        """Read the statements, or raise OntologyFileError for a malformed list.

        The skipped ones are noted in ``remarks``.
        """
        self.hierarchy = Hierarchy()  # the classes
        #: Properties and their inverses, which are `^` and the property.
        self._properties = Hierarchy()
        #: Superclasses of the subjects of a property, as stated.
        self._domains: dict[str, set[str]] = defaultdict(set)
        #: The classes of each individual, as stated; those of superclasses follow.
        self.types: dict[str, set[str]] = defaultdict(set)
        self._files = files
        self._graph = files.graph
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
        self._note_unread(remarks)
        self._read_properties()
        self._read_domains_and_ranges()
        if not self._complete(VISITS):
            remarks.too_many_unions()

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
                    is_named = isinstance(node, rdflib.URIRef)
                    what = f"<{node}>" if is_named else "a class without a name"
                    raise OntologyFileError(
                        self._files.home(node), f"the list of owl:{word} of {what}: {error}"
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

    def _note_unread(self, remarks: Remarks) -> None:
        """Note the expressions of unread kinds, by the named nodes that they describe."""
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
                        words = (word for word in _WORDS if (each, word, None) in self._graph)
                        word = next(words, "")
                        remarks.unread(
                            self._files.home(each),
                            str(owner),
                            local_name(str(word)),
                            word in _RELATIVES,
                        )
        for file in self._files.files:
            for node in file.graph.subjects(OWL.sameAs):
                remarks.unread(file.path, node_key(node), "sameAs")

    def _read_properties(self) -> None:
        for lower, upper in self._graph.subject_objects(RDFS.subPropertyOf):
            self._add_subproperty(node_key(lower), node_key(upper))
        for one, other in self._graph.subject_objects(OWL.equivalentProperty):
            self._add_equal_properties(node_key(one), node_key(other))
        for one, other in self._graph.subject_objects(OWL.inverseOf):
            self._add_equal_properties(node_key(one), _inverse(node_key(other)))
        for each in self._graph.subjects(RDF.type, OWL.SymmetricProperty):
            self._add_equal_properties(node_key(each), _inverse(node_key(each)))

    def _add_subproperty(self, lower: str, upper: str) -> None:
        self._properties.add_subclass(lower, upper)
        self._properties.add_subclass(_inverse(lower), _inverse(upper))

    def _add_equal_properties(self, one: str, other: str) -> None:
        self._add_subproperty(one, other)
        self._add_subproperty(other, one)

    def _read_domains_and_ranges(self) -> None:
        """Take the domain and the range of each property as types of the related individuals."""
        for name, value in self._graph.subject_objects(RDFS.domain):
            self._add_domain(node_key(name), value)
        for name, value in self._graph.subject_objects(RDFS.range):
            self._add_domain(_inverse(node_key(name)), value)
        domains: dict[Node, tuple[set[str], set[str]]] = {}
        for subject, name, value in self._graph.triples((None, None, None)):
            if name not in domains:
                key = node_key(name)
                domains[name] = (self._domains_of(key), self._domains_of(_inverse(key)))
            for node, found in zip((subject, value), domains[name]):
                if found and not isinstance(node, rdflib.Literal) and node_key(node) in self.types:
                    self.types[node_key(node)] |= found

    def _add_domain(self, name: str, value: Node) -> None:
        if self._is_class(value) and not str(value).startswith(_BUILT_IN + _XSD):
            self.hierarchy.add(node_key(value))
            self._domains[name].add(node_key(value))

    def _domains_of(self, name: str) -> set[str]:
        """Return the classes of the subjects of a property."""
        above = self._properties.above((name,))
        return {kind for each in above for kind in self._domains.get(each, ())}

    def _complete(self, visits: int) -> bool:
        """Add the consequences of unions and of relatives, within a number of visits.

        A class with some relative of one class has some relative of each class above it.
        """
        relatives = self._relatives()
        exact: dict[str, list[_Relatives]] = defaultdict(list)
        for each in relatives:
            if each.is_exact:
                exact[each.name].append(each)
        #: The exact ones of each property and of those above it, and the range of the property.
        wider: dict[str, tuple[list[_Relatives], set[str]]] = {}
        for each in relatives:
            if each.name not in wider:
                above = self._properties.above((each.name,))
                visits -= len(above)
                found = [one for upper in above for one in exact.get(upper, ())]
                wider[each.name] = (found, self._domains_of(_inverse(each.name)))
            for domain in self._domains_of(each.name):
                self.hierarchy.add_subclass(each.key, domain)
        changed = True
        while changed:
            changed = False
            if not self.hierarchy.complete_unions(visits):
                return False
            for each in relatives:
                found, ranges = wider[each.name]
                above = self.hierarchy.above((each.filler, *ranges)) | {_ANYTHING}
                known = self.hierarchy.above((each.key,))
                visits -= len(above) + len(known) + len(found)
                if visits < 0:
                    return False
                for one in found:
                    if one.key not in known and one.filler in above:
                        self.hierarchy.add_subclass(each.key, one.key)
                        changed = True
        return True

    def _relatives(self) -> list[_Relatives]:
        """Return the relatives that restrictions require."""
        graph = self._graph
        found = []
        for node, name in graph.subject_objects(OWL.onProperty):
            read = [
                (node_key(filler), True)
                for filler in graph.objects(node, OWL.someValuesFrom)
                if not isinstance(filler, rdflib.Literal)
            ]
            read += [(_ANYTHING, False) for _ in graph.objects(node, OWL.hasValue)]
            for predicate in _COUNTS:
                for each in graph.objects(node, predicate):
                    count = str(each).lstrip("0")  # may be too long to convert
                    if count.isdecimal():
                        stated = (OWL.onClass, OWL.onDataRange)
                        fillers = [each for word in stated for each in graph.objects(node, word)]
                        is_exact = count == "1" and predicate in _COUNTS[:2]
                        read.append((node_key((*fillers, OWL.Thing)[0]), is_exact))
            found += [_Relatives(node_key(node), node_key(name), *each) for each in read]
        return sorted(found)


def _inverse(name: str) -> str:
    return name[1:] if name.startswith("^") else f"^{name}"
