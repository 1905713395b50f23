# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A whole wiring as a value and as XML: what runs, how it is connected, and what it is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple
from xml.sax.saxutils import quoteattr

from dyknow.errors import DyKnowError
from dyknow.manager.claims.ends import transformation_of_relay
from dyknow.model.graph import Model, NodeletStatus, SpawnRequest
from dyknow.model.transformation import Transformation

VERSION = "1"


class CannotSave(DyKnowError):
    """A wiring cannot be written so that it could be read again."""


@dataclass(frozen=True)
class Wiring:
    """Requests for nodelets, by name, and the transformations they are made from, by label."""

    transformations: Tuple[Transformation, ...] = ()
    nodelets: Tuple[SpawnRequest, ...] = ()

    def to_xml(self) -> str:
        """Write the wiring as canonical XML: the same text for equal wirings."""
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', f'<wiring version="{VERSION}">']
        lines.append("<transformations>")
        lines.extend(each.to_xml().rstrip("\n") for each in self.transformations)
        lines.append("</transformations>")
        lines.append("<nodelets>")
        for nodelet in self.nodelets:
            lines.extend(_nodelet_xml(nodelet))
        lines.append("</nodelets>")
        lines.append("</wiring>\n")
        return "\n".join(lines)


def wiring_of(snapshot: Model) -> Tuple[Wiring, List[NodeletStatus]]:
    """Take the wiring out of a model.

    Returns:
        The wiring, and the nodelets that it leaves out because others loaded them: nobody knows
        what they are made from.

    Raises:
        CannotSave: a transformation is gone that a nodelet was made from.
    """
    known = {each.label: each for each in snapshot.transformations}
    own = [nodelet for nodelet in snapshot.nodelets if nodelet.transformation]
    relays = (transformation_of_relay(each) for each in own if each.transformation not in known)
    known.update({each.label: each for each in relays if each is not None})
    gone = [
        f"'{each.transformation}' of '{each.name}'"
        for each in own
        if each.transformation not in known
    ]
    if gone:
        raise CannotSave(
            f"the library has no more {', '.join(gone)}; expected the transformation of every "
            "nodelet (import it again, or destroy the nodelet)"
        )
    used = {nodelet.transformation for nodelet in own}
    wiring = Wiring(
        tuple(known[label] for label in sorted(used)),
        tuple(nodelet.request for nodelet in sorted(own, key=lambda each: each.name)),
    )
    return wiring, [nodelet for nodelet in snapshot.nodelets if not nodelet.transformation]


def _nodelet_xml(nodelet: SpawnRequest) -> List[str]:
    attributes = [("name", nodelet.name), ("transformation", nodelet.label)]
    attributes.extend([("manager", nodelet.manager)] if nodelet.manager else [])
    attributes.extend([("protected", "true")] if nodelet.is_protected else [])
    attributes.extend([("isolated", "true")] if nodelet.isolated else [])
    opening = "  <nodelet" + "".join(f" {key}={quoteattr(value)}" for key, value in attributes)
    if not nodelet.config and not nodelet.parameters:
        return [opening + "/>"]
    return [
        opening + ">",
        *(
            f"    <param name={quoteattr(name)} type={quoteattr(type_)} value={quoteattr(text)}/>"
            for name, type_, text in nodelet.parameters
        ),
        *(
            f"    <connection port={quoteattr(port)} topic={quoteattr(topic)}/>"
            for port, topic in sorted(nodelet.config.items())
        ),
        "  </nodelet>",
    ]
