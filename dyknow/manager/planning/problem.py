# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planning problem and its answer, as values.

An AND/OR graph: a transformation needs *all* its tagged in-ports supplied (AND); a demand is met
by *any* matching out-port or live stream (OR). A plan chooses for each demand that it meets one
supplier, without a cycle; each transformation stands in it at most once and costs once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Callable, Iterable, Iterator, Mapping, NamedTuple, Sequence, Tuple, Union

from dyknow.datatypes import types_fit
from dyknow.demand_text import write_demand, write_missing
from dyknow.manager.specifications.tags import (
    NO_BINDINGS,
    NO_ONTOLOGY,
    Bindings,
    Subsumption,
    Term,
    parse_tag,
    unify_all,
)
from dyknow.model.transformation import Transformation


class Demand(NamedTuple):
    """The demand of an in-port, or a client, on one stream, which has to have all the tags.

    The type is empty for any, the rate (Hz) and the age (s) are 0 for any. Streams that state a
    lower rate, and plans whose stated latency is higher, do not meet it.
    """

    tags: frozenset[Term]
    datatype: str = ""
    min_rate: float = 0.0
    max_age: float = 0.0

    def __str__(self) -> str:
        rate = f"at least {self.min_rate:.12g} Hz" if self.min_rate else ""
        age = f"at most {self.max_age:.12g} s old" if self.max_age else ""
        return write_demand(map(str, self.tags), self.datatype, rate, age)

    def both(self, other: Demand) -> Demand:
        """Return what a stream has to be that meets another demand as well."""
        return Demand(
            self.tags | other.tags,
            self.datatype or other.datatype,
            max(self.min_rate, other.min_rate),
            min(filter(None, (self.max_age, other.max_age)), default=0.0),
        )

    def is_fast(self, rate: float) -> bool:
        """Whether a rate will do; 0 stands for one that is not stated."""
        return not rate or rate >= self.min_rate

    def is_soon(self, latency: float) -> bool:
        """Whether a stated latency will do."""
        return not self.max_age or latency <= self.max_age


class Live(NamedTuple):
    """A stream that exists: it costs nothing."""

    topic: str
    port: str  # out-port that publishes it, empty for topics of ordinary nodes
    nodelet: str  # its publisher, empty for topics of ordinary nodes
    label: str  # the transformation behind it
    datatype: str
    rate: float = 0.0  # Hz that its out-port states, or its feeders state; 0 if they state none
    latency: float = 0.0  # seconds that its nodelet and all that feeds it state


TaggedStream = Tuple[Live, Tuple[Term, ...]]
"""A stream and what it is about."""
Streams = Iterable[TaggedStream]


class Instance(NamedTuple):
    """What a plan needs once: a nodelet of a transformation."""

    label: str  # of the transformation
    bindings: Bindings = ()  # what all its variables stand for


class New(NamedTuple):
    """An out-port of a nodelet to make."""

    instance: Instance
    port: str

    @property
    def label(self) -> str:
        return self.instance.label


Source = Union[Live, New]


class PlanStep(NamedTuple):
    """A nodelet to make."""

    instance: Instance
    inputs: tuple[tuple[str, Source], ...]  # its in-ports with their suppliers
    cost: int  # 0 if a nodelet can be connected elsewhere
    charge: int = 0  # besides the cost, if the client would rather have other parts


@dataclass(frozen=True)
class Plan:
    """How to get a stream."""

    demand: Demand
    goal: Source  # where it comes from
    steps: tuple[PlanStep, ...]  # the nodelets to make, suppliers before consumers
    least_cost: int = 0  # no plan costs less; if it is the cost, that is proven least
    bindings: Bindings = ()  # of the variables in the demand
    #: Whether the clock ended the improvement, so that the same problem may have another plan at
    #: another time.
    is_cut_short: bool = False
    #: Of the running nodelets, and the topics, whose streams are used as they are.
    charges: tuple[tuple[str, int], ...] = ()
    latency: float = 0.0  # the stated latencies along the longest path, in s

    @cached_property
    def cost(self) -> int:
        """The sum over the steps and the charges."""
        steps = sum([step.cost + step.charge for step in self.steps])
        return steps + sum([charge for _, charge in self.charges])

    @cached_property
    def sources(self) -> frozenset[Source]:
        """Everything that is used of nodelets that exist, and of new ones."""
        inputs = [source for step in self.steps for _, source in step.inputs]
        return frozenset((self.goal, *inputs))

    @cached_property
    def live(self) -> tuple[Live, ...]:
        """Streams that are used as they are."""
        return tuple(sorted([each for each in self.sources if isinstance(each, Live)]))


class Obstacle(NamedTuple):
    """A demand that something would supply, but for causes, which are sentences."""

    demand: Demand
    causes: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.demand} cannot be used: {', and '.join(self.causes)}"


class NoPlan(NamedTuple):
    """Why there is none."""

    demand: Demand
    missing: tuple[Demand, ...]  # demands that nothing supplies, sorted by their text
    circular: bool  # whether nothing is missing, but everything that supplies it needs it first
    latency: float = 0.0  # of the soonest plan, in s, if all are too late; else 0
    #: Demands that would be met but for a type, a rate, or an exclusion.
    obstacles: tuple[Obstacle, ...] = ()
    is_cut_short: bool = False  # whether the search reached its limit, so that there may be a plan

    @property
    def reason(self) -> str:
        """Explain why there is no plan, besides the missing demands."""
        if self.obstacles:
            return "; ".join(map(str, self.obstacles))
        if self.is_cut_short:
            return "the search reached its limit before it found one; a larger budget raises that"
        if self.latency:
            return f"the soonest plan found takes {self.latency:.12g} s"
        return "everything that supplies it needs it first"

    def __str__(self) -> str:
        if self.missing:
            text = write_missing(str(self.demand), map(str, self.missing))
            return "; ".join([text, *map(str, self.obstacles)])
        return f"no plan for {self.demand}: {self.reason}"


#: The charge of a part besides its cost.
AVOIDED = 1000
NOT_PREFERRED = 100


class Wishes(NamedTuple):
    """Preferred and avoided parts: labels, and concepts of tags of out-ports."""

    prefer: tuple[str, ...] = ()
    avoid: tuple[str, ...] = ()


NO_WISHES = Wishes()
"""Everything is as good as everything else."""


class Verdicts(NamedTuple):
    """The verdicts that transformations require, by their tags; those left out are not known."""

    good: frozenset[Term] = frozenset()  # tags of the verdicts that are TRUE
    #: Tags of those that are FALSE, or have not been TRUE for long enough since.
    bad: frozenset[Term] = frozenset()

    def unmet(
        self,
        transformation: Transformation,
        bindings: Mapping[str, str],
        canonical: Callable[[str], str],
        is_in_use: bool = False,
    ) -> list[Term]:
        """Return the tags of the verdicts for which a transformation is not to be used.

        A part that is in use already has had its first verdict.
        """
        tags = required_tags(transformation, bindings, canonical)
        return [
            tag
            for each, tag in zip(transformation.requires, tags)
            if tag in self.bad
            or not (is_in_use or each.initially or tag in self.good or not tag.is_ground)
        ]


NO_VERDICTS = Verdicts()


def required_tags(
    transformation: Transformation, bindings: Mapping[str, str], canonical: Callable[[str], str]
) -> list[Term]:
    """Return the tags of the verdicts that a transformation requires, with canonical names."""
    terms = [parse_tag(each.tag).substitute(bindings) for each in transformation.requires]
    return [canonical_tag(term, canonical) for term in terms]


def canonical_tag(term: Term, canonical: Callable[[str], str]) -> Term:
    """Write a tag with canonical names, and without types."""
    return Term(canonical(term.functor), tuple(map(canonical, term.args)))


Answer = Union[Plan, NoPlan]
NO_LABELS: frozenset[str] = frozenset()
Free = Mapping[str, Sequence[Bindings]]
"""The labels of nodelets that can be connected elsewhere, with the bindings that each keeps."""
NO_FREE: Free = MappingProxyType({})
"""No nodelet can be connected elsewhere."""


def meets(
    tags: Iterable[Term], datatype: str, demand: Demand, ontology: Subsumption = NO_ONTOLOGY
) -> bool:
    """Return whether a stream of these tags and type meets a demand."""
    return next(ways_to_meet(tags, datatype, demand, ontology), None) is not None


def ways_to_meet(
    tags: Iterable[Term],
    datatype: str,
    demand: Demand,
    ontology: Subsumption = NO_ONTOLOGY,
    bindings: Mapping[str, str] = NO_BINDINGS,
) -> Iterator[dict[str, str]]:
    """Return the bindings of each way in which a stream meets a demand, given some of them.

    Tags of the stream that have variables supply nothing.
    """
    if not types_fit(datatype, demand.datatype):
        return iter(())
    return unify_all(tags, sorted(demand.tags), ontology, bindings)
