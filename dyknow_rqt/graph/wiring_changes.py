# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes of the library, and loads of whole wirings, with their inverses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple

from dyknow.errors import DyKnowError
from dyknow.manager.steps import carry_out
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import PortRef
from dyknow.model.transformation import Transformation
from dyknow.wiring.load import steps_of
from dyknow.wiring.plan import LoadPlan, plan_load
from dyknow.wiring.wiring import Wiring
from dyknow_rqt.graph.changes import (
    CannotUndo,
    Change,
    DestroyNodelet,
    Library,
    Protect,
    Rewire,
    SpawnNodelet,
)
from dyknow_rqt.graph.snapshot import Snapshot


@dataclass(frozen=True)
class AddTransformations(Change):
    """Adds the transformations of a specification.

    Attributes:
        specification: XML text.
        origin: where it comes from, for people.
        labels: of the added transformations; known after the change.
    """

    specification: str
    origin: str = "a specification"
    labels: Tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The change in words."""
        return f"import {self.origin}"

    def apply(self, client: BaseManagerClient) -> Change:
        """Add them."""
        return replace(self, labels=client.add_transformation(self.specification).labels)

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Remove the new transformations, restore the replaced ones."""
        if not self.labels:
            raise CannotUndo("it is not known what the specification adds")
        replaced = [library[label] for label in self.labels if label in library]
        new = tuple(label for label in self.labels if label not in library)
        return RestoreTransformations(tuple(replaced), new, f"undo: {self.text}")


@dataclass(frozen=True)
class RestoreTransformations(Change):
    """Puts transformations into the library and removes the rest."""

    put: Tuple[Transformation, ...]
    take: Tuple[str, ...]
    text_: str

    @property
    def text(self) -> str:
        """The change in words."""
        return self.text_

    def apply(self, client: BaseManagerClient) -> Change:
        """Add and remove them."""
        if self.put:
            client.add_transformation(as_specification(self.put))
        for label in self.take:
            client.remove_transformation(label)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Restore these labels to their present transformations."""
        touched = [each.label for each in self.put] + list(self.take)
        return RestoreTransformations(
            tuple(library[label] for label in touched if label in library),
            tuple(label for label in touched if label not in library),
            f"undo: {self.text_}",
        )


def remove_transformations(labels: Sequence[str]) -> Change:
    """Take transformations out of the library."""
    what = labels[0] if len(labels) == 1 else f"{len(labels)} transformations"
    return RestoreTransformations((), tuple(labels), f"delete {what}")


def as_specification(transformations: Sequence[Transformation]) -> str:
    """Write transformations as one XML text."""
    return (
        "<transformations>\n"
        + "".join(t.to_xml() for t in transformations)
        + "</transformations>\n"
    )


class CannotLoad(DyKnowError):
    """A wiring cannot be loaded; nothing was changed."""


@dataclass(frozen=True)
class LoadWiring(Change):
    """Loads a wiring; nodelets that it does not name are left alone.

    Attributes:
        wiring: the wanted wiring.
        origin: where it comes from, for people.
        plan: the changes; known after the change.
    """

    wiring: Wiring
    origin: str = "a wiring"
    plan: Optional[LoadPlan] = None

    @property
    def text(self) -> str:
        """The change in words."""
        return f"load {self.origin}"

    def apply(self, client: BaseManagerClient) -> Change:
        """Check the whole wiring, then apply the differences; undo them if a step fails."""
        model, managers = client.get_model(), client.nodelet_managers()
        plan = plan_load(self.wiring, model, managers, replace=True, any_manager=True)
        if plan.problems:
            raise CannotLoad("\n".join(plan.problems))
        carry_out(steps_of(plan, client))
        return replace(self, plan=plan)

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Destroy the new nodelets and restore the old ones."""
        if self.plan is None:
            raise CannotUndo("it is not known what was changed")
        return Several(tuple(_ways_back(self.plan)), f"undo: {self.text}")


@dataclass(frozen=True)
class Several(Change):
    """Changes, one after the other."""

    changes: Tuple[Change, ...]
    text_: str

    @property
    def text(self) -> str:
        """The change in words."""
        return self.text_

    def apply(self, client: BaseManagerClient) -> Change:
        """Apply the changes up to the first that is refused."""
        for change in self.changes:
            change.apply(client)
        return self

    def check(self, client: BaseManagerClient) -> None:
        """Check that no other client has changed the same things since."""
        for change in self.changes:
            change.check(client)


def _ways_back(plan: LoadPlan) -> List[Change]:
    changes: List[Change] = []
    for kept in reversed(plan.kept):
        name, moves, before = kept.wanted.name, kept.moves, kept.present.connections
        if kept.wanted.is_protected != kept.present.is_protected:
            changes.append(Protect(name, kept.present.is_protected))
        if moves:
            back = {port: before.get(port, "") for port in moves}
            changes.append(Rewire(_at(name, back), f"reconnect {name}", _at(name, moves)))
    for nodelet in reversed(plan.made):
        if nodelet.is_protected:
            changes.append(Protect(nodelet.name, False))
        changes.append(DestroyNodelet(nodelet.name))
    if plan.added or plan.replaced:
        new = tuple(each.label for each in plan.added)
        changes.append(RestoreTransformations(tuple(plan.replaced), new, "put back the library"))
    for remade in reversed(plan.remade):
        changes.append(SpawnNodelet(remade.present.request))
    return changes


def _at(nodelet: str, topics: Dict[str, str]) -> Tuple[Tuple[PortRef, str], ...]:
    return tuple((PortRef(nodelet, port), topic) for port, topic in topics.items())
