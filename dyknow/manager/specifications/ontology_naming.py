# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Names of classes and of individuals: their URIs, their labels, or the last parts of the URIs."""

from __future__ import annotations

from typing import Dict, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

from dyknow.manager.specifications.ontology_labels import Label, Labels
from dyknow.manager.specifications.rdf_nodes import is_blank, local_name


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
        """Return what a name stands for; None if that is nothing."""
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
        """Add what names one entity only, and return the rest."""
        owners: Dict[str, Set[str]] = {}
        for name, entity in names:
            if name not in self._entities:
                owners.setdefault(name, set()).add(entity)
        self._entities.update((name, min(each)) for name, each in owners.items() if len(each) == 1)
        return {name: sorted(each) for name, each in owners.items() if len(each) > 1}
