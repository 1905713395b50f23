# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Names of classes and individuals: their labels by language, or the last parts of their URIs."""

from __future__ import annotations

import re
from collections import defaultdict
from typing import Callable, Iterable, Iterator, NamedTuple

import rdflib
from rdflib import RDFS

from dyknow.errors import OntologyError
from dyknow.manager.specifications.ontologies.files import OntologyFile

_BLANK = "_:"
_LANGUAGE = re.compile(r"[A-Za-z]{1,8}(-[A-Za-z0-9]{1,8})*\Z")
#: Labels by rank; of two in the same language, the first one counts.
_PROPERTIES = (RDFS.label, rdflib.URIRef("http://www.w3.org/2004/02/skos/core#prefLabel"))


def node_key(node: rdflib.term.Node) -> str:
    """Return the URI of a node, or `_:` and a name of its own if it is blank."""
    return str(node) if isinstance(node, rdflib.URIRef) else f"{_BLANK}{node}"


def is_blank(key: str) -> bool:
    return key.startswith(_BLANK)


def local_name(uri: str) -> str:
    """Return the last part of a URI; all of it if there is no such part."""
    return uri.rsplit("#", 1)[-1].rsplit("/", 1)[-1] or uri


class Label(NamedTuple):
    """A label: its rank among those of the same entity, the lowest first, and its text.

    The rank is that of the language, the language's code, and that of the property.
    """

    rank: tuple[int, str, int]
    text: str
    file: str

    @property
    def language(self) -> str:
        """The code of its language; empty if it has none."""
        return self.rank[1]


class Labels:
    """The labels of the entities, and the term of each entity among them.

    The term of an entity is its label in the preferred language, else the one without a language,
    else one in a variant of the preferred language (en-GB for en), else the English one, else the
    first by the code of its language. `rdfs:label` counts before `skos:prefLabel`.
    """

    def __init__(self, language: str) -> None:
        """Prefer a language, such as en, or en-GB and next to it en."""
        if not _LANGUAGE.match(language):
            raise OntologyError(
                f"'{language}' is no language; expected a code such as en or en-GB"
            )
        parts = language.lower().split("-")
        self._preferred = ["-".join(parts[:end]) for end in range(len(parts), 0, -1)] + [""]
        self._variants = [parts[0], "en"]
        self.language = language  # the preferred language as it was given
        self._by_entity: dict[str, list[Label]] = defaultdict(list)
        #: Labels that do not count since other entities have them too, with the entities.
        self.dropped: dict[Label, list[str]] = defaultdict(list)

    def read(self, file: OntologyFile) -> None:
        for number, predicate in enumerate(_PROPERTIES):
            for entity, label in file.graph.subject_objects(predicate):
                text = label.strip() if isinstance(label, rdflib.Literal) else ""
                if text:
                    language = (label.language or "").lower()
                    found = Label((self._order(language), language, number), text, file.path)
                    self._by_entity[node_key(entity)].append(found)

    def _order(self, language: str) -> int:
        if language in self._preferred:
            return self._preferred.index(language)
        primary = language.partition("-")[0]
        known = primary in self._variants
        order = self._variants.index(primary) if known else len(self._variants)
        return len(self._preferred) + order

    def of(self, entity: str) -> list[Label]:
        """Return all labels of an entity, the best first."""
        return sorted(self._by_entity.get(entity, ()))

    def terms(self, entity: str) -> list[Label]:
        """Return the labels of the best rank, of which there should be one."""
        labels = self.of(entity)
        return list({each.text: each for each in labels if each.rank == labels[0].rank}.values())

    def is_preferred(self, label: Label) -> bool:
        """Whether a label is in the preferred language, or in none."""
        return label.rank[0] < len(self._preferred)

    def drop_shared(self, entities: Iterable[str], alike: Callable[[str, str], bool]) -> None:
        """Drop terms of several entities in other languages, unless these are alike."""
        names = sorted(entities)
        is_new = True
        while is_new:  # another label of the entity becomes its term
            is_new = False
            owners: dict[str, list[tuple[str, Label]]] = defaultdict(list)
            for entity in names:
                for label in self.terms(entity):
                    owners[label.text].append((entity, label))
            for found in owners.values():
                if all(alike(found[0][0], entity) for entity, _ in found):
                    continue
                for entity, label in found:
                    if not self.is_preferred(label):
                        self._by_entity[entity].remove(label)
                        self.dropped[label].append(entity)
                        is_new = True

    def fallbacks(self, entities: Iterable[str]) -> Iterator[tuple[str, list[Label]]]:
        """Return entities with labels in several languages, none of them preferred."""
        for entity in entities:
            labels = self.of(entity)
            languages = {label.language for label in labels}
            if len(languages) > 1 and not self.is_preferred(labels[0]):
                yield entity, labels


class Naming:
    """The names of all classes, or those of all individuals; each name stands for one.

    An entity is named by its URI, its term and its other labels. Without a label it is named by
    the last part of its URI. A term goes before another label, and a label before such a part. Of
    equal ones terms are refused, and the others name neither entity.
    """

    def __init__(
        self, what: str, entities: Iterable[str], labels: Labels, alike: Callable[[str, str], bool]
    ) -> None:
        """Name classes, or individuals, as ``what`` says; alike ones may share a term."""
        self._labels = labels
        self._sorted = sorted(entities)
        labels.drop_shared(self._sorted, alike)
        self.refused: list[str] = []  # equal terms of two entities, in words
        self.unlabelled: list[str] = []  # the entities without a label
        owners: dict[str, tuple[str, Label]] = {}
        further: list[tuple[str, str]] = []
        for entity in self._sorted:
            terms = labels.terms(entity)
            for label in terms:
                other, its_label = owners.setdefault(label.text, (entity, label))
                if other != entity and not alike(other, entity):
                    place = "" if label.file == its_label.file else f" in {label.file}"
                    self.refused.append(
                        f"{its_label.file}: the {what} <{other}> and <{entity}>{place} share the "
                        f"label '{label.text}'"
                    )
            if terms:
                further += [(label.text, entity) for label in labels.of(entity)[1:]]
            elif not is_blank(entity):
                self.unlabelled.append(entity)
        self._entities = {text: entity for text, (entity, _) in owners.items()}
        self._add(further)
        #: The last parts of URIs that name nothing, with the entities concerned.
        self.ambiguous = self._add([(local_name(each), each) for each in self.unlabelled])
        self._entities.update(zip(self._sorted, self._sorted))

    def _add(self, names: list[tuple[str, str]]) -> dict[str, list[str]]:
        """Add the names of one entity only, and return the rest."""
        owners: dict[str, set[str]] = defaultdict(set)
        for name, entity in names:
            if name not in self._entities:
                owners[name].add(entity)
        self._entities.update((name, min(each)) for name, each in owners.items() if len(each) == 1)
        return {name: sorted(each) for name, each in owners.items() if len(each) > 1}

    def __iter__(self) -> Iterator[str]:
        return iter(self._sorted)

    def get(self, name: str) -> str | None:
        """Return the entity of a name, or None."""
        return self._entities.get(name)

    def names(self, entity: str) -> Iterator[str]:
        """Return the names of an entity; a blank node has only its labels."""
        names = [label.text for label in self._labels.of(entity)]
        if not is_blank(entity):
            names += [entity] if names else [entity, local_name(entity)]
        return (name for name in names if self._entities.get(name) == entity)

    def shared_with(self, other: Naming) -> list[str]:
        """Return the names that stand for something else there."""
        both = self._entities.keys() & other._entities.keys()
        return sorted(each for each in both if self._entities[each] != other._entities[each])
