# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a nodelet supplies: the tags of its out-ports under the bindings of its variables.

Variables are bound by what was given to the nodelet at its spawn, and by the streams at its
in-ports. A stream with several tags may bind a variable in several ways, and all of them are true
of what the nodelet sends. In-ports that contradict each other leave no way.
"""

from __future__ import annotations

import itertools
from typing import Dict, Iterable, List, Mapping, NamedTuple, Sequence, Tuple

from dyknow.manager.planning.supply import Demand, ways_to_meet
from dyknow.manager.specifications.tags import Subsumption, Term

#: Ways that are followed; beyond, less is supplied than could be.
_MOST_WAYS = 64

Way = Mapping[str, str]
"""A name for each variable that is bound."""

Sent = Tuple[Tuple[Term, ...], str]
"""The tags and the ROS type of what a source sends."""


class Inlet(NamedTuple):
    """An in-port that receives something.

    Attributes:
        demand: what it has to receive.
        sources: what is sent there; all of it binds the same names.
    """

    demand: Demand
    sources: Tuple[Sent, ...]


def ways_to_bind(
    known: Iterable[Way], inlets: Iterable[Inlet], ontology: Subsumption
) -> List[Way]:
    """List the ways in which every in-port receives what it demands.

    Args:
        known: what variables stand for in any case, in each way.
        inlets: in-ports of one nodelet.
        ontology: what is a kind of what.

    Returns:
        All ways, each once, in a deterministic order; none if the in-ports contradict each other.
        All of them bind the same variables.
    """
    found: List[Way] = list(known)
    for demand, sources in inlets:
        for tags, datatype in sources:
            more = (
                way
                for before in found
                for way in ways_to_meet(tags, datatype, demand, ontology, before)
            )
            found = list(_distinct(itertools.islice(more, _MOST_WAYS)))
    return found


def supplied(tags: Sequence[Term], ways: Iterable[Way]) -> Tuple[Term, ...]:
    """Return the tags of an out-port in all ways; with unbound variables they supply nothing."""
    bound = [term.substitute(way) for way in ways for term in tags]
    return tuple(dict.fromkeys(term for term in bound if term.is_ground))


def _distinct(ways: Iterable[Way]) -> Iterable[Way]:
    found: Dict[Tuple[Tuple[str, str], ...], Way] = {}
    for way in ways:
        found.setdefault(tuple(sorted(way.items())), way)
    return found.values()
