# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ontologies: the individuals of classes, and the subclass relation.

The files are read once, with rdflib, into plain dictionaries. Only local files are read. Skipped
statements are listed in `warnings`.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Iterable

from dyknow.errors import IndividualsError, LabelsError, UnknownConcept
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.manager.specifications.ontologies.files import OntologyFiles
from dyknow.manager.specifications.ontologies.names import Labels, Naming, is_blank, local_name
from dyknow.manager.specifications.ontologies.remarks import Remarks
from dyknow.manager.specifications.ontologies.statements import OntologyStatements


class Ontology:
    """The classes and individuals of a set of files.

    Classes and individuals are named by their URI or by a label; those without a label also by
    the last part of their URI. Thus the functor and the arguments of a tag such as
    `BallObject(nao1)` are names. All names of a class or individual are equivalent.
    """

    def __init__(
        self,
        paths: Iterable[str],
        limits: SpecificationLimits = DEFAULT_LIMITS,
        language: str = "en",
        catalogues: Iterable[str] = (),
    ) -> None:
        """Read an ontology from local files, whose extension is .ttl, .owl, .rdf or .nt.

        Labels in the language are preferred as names. The catalogues say where imported ontologies
        are, beside the file catalog-v001.xml next to each file.

        Raises:
        OntologyFileError: a file cannot be read, or is not of its extension's format.
        LabelsError: two classes, or two individuals, have the same label, in the preferred
        language or in none.
        OntologyError: the language is none.
        """
        self._labels = Labels(language)
        read = OntologyFiles(paths, catalogues, limits)
        for file in read.files:
            self._labels.read(file)
        remarks = Remarks(read)
        statements = OntologyStatements(read, remarks)
        self._hierarchy = statements.hierarchy
        named = [each for each in self._hierarchy if not is_blank(each)]
        alike = self._hierarchy.are_equivalent
        self._classes = Naming("classes", named, self._labels, alike)
        self._individuals = Naming("individuals", statements.types, self._labels, str.__eq__)
        refused = [*self._classes.refused, *self._individuals.refused]
        if refused:
            raise LabelsError(refused)
        remarks.names(self._labels, self._classes, self._individuals)
        #: Statements that were skipped, and doubtful ones.
        self.warnings = tuple(remarks.problems())
        #: Paths of the files that were read, imported ones included.
        self.files = tuple(file.path for file in read.files)
        self._types: dict[str, frozenset[str]] = {}
        self._instances: dict[str, list[str]] = defaultdict(list)
        shared: dict[frozenset[str], frozenset[str]] = {}
        for individual, stated in statements.types.items():
            types = frozenset(stated)
            self._types[individual] = shared.setdefault(types, types)
            for each in types:
                self._instances[each].append(individual)
        self._above: dict[str, frozenset[str]] = {}
        self._above_classes: dict[frozenset[str], frozenset[str]] = {}

    def individuals(self, concept: str) -> tuple[str, ...]:
        """Return the terms of the individuals of a class (a URI) and its subclasses, sorted.

        An individual without a label goes by the last part of its URI; one without a URI is left
        out then. Of several labels the one in the preferred language counts, as `Labels` says.

        Raises:
            UnknownConcept: no class has this URI.
            IndividualsError: an individual has several labels in one language, or none and the
                last part of its URI names another one too. It names all such individuals.
        """
        reasons: list[str] = []
        found: list[str] = []
        for individual in self._of(concept):
            terms = [label.text for label in self._labels.terms(individual)]
            if not terms and is_blank(individual):
                continue
            if not terms:
                term = local_name(individual)
                if self._individuals.get(term) != individual:
                    others = self._individuals.ambiguous.get(term, [self._individuals.get(term)])
                    listed = ", ".join(f"<{each}>" for each in others if each != individual)
                    reasons.append(f"<{individual}> has no label, and '{term}' means {listed} too")
                terms = [term]
            if len(terms) != 1:
                listed = ", ".join(f"'{term}'" for term in terms)
                reasons.append(f"<{individual}> has the labels {listed}; expected exactly one")
            found += terms
        if reasons:
            raise IndividualsError(concept, reasons)
        return tuple(sorted(found))

    def unlabelled(self, concept: str) -> tuple[str, ...]:
        """Return the URIs of a class's individuals that have no label, or raise UnknownConcept.

        `_:` begins those of individuals that have no URI.
        """
        return tuple(each for each in self._of(concept) if not self._labels.terms(each))

    def is_class(self, name: str) -> bool:
        """Whether a label or URI stands for a class."""
        return self._classes.get(name) is not None

    def canonical(self, name: str) -> str:
        """Return the one name that all names of a class or individual have in common.

        It is the URI; the name itself if it is unknown, or if there is no URI. A name of both a
        class and an individual stands for the individual here.
        """
        found = self._individuals.get(name) or self._classes.get(name)
        return name if found is None or is_blank(found) else found

    def written(self, name: str) -> str:
        """Return the name for people of which this is the canonical one, as `Labels` prefers it.

        It stands for the same: an individual takes a name from a class. Without another name it
        is the URI.
        """
        for naming in (self._individuals, self._classes):
            entity = naming.get(name)
            if entity is not None:
                same = [each for each in naming.names(entity) if self.canonical(each) == name]
                return min(same, key=lambda each: each == entity, default=name)
        return name

    def names_above(self, name: str) -> frozenset[str]:
        """Return a name, its synonyms, and the names of the classes above it."""
        known = self._above.get(name)
        if known is not None:
            return known
        individual, kind = self._individuals.get(name), self._classes.get(name)
        if individual is None and kind is None:
            return frozenset((name,))
        names = {name}
        if individual is not None:
            names.update(self._individuals.names(individual))
            names |= self._names_above_classes(self._types[individual])
        if kind is not None:
            names |= self._names_above_classes(frozenset((kind,)))
        known = self._above[name] = frozenset(names)
        return known

    def _names_above_classes(self, classes: frozenset[str]) -> frozenset[str]:
        known = self._above_classes.get(classes)
        if known is None:
            above = self._hierarchy.above(classes)
            known = frozenset(name for each in above for name in self._classes.names(each))
            self._above_classes[classes] = known
        return known

    def _of(self, concept: str) -> list[str]:
        """Return the individuals of a class, sorted."""
        if concept not in self._hierarchy:
            raise UnknownConcept(concept)
        certain, possible = self._hierarchy.below(concept)
        found = {each for kind in certain for each in self._instances.get(kind, ())}
        candidates = {each for kind in possible for each in self._instances.get(kind, ())} - found
        in_class = {
            types: concept in self._hierarchy.above(types)
            for types in {self._types[each] for each in candidates}
        }
        return sorted(found | {each for each in candidates if in_class[self._types[each]]})
