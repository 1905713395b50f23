# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Demands, and whether a stream is what is demanded."""

from __future__ import annotations

from typing import Dict, FrozenSet, Iterable, Iterator, Mapping, NamedTuple

from dyknow.datatypes import types_fit
from dyknow.demand_text import write_demand
from dyknow.manager.specifications.tags import (
    NO_BINDINGS,
    NO_ONTOLOGY,
    Subsumption,
    Term,
    unify_all,
)


class Demand(NamedTuple):
    """What an in-port, or a client, asks of one stream.

    Attributes:
        tags: all of them.
        datatype: ROS type; empty for any.
        min_rate: Hz; what is stated to be slower does not meet the demand. 0 for any.
        max_age: seconds; plans whose stated latency is higher do not meet it. 0 for any.
    """

    tags: FrozenSet[Term]
    datatype: str = ""
    min_rate: float = 0.0
    max_age: float = 0.0

    def __str__(self) -> str:
        """Write the demand for people."""
        rate = f"at least {self.min_rate:g} Hz" if self.min_rate else ""
        age = f"at most {self.max_age:g} s old" if self.max_age else ""
        return write_demand(map(str, self.tags), self.datatype, rate, age)

    def is_fast(self, rate: float) -> bool:
        """Whether a rate will do; 0 stands for one that is not stated."""
        return not rate or rate >= self.min_rate

    def is_soon(self, latency: float) -> bool:
        """Whether a stated latency will do."""
        return not self.max_age or latency <= self.max_age


def meets(
    tags: Iterable[Term], datatype: str, demand: Demand, ontology: Subsumption = NO_ONTOLOGY
) -> bool:
    """Return whether a stream of these tags and type is what is demanded."""
    return next(ways_to_meet(tags, datatype, demand, ontology), None) is not None


def ways_to_meet(
    tags: Iterable[Term],
    datatype: str,
    demand: Demand,
    ontology: Subsumption = NO_ONTOLOGY,
    bindings: Mapping[str, str] = NO_BINDINGS,
) -> Iterator[Dict[str, str]]:
    """Yield the bindings of each way in which a stream is what is demanded.

    Args:
        tags: of the stream; those with variables supply nothing.
        datatype: of the stream.
        demand: what is asked for.
        ontology: what is a kind of what.
        bindings: what variables stand for already.
    """
    if types_fit(datatype, demand.datatype):
        yield from unify_all(tags, sorted(demand.tags), ontology, bindings)
