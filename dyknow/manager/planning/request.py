# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The problem of one request: the library, live streams, and what everything costs this client.

Live streams are facts without a cost. A demand that has to be *fast* is a pattern of its own. An
out-port that states no rate is as fast as all that feeds it: it belongs to a second, fast action
whose in-ports demand fast streams.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import replace
from types import MappingProxyType
from typing import (
    AbstractSet,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from dyknow.manager.planning.library import (
    Buckets,
    Head,
    Offer,
    Operator,
    OperatorIndex,
    bucketed,
    candidates,
    matching,
    microseconds,
)
from dyknow.manager.planning.patterns import (
    NO_TYPES,
    Known,
    Pattern,
    Theta,
    atoms_of,
    pattern_of,
    solutions,
)
from dyknow.manager.planning.problem import NO_FREE, NO_LABELS, Demand, Live, TaggedStream
from dyknow.manager.specifications.tags import Bindings, Term

#: Out-ports that are looked at to explain why one demand is not met.
_MOST_ALIKE = 5_000

NO_CHARGES: Mapping[str, int] = MappingProxyType({})
"""Nothing has to be paid besides the costs."""
NO_FEEDERS: Mapping[str, FrozenSet[str]] = MappingProxyType({})
"""It is not known what feeds the live streams."""


class Need(NamedTuple):
    """A demand under bindings of the variables that are wanted of it."""

    pattern: Pattern
    theta: Theta


class Request:
    """The problem of one request.

    Attributes:
        goal: the requested demand.
        limit: its age at most, in microseconds; None for any.
        kept: actions of which a nodelet is free, each with the names that it has to keep.
        charges: charges of actions besides their costs.
        live: the actions of live streams.
    """

    def __init__(
        self,
        library: OperatorIndex,
        demand: Demand,
        streams: Sequence[TaggedStream],
        exclude: AbstractSet[str] = NO_LABELS,
        paused: AbstractSet[str] = NO_LABELS,
        free: Mapping[str, Bindings] = NO_FREE,
        charges: Mapping[str, int] = NO_CHARGES,
        feeders: Mapping[str, FrozenSet[str]] = NO_FEEDERS,
        wanted: Sequence[str] = (),
    ) -> None:
        """Set it up.

        Args:
            library: the actions.
            demand: the requested demand.
            streams: live streams.
            exclude: labels that must not be used, live or new.
            paused: labels of which no new nodelet is made.
            free: nodelets that cost nothing: label and bindings that they keep.
            charges: charges besides the costs, by label.
            feeders: labels of a nodelet's feeders, by its name.
            wanted: variables of the demand of which every name matters.
        """
        self.library = library
        self.names = names = library.names
        self.demand = demand
        self.limit = microseconds(demand.max_age) if demand.max_age else None
        self._fast: Dict[Pattern, Pattern] = {}
        self._fast_actions: Dict[Operator, Operator] = {}
        self.goal = pattern_of(demand.tags, demand.datatype, names, wanted)
        if demand.min_rate:
            self.goal = self._faster(self.goal)
        actions = library.actions
        self.exclude, self.paused = exclude, paused
        self._barred = {actions[each] for each in (*exclude, *paused) if each in actions}
        self.kept = {
            actions[label]: {variable: names.canonical(name) for variable, name in bindings}
            for label, bindings in free.items()
            if label in actions
        }
        self.charges = {actions[each]: n for each, n in charges.items() if n and each in actions}
        #: Least costs of actions where these differ from the stated ones.
        self._floors: Dict[Operator, int] = {}
        heads: List[Head] = []
        for action in (*self.kept, *self.charges):
            floor = 0 if action in self.kept else action.cost
            self._floors[action] = floor + self.charges.get(action, 0)
        for action, floor in self._floors.items():
            if not action.inputs:
                heads += [replace(head, cost=floor) for head in action.heads]
        self.live: Set[Operator] = set()
        self._unusable = [each for each in streams if each[0].label in exclude]
        by_name: Dict[str, List[TaggedStream]] = {}
        for each in sorted(streams):
            if each[0].label not in exclude:
                by_name.setdefault(each[0].nodelet or each[0].topic, []).append(each)
        for name, some in by_name.items():
            labels = {some[0][0].label, *feeders.get(some[0][0].nodelet, ())}
            action = _source(name, sum([charges.get(label, 0) for label in labels]))
            action.heads.extend([self._live_head(action, *stream) for stream in some])
            self.live.add(action)
            heads += action.heads
        self._local: Buckets = bucketed(heads)

    # Actions

    def floor(self, action: Operator) -> int:
        """Return the least cost of an action."""
        return self._floors.get(action.slow or action, action.cost)

    def cost(self, action: Operator, theta: Theta) -> int:
        """Return the cost of an action under bindings, if it may use the nodelet that is free."""
        base = action.slow or action
        if self.is_free(base, theta):
            return self._floors[base]
        return action.cost + self.charges.get(base, 0)

    def is_free(self, action: Operator, theta: Theta) -> bool:
        """Whether a nodelet that costs nothing could be this one."""
        kept = self.kept.get(action)
        if kept is None:
            return False
        bound = dict(zip(action.variables, theta))
        return all(bound.get(variable, name) == name for variable, name in kept.items())

    def source(self, action: Operator, theta: Theta, node: Need) -> Head:
        """Return the out-port with which an instance supplies a node: of several the soonest."""
        if len(action.heads) == 1:
            return action.heads[0]
        pattern = node.pattern
        found = []
        for head in action.heads:
            if head.goes_with(pattern.datatype) and self._is_fast(pattern, action, head):
                atoms = [atom.ground(theta) for atom in head.atoms]
                if node.theta in solutions(atoms, pattern, self.names):
                    found.append(head)
        return min(found, key=lambda head: head.latency)

    # Demands

    def makers(self, pattern: Pattern) -> Sequence[Operator]:
        """Return the actions with in-ports that can supply a pattern, each once."""
        if self.demand.min_rate:
            return list(dict.fromkeys([action for action, _ in self.offers(pattern)]))
        found = self.library.makers_of(pattern)
        return [each for each in found if each not in self._barred] if self._barred else found

    def offers(self, pattern: Pattern, known: Known = ()) -> Iterator[Tuple[Operator, Offer]]:
        """Yield how makers can supply a pattern; known names rule some of them out."""
        slow, min_rate = pattern.slow or pattern, self.demand.min_rate
        if any(known) and self.crowd(pattern) is not None:
            found: Iterable[Offer] = self.library.look_up(slow, known)
        else:
            found = self.library.offers(slow)
        for offer in found:
            head = offer.head
            if head.action in self._barred:
                continue
            if pattern.slow is None or head.rate >= min_rate:
                yield head.action, offer
            if min_rate and (not head.rate or pattern.slow is None):
                yield self._faster_action(head.action), offer

    def crowd(self, pattern: Pattern) -> Optional[int]:
        """Return what very many makers that may supply a pattern cost at least; None for few."""
        found = self.library.crowd(pattern.slow or pattern)
        return found if found is None else min([found, *self._floors.values()])

    def facts(self, pattern: Pattern, known: Known = ()) -> Iterator[Tuple[Head, Theta]]:
        """Return the facts that supply a pattern, the cheapest first."""
        heads: Iterable[Head] = candidates(self.library.facts, pattern, known, self.names)
        if self._local:
            local = candidates(self._local, pattern, known, self.names, is_local=True)
            others = (head for head in heads if head.action not in self._floors)
            heads = heapq.merge(local, others, key=lambda head: head.cost)
        if self._barred or pattern.slow is not None:
            heads = (
                head
                for head in heads
                if head.action not in self._barred and self._is_fast(pattern, head.action, head)
            )
        return matching(heads, pattern, known, self.names)

    def cheapest_fact(self, pattern: Pattern) -> Optional[Head]:
        """Return the cheapest supplier of a pattern that needs nothing."""
        if not self._local and pattern.slow is None:
            found = self.library.cheapest_fact(pattern)
            if found is None or found.action not in self._barred:
                return found
        return next((head for head, _ in self.facts(pattern)), None)

    def is_met(self, head: Head) -> bool:
        """Whether a supplier is as good as any."""
        return not head.cost and (self.limit is None or not head.latency)

    def alike(self, pattern: Pattern) -> Iterator[Head]:
        """Yield out-ports that might supply a pattern with fewer constraints, excluded or not."""
        names, library = self.names, self.library
        loose = Pattern(pattern.atoms, "", (NO_TYPES,) * len(pattern.types), pattern.wanted)
        found = itertools.chain(
            candidates(library.facts, loose, (), names),
            candidates(library.makers, loose, (), names),
            candidates(self._local, loose, (), names, is_local=True),
        )
        yield from itertools.islice(found, _MOST_ALIKE)
        for each in self._unusable:
            yield self._live_head(_source(each[0].label, 0), *each)

    # Inside

    def _faster(self, pattern: Pattern) -> Pattern:
        """Return the pattern of the same demand for a fast stream."""
        found = self._fast.get(pattern)
        if found is None:
            found = self._fast[pattern] = Pattern(
                pattern.atoms, pattern.datatype, pattern.types, pattern.wanted, pattern
            )
        return found

    def _faster_action(self, action: Operator) -> Operator:
        found = self._fast_actions.get(action)
        if found is None:
            inputs, needs = (tuple(map(self._faster, e)) for e in (action.inputs, action.needs))
            found = replace(action, inputs=inputs, needs=needs, slow=action)
            self._fast_actions[action] = found
        return found

    def _is_fast(self, pattern: Pattern, action: Operator, head: Head) -> bool:
        """Whether an out-port of an action is as fast as a pattern demands it."""
        if pattern.slow is None:
            return True
        if head.rate:
            return head.rate >= self.demand.min_rate
        return action.slow is not None or not action.inputs

    def _live_head(self, action: Operator, stream: Live, terms: Tuple[Term, ...]) -> Head:
        ground = [term for term in terms if term.is_ground]
        return Head(
            action.cost,
            stream,
            action,
            tuple(map(str, ground)),
            atoms_of(ground, (), self.names),
            stream.datatype,
            stream.rate,
            microseconds(stream.latency),
        )


def _source(name: str, cost: int) -> Operator:
    """Return the action of live streams, which needs nothing."""
    return Operator(name, cost, [], (), (), (), (), (), (), False, None)
