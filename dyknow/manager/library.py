# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The library: all transformations by label."""

from __future__ import annotations

import logging
from typing import Callable, Iterable, Mapping, Sequence

from dyknow.errors import LimitExceeded, Problem, SpecificationError, UnknownTransformation
from dyknow.formulas.types import Lookup
from dyknow.garbage import without_collection
from dyknow.locks import state_lock, turn_lock
from dyknow.manager.bodies import pack, unpack
from dyknow.manager.specifications.findings import listed
from dyknow.manager.specifications.formula_parts import no_types
from dyknow.manager.specifications.given import shares_variables
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.manager.specifications.specification import Specifications, parse
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption
from dyknow.manager.specifications.template import Concepts
from dyknow.manager.store import Store
from dyknow.model.transformation import TOPIC, Transformation, Transformations
from dyknow.similar import did_you_mean

#: Meaning of the transformations in the store; 2: a variable is one thing throughout each.
_SCHEMA = 2
#: More changes of the library than are made from one backup to the next.
_AHEAD = 1_000_000

_log = logging.getLogger("rosout.dyknow")


class Library:
    """Transformations by label, in memory and in the store; safe from any thread."""

    @without_collection()
    def __init__(
        self,
        store: Store,
        ontology: Concepts | None = None,
        limits: SpecificationLimits = DEFAULT_LIMITS,
        types: Lookup = no_types,
    ) -> None:
        """Read the store.

        The ontology has the individuals of concepts, for templates; ``types`` describes message
        types, for formulas; texts that are added have to keep the limits.
        """
        self._store = store
        self._concepts = ontology
        self._limits = limits
        self.types = types  # describes message types
        self._turn = turn_lock("library")
        self._state_lock = state_lock("transformations")
        self._by_label: dict[str, Transformation] = store.read("transformations", _stored)
        self.revision = store.number("library_revision")
        if store.complaint:  # a backup took the place of a file that may have had a later one
            self.revision += _AHEAD
            store.write({("facts", "library_revision"): str(self.revision)})
        #: The transformations that require verdicts, by label; replaced as a whole by a change.
        self.guarded: Transformations = _guarded(self._by_label)
        self._known: tuple[list[Transformation], dict[str, Transformation]] = [], {}
        self._known_at = -1
        self._follow_schema()

    @property
    def ontology(self) -> Subsumption:
        """How names are related at present."""
        return NO_ONTOLOGY if self._concepts is None else self._concepts

    def relate(self, ontology: Concepts | None) -> None:
        """Use another ontology from now on; transformations stay as they are."""
        with self._turn:
            self._write({})
            with self._state_lock:
                self._concepts = ontology
                self.revision += 1

    def __len__(self) -> int:
        return len(self._by_label)

    def __contains__(self, label: str) -> bool:
        with self._state_lock:
            return label in self._by_label

    def all(self) -> list[Transformation]:
        with self._state_lock:
            return [self._by_label[label] for label in sorted(self._by_label)]

    def topics(self) -> list[Transformation]:
        """Return the transformations of type topic, by label: the same list until one changes."""
        return self._described()[0]

    def nodes(self) -> Transformations:
        """Return the descriptions of external nodes by name, sorted."""
        return self._described()[1]

    def find(self, label: str) -> Transformation | None:
        with self._state_lock:
            return self._by_label.get(label)

    def get(self, label: str) -> Transformation:
        """Return the transformation of that label; UnknownTransformation names similar labels."""
        found = self.find(label)
        if found is not None:
            return found
        with self._state_lock:
            labels: Sequence[str] = list(self._by_label) if len(self._by_label) < 10_000 else ()
        raise UnknownTransformation(label, did_you_mean(label, labels))

    @without_collection()
    def add(
        self,
        text: str,
        file_name: str = "specification",
        check: Callable[[Iterable[Transformation]], None] = lambda transformations: None,
    ) -> Specifications:
        """Add the transformations of a specification; those of known labels are replaced.

        ``check`` raises an error if one of them must not be added.

        Raises:
            SpecificationError: the text is wrong, or describes a node that another transformation
                describes; nothing was added.
            LimitExceeded: the library would grow beyond its limit; nothing was added.
        """
        specifications = parse(text, file_name, self._concepts, self._limits, self.types)
        check(specifications.transformations)
        new = {each.label: each for each in specifications.transformations}
        with self._turn:
            self._check_nodes(new, file_name)
            count = len(self._by_label.keys() | new.keys())
            if count > self._limits.transformations:
                raise LimitExceeded("transformations", count, self._limits.transformations)
            self._write({label: pack(each) for label, each in new.items()})
            with self._state_lock:
                self._by_label.update(new)
                self.guarded = _guarded({**self.guarded, **new})
                self.revision += 1
        return specifications

    def remove(self, label: str) -> Transformation:
        """Remove a transformation; its nodelets run on."""
        with self._turn:
            found = self.get(label)
            self._write({label: None})
            with self._state_lock:
                del self._by_label[label]
                self.guarded = {key: each for key, each in self.guarded.items() if key != label}
                self.revision += 1
        return found

    def _write(self, bodies: Mapping[str, str | None]) -> None:
        """Write transformations by label, and the revision that the library has with them."""
        changes = {("transformations", label): body for label, body in bodies.items()}
        self._store.write({**changes, ("facts", "library_revision"): str(self.revision + 1)})

    def _described(self) -> tuple[list[Transformation], dict[str, Transformation]]:
        """Find the descriptions of topics, and those of nodes; once for each revision."""
        with self._state_lock:
            if self._known_at != self.revision:
                found = [each for each in self._by_label.values() if each.is_described]
                found.sort(key=lambda each: each.label)
                nodes = {each.node: each for each in reversed(found) if each.node}
                topics = [each for each in found if each.type == TOPIC]
                self._known, self._known_at = (topics, dict(sorted(nodes.items()))), self.revision
            return self._known

    def _check_nodes(self, new: Transformations, file_name: str) -> None:
        """Check that no node is described twice."""
        present = [(each, self.nodes().get(each.node)) for each in new.values() if each.node]
        problems = [
            Problem(
                file_name,
                0,
                f"transformation '{each.label}': the node '{each.node}' is described by "
                f"'{other.label}' already; remove that first",
            )
            for each, other in present
            if other is not None and other.label not in new
        ]
        if problems:
            raise SpecificationError(problems)

    def _follow_schema(self) -> None:
        """Say which transformations of an older store mean something else from now on."""
        if self._store.number("schema") >= _SCHEMA:
            return
        shared = [label for label, each in self._by_label.items() if shares_variables(each)]
        if shared:
            _log.warning(
                "a variable is one thing throughout a transformation now: it no longer stands for "
                "something else in each tag of %s",
                listed(shared),
            )
        self._store.write({("facts", "schema"): str(_SCHEMA)})


def _guarded(by_label: Transformations) -> dict[str, Transformation]:
    return {label: each for label, each in by_label.items() if each.requires}


def _stored(label: str, body: str) -> Transformation:
    found = unpack(body)
    if found.label != label:
        raise ValueError(f"it says that it is '{found.label}'")
    return found
