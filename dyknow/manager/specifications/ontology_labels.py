# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Labels of the classes and individuals of an ontology, by language."""

from __future__ import annotations

import re
from typing import Callable, Dict, Iterable, Iterator, List, NamedTuple, Tuple

import rdflib
from rdflib import RDFS

from dyknow.errors import OntologyError
from dyknow.manager.specifications.rdf_nodes import node_key

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
