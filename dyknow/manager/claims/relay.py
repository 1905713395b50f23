# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The relay that brings a stream to where a client listens.

It is made where the stream itself has to stay on its topic: an ordinary node publishes it, or
others listen there.
"""

from __future__ import annotations

from typing import Optional, Tuple

from dyknow.datatypes import ANY
from dyknow.errors import SpawnFailed
from dyknow.manager.specifications.tags import read_tags
from dyknow.model.graph import NodeletStatus
from dyknow.model.transformation import IN, OUT, Parameter, Port, Transformation

#: What a relay costs, as transformations do that say nothing else.
RELAY_COST = 1
#: Labels of relays begin with this.
_PREFIX = "relay of "


def relay(topic: str, datatype: str, tags: Tuple[str, ...]) -> Transformation:
    """Describe a relay for a topic: it supplies what the topic does.

    Raises:
        SpawnFailed: the type of the topic is not known.
    """
    if datatype in ANY:
        raise SpawnFailed(_PREFIX + topic, "the type of its messages is not known")
    tags = tuple(tag for tag in tags if all(term.is_ground for term in read_tags((tag,))))
    return Transformation(
        _PREFIX + topic,
        "dyknow/Relay",
        cost=RELAY_COST,
        parameters=(Parameter("datatype", "string", datatype),),
        ports=(Port("in", IN, datatype, tags), Port("out", OUT, datatype, tags)),
    )


def is_relay(transformation: Optional[Transformation]) -> bool:
    """Whether a transformation is one of ours, not of the library."""
    return (
        transformation is not None
        and transformation.label.startswith(_PREFIX + "/")
        and transformation.source == "dyknow/Relay"
    )


def transformation_of_relay(nodelet: NodeletStatus) -> Optional[Transformation]:
    """Return the transformation of a relay, which no library has; None for any other nodelet."""
    out = nodelet.port("out")
    if not nodelet.transformation.startswith(_PREFIX + "/") or out is None or out.datatype in ANY:
        return None
    return relay(nodelet.transformation[len(_PREFIX) :], out.datatype, out.tags)
