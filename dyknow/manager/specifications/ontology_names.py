# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Names of classes and individuals: their labels by language, or the last parts of their URIs."""

from __future__ import annotations

import re
from typing import Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

import rdflib
from rdflib import RDF, RDFS

from dyknow.errors import OntologyError

_BLANK = "_:"


def node_key(node: rdflib.term.Node) -> str:
    """Return the URI of a node, or `_:` and a name of its own if it is blank."""
    return str(node) if isinstance(node, rdflib.URIRef) else f"{_BLANK}{node}"


def is_blank(key: str) -> bool:
    """Whether a key is that of a blank node; no URI begins so."""
    return key.startswith(_BLANK)


def local_name(uri: str) -> str:
    """Return the last part of a URI; all of it if there is no such part."""
    return uri.rsplit("#", 1)[-1].rsplit("/", 1)[-1] or uri


def list_members(
    graph: rdflib.Graph, head: rdflib.term.Node, seen: Set[rdflib.term.Node]
) -> List[rdflib.term.Node]:
    """Return the members of an RDF list.

    Args:
        graph: where it is.
        head: its first node.
        seen: the nodes of the lists that were read; those of this one are added.

    Raises:
        ValueError: it is not a complete list, or shares nodes with another one or itself.
    """
    members: List[rdflib.term.Node] = []
    while head != RDF.nil:
        firsts, rests = list(graph.objects(head, RDF.first)), list(graph.objects(head, RDF.rest))
        if len(firsts) != 1 or len(rests) != 1:
            raise ValueError(
                f"{len(firsts)} rdf:first and {len(rests)} rdf:rest after {len(members)} members; "
                "expected one of each until rdf:nil"
            )
        if head in seen:
            raise ValueError("a list that goes in a circle, or is part of two; expected its own")
        seen.add(head)
        members.append(firsts[0])
        head = rests[0]
    return members


_LANGUAGE = re.compile(r"[A-Za-z]{1,8}(-[A-Za-z0-9]{1,8})*\Z")
#: Labels by rank; of two in the same language, the first one counts.
_PROPERTIES = (RDFS.label, rdflib.URIRef("http://www.w3.org/2004/02/skos/core#prefLabel"))

_Rank = Tuple[int, str, int]


class Label(NamedTuple):
    """A label: its rank among those of the same entity, the lowest first, and its text."""

    rank: _Rank
    text: str
    file: str

    @property
    def language(self) -> str:
        """The code of its language; empty if it has none."""
        return self.rank[1]


class Labels:
    """The labels, with the names that result from them.

    The term of an entity is its label in the preferred language, else the one without a language,
    else one in a variant of the preferred language (en-GB for en), else the English one, else the
    first by the code of its language. `rdfs:label` counts before `skos:prefLabel`.
    """

    def __init__(self, language: str) -> None:
        """Prefer a language.

        Args:
            language: its code, such as en or en-GB; en is preferred next to en-GB.

        Raises:
            OntologyError: it is none.
        """
        if not _LANGUAGE.match(language):
            raise OntologyError(
                f"'{language}' is no language; expected a code such as en or en-GB"
            )
        code = language.lower()
        self._ranges = [code]
        while "-" in code:
            code = code.rpartition("-")[0]
            self._ranges.append(code)
        self._ranges.append("")
        self.language = language
        self._by_entity: Dict[str, List[Label]] = {}
        #: Labels that do not count since other entities have them too, with these.
        self.left: Dict[Label, List[str]] = {}

    def read(self, file: str, graph: rdflib.Graph) -> None:
        """Take the labels of a file."""
        orders: Dict[str, Tuple[int, str]] = {}
        for number, predicate in enumerate(_PROPERTIES):
            for entity, label in graph.subject_objects(predicate):
                text = label.strip() if isinstance(label, rdflib.Literal) else ""
                if not text:
                    continue
                language = (label.language or "").lower()
                if language not in orders:
                    orders[language] = self._order(language)
                found = Label((*orders[language], number), text, file)
                self._by_entity.setdefault(node_key(entity), []).append(found)

    def terms(self, entity: str) -> List[Label]:
        """Return the labels of the best rank, of which there should be one."""
        labels = self._by_entity.get(entity, ())
        if len(labels) < 2:
            return list(labels)
        best = min(label.rank for label in labels)
        return sorted({label.text: label for label in labels if label.rank == best}.values())

    def is_preferred(self, label: Label) -> bool:
        """Whether a label is in the preferred language, or in none."""
        return label.rank[0] < len(self._ranges)

    def leave_shared(self, entities: Iterable[str], alike: Callable[[str, str], bool]) -> None:
        """Leave out terms in other languages than the preferred one that two entities have.

        Args:
            entities: classes, or individuals.
            alike: whether two of them may share a term.
        """
        names = sorted(entities)
        is_new = True
        while is_new:
            is_new = False
            owners: Dict[str, List[Tuple[str, Label]]] = {}
            for entity in names:
                for label in self.terms(entity):
                    owners.setdefault(label.text, []).append((entity, label))
            for found in owners.values():
                first = found[0][0]
                if all(alike(first, entity) for entity, _ in found):
                    continue
                for entity, label in found:
                    if not self.is_preferred(label):
                        self._by_entity[entity].remove(label)
                        self.left.setdefault(label, []).append(entity)
                        is_new = True

    def of(self, entity: str) -> List[Label]:
        """Return all labels of an entity, the best first."""
        return sorted(self._by_entity.get(entity, ()))

    def fallbacks(self, entities: Iterable[str]) -> Iterator[Tuple[str, List[Label]]]:
        """Return the entities whose term was chosen from other languages than the preferred."""
        for entity in entities:
            if len(self._by_entity.get(entity, ())) < 2:
                continue
            labels = self.of(entity)
            if (
                labels[0].rank[0] >= len(self._ranges)
                and labels[0].language != labels[-1].language
            ):
                yield entity, labels

    def _order(self, language: str) -> Tuple[int, str]:
        if language in self._ranges:
            return self._ranges.index(language), language
        primary = language.partition("-")[0]
        variants = (self._ranges[-2], "en")
        return len(self._ranges) + next(
            (number for number, each in enumerate(variants) if each == primary), len(variants)
        ), language


class SharedTerm(NamedTuple):
    """A label that is the term of two classes, or of two individuals."""

    what: str
    one: str
    label: Label
    other: str
    other_label: Label

    def __str__(self) -> str:
        """Write it for people."""
        file, other_file = self.label.file, self.other_label.file
        place = "" if other_file == file else f" in {other_file}"
        return (
            f"{file}: the {self.what} <{self.one}> and <{self.other}>{place} share the label "
            f"'{self.label.text}'"
        )


class Naming:
    """The names of all classes, or those of all individuals; each name stands for one.

    An entity is named by its URI, its term and its other labels. Without a label it is named by
    the last part of its URI. A term goes before another label, and a label before such a part. Of
    what would name two by the same right, terms are refused, and the others name neither.

    Attributes:
        refused: the terms that two entities have.
        unlabelled: the entities without a label.
        ambiguous: the last parts of URIs that name nothing, with the entities concerned.
    """

    def __init__(self, what: str, entities: Iterable[str], labels: Labels) -> None:
        """Name classes, or individuals; `what` says which."""
        self._labels = labels
        self._entities: Dict[str, str] = {}
        self.refused: List[SharedTerm] = []
        self.unlabelled: List[str] = []
        self.ambiguous: Dict[str, List[str]] = {}
        self._sorted = entities = sorted(entities)
        terms: Dict[str, Tuple[str, Label]] = {}
        further: List[Tuple[str, str]] = []
        for entity in entities:
            found = labels.terms(entity)
            for label in found:
                other, its_label = terms.setdefault(label.text, (entity, label))
                if other != entity:
                    self.refused.append(SharedTerm(what, other, its_label, entity, label))
            if found:
                further += [(label.text, entity) for label in labels.of(entity)[1:]]
            elif not is_blank(entity):
                self.unlabelled.append(entity)
        self._entities.update((text, entity) for text, (entity, _) in terms.items())
        self._add(further)
        self.ambiguous = self._add((local_name(each), each) for each in self.unlabelled)
        self._entities.update((entity, entity) for entity in entities)

    def __iter__(self) -> Iterator[str]:
        """The entities, sorted."""
        return iter(self._sorted)

    def get(self, name: str) -> Optional[str]:
        """Return the entity of a name, or None."""
        return self._entities.get(name)

    def names(self, entity: str) -> Iterator[str]:
        """Return the names of an entity; a blank node has only its labels."""
        labels = [label.text for label in self._labels.of(entity)]
        if not is_blank(entity):
            labels += [entity] if labels else [entity, local_name(entity)]
        return (name for name in labels if self._entities.get(name) == entity)

    def shared_with(self, other: Naming) -> List[str]:
        """Return the names that stand for something else there."""
        both = self._entities.keys() & other._entities.keys()
        return sorted(each for each in both if self._entities[each] != other._entities[each])

    def _add(self, names: Iterable[Tuple[str, str]]) -> Dict[str, List[str]]:
        """Add the names of one entity only, and return the rest."""
        owners: Dict[str, Set[str]] = {}
        for name, entity in names:
            if name not in self._entities:
                owners.setdefault(name, set()).add(entity)
        self._entities.update((name, min(each)) for name, each in owners.items() if len(each) == 1)
        return {name: sorted(each) for name, each in owners.items() if len(each) > 1}
