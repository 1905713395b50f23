# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes of the library."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Sequence, Tuple

from dyknow.model.client import BaseManagerClient
from dyknow.model.transformation import Transformation
from dyknow_rqt.graph.changes import CannotUndo, Change, Library
from dyknow_rqt.graph.snapshot import Snapshot


@dataclass(frozen=True)
class AddTransformations(Change):
    """Adds the transformations of a specification.

    Attributes:
        specification: XML text.
        origin: where it comes from, for people.
        labels: of what it adds; known after the change.
    """

    specification: str
    origin: str = "a specification"
    labels: Tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """What is done."""
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
    """Puts transformations into the library and removes others."""

    put: Tuple[Transformation, ...]
    take: Tuple[str, ...]
    text_: str

    @property
    def text(self) -> str:
        """What is done."""
        return self.text_

    def apply(self, client: BaseManagerClient) -> Change:
        """Add and remove them."""
        if self.put:
            client.add_transformation(as_specification(self.put))
        for label in self.take:
            client.remove_transformation(label)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Restore these labels to what they are now."""
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
