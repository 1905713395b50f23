# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The problem of one request: the library, live streams, and what everything costs this client.

Live streams are facts without a cost. A demand that has to be *fast* is a pattern of its own. An
out-port that states no rate is as fast as all that feeds it: it belongs to a second, fast action
whose in-ports demand fast streams. Both are one nodelet, so a plan has one of them at most.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import replace
from types import MappingProxyType
from typing import AbstractSet, Dict, Iterable, Iterator, Mapping, Sequence, TypeVar

from dyknow.manager.planning.library import (
    Head,
    Offer,
    Operator,
    OperatorIndex,
    bucketed,
    candidates,
    cheapest,
    matching,
)
from dyknow.manager.planning.patterns import (
    NO_TYPES,
    Known,
    Pattern,
    Theta,
    atoms_of,
    ground,
    pattern_of,
    solutions,
)
from dyknow.manager.planning.problem import (
    NO_FREE,
    NO_LABELS,
    NO_VERDICTS,
    Demand,
    Free,
    TaggedStream,
    Verdicts,
)
from dyknow.model.transformation import OUT, Port

#: Makers that are looked up by the names that a search knows, not all at once.
MANY = 300
#: More than any plan costs.
NEVER = 2**62
#: Out-ports that are looked at to explain why one demand is not met.
_MOST_ALIKE = 5_000

Need = TypeVar("Need")
Nodelet = TypeVar("Nodelet")

NO_CHARGES: Mapping[str, int] = MappingProxyType({})
"""Nothing has to be paid besides the costs."""
NO_FEEDERS: Mapping[str, Sequence[str]] = MappingProxyType({})
"""It is not known what feeds the live streams."""


class Request:
    """The problem of one request."""

    #: Whether private variables count as one where an action has fast inputs or not.
    is_strict = False
    is_whole = False  # whether parts of dearer plans are looked at as well

    def __init__(
        self,
        library: OperatorIndex,
        demand: Demand,
        streams: Sequence[TaggedStream],
        exclude: AbstractSet[str] = NO_LABELS,
        paused: AbstractSet[str] = NO_LABELS,
        free: Free = NO_FREE,
        charges: Mapping[str, int] = NO_CHARGES,
        feeders: Mapping[str, Sequence[str]] = NO_FEEDERS,
        verdicts: Verdicts | None = NO_VERDICTS,
        refused: AbstractSet[str] = NO_TYPES,
        wanted: Sequence[str] = (),
    ) -> None:
        """Set it up; the arguments are those of `Planner.plan`.

        Every name counts that the wanted variables of the demand can stand for.
        """
        self.library = library
        self.names = names = library.names
        self.demand = demand
        #: Its age at most, in microseconds; None for any.
        self.limit = round(demand.max_age * 1e6) if demand.max_age else None
        self._fast: dict[Pattern, Pattern] = {}
        self._fast_actions: dict[Operator, Operator] = {}
        self.goal = pattern_of(demand.tags, demand.datatype, names, wanted)  # the requested demand
        self.goal.refused = refused
        if demand.min_rate:
            self.goal = self._faster(self.goal)
        actions = library.actions
        self.exclude, self.paused = exclude, paused
        numbers = itertools.count()
        #: Actions of which nodelets are free: numbers of these, and names that each keeps.
        self.kept = {
            actions[label]: [
                (next(numbers), {variable: names.canonical(name) for variable, name in bindings})
                for bindings in nodelets
            ]
            for label, nodelets in free.items()
            if label in actions and label not in exclude
        }
        #: Those of them of which no further nodelet is made.
        self.scarce = {action for action in self.kept if action.label in paused}
        self._barred = {actions[each] for each in (*exclude, *paused) if each in actions}
        self._barred -= self.scarce
        self._verdicts = verdicts
        guarded = library.guarded
        self._barred.update([e for e in guarded if not e.variables and self.is_barred(e, ())])
        #: Charges of actions besides their costs.
        self.charges = {actions[each]: n for each, n in charges.items() if n and each in actions}
        #: Least costs of actions where these differ from the stated ones.
        self._floors = {
            action: (0 if action in self.kept else action.cost) + self.charges.get(action, 0)
            for action in (*self.kept, *self.charges)
        }
        self._unusable: list[TaggedStream] = []
        by_name: dict[str, list[TaggedStream]] = {}
        for each in sorted(streams):
            if each[0].label in exclude:
                self._unusable.append(each)
            else:
                by_name.setdefault(each[0].nodelet or each[0].topic, []).append(each)
        heads = [
            replace(head, cost=floor)
            for action, floor in self._floors.items()
            if not action.inputs
            for head in action.heads
        ]
        for name, some in by_name.items():
            labels = (some[0][0].label, *feeders.get(some[0][0].nodelet, ()))
            heads += self._source(name, sum([charges.get(e, 0) for e in labels]), some)
        self._local = bucketed(heads)

    def _source(self, name: str, cost: int, streams: Iterable[TaggedStream]) -> tuple[Head, ...]:
        """Return the out-ports of an action of live streams, which needs nothing."""
        action = Operator(name, cost, None, (), (), (), (), (), False, None)
        found = []
        for live, terms in streams:
            tags = [term for term in terms if term.is_ground]
            texts, atoms = tuple(map(str, tags)), atoms_of(tags, (), self.names)
            port = Port(live.port, OUT, live.datatype, texts, live.rate, live.latency)
            found.append(Head(action, cost, port, atoms, live))
        action.heads = tuple(found)
        return action.heads

    # Actions

    def floor(self, action: Operator) -> int:
        """Return the least cost of an action."""
        return self._floors.get(action.base, action.cost)

    def cost(self, action: Operator, theta: Theta) -> int:
        """Return the cost of an action under bindings, if it may use a nodelet that is free."""
        if self.fitting(action, theta):
            return self._floors[action.base]
        return action.cost + self.charges.get(action.base, 0)

    def fitting(self, action: Operator, theta: Theta) -> Sequence[int]:
        """Return the numbers of the free nodelets that could be an action under bindings."""
        kept = self.kept.get(action.base)
        if kept is None:
            return ()
        bound = dict(zip(action.variables, theta))
        return [
            number
            for number, names in kept
            if all(bound.get(variable, name) == name for variable, name in names.items())
        ]

    def is_barred(self, action: Operator, theta: Theta) -> bool:
        """Whether an action must not be used under bindings.

        The verdicts that it requires forbid it, or it would need a nodelet that is not made.
        """
        if action.base in self.scarce and not self.fitting(action, theta):
            return True
        transformation = action.transformation
        if transformation is None or not action.requires or self._verdicts is None:
            return False
        bindings = dict(zip(action.variables, theta))
        return bool(self._verdicts.unmet(transformation, bindings, self.names.canonical))

    def source(self, action: Operator, theta: Theta, pattern: Pattern, names: Theta) -> Head:
        """Return the out-port with which an instance supplies names: of several the soonest."""
        found = []
        for head in action.heads:
            if head.has_type(pattern) and self._is_fast(pattern, action, head):
                atoms = [ground(atom, theta) for atom in head.atoms]
                if names in solutions(atoms, pattern, self.names):
                    found.append(head)
        return min(found, key=lambda head: head.port.latency)

    # Demands

    def offers(self, pattern: Pattern, known: Known = ()) -> Iterator[Offer]:
        """Yield how makers can supply a pattern; known names rule some of them out."""
        min_rate = self.demand.min_rate
        if any(known) and self.crowd(pattern) is not None:
            found: Iterable[Offer] = self.library.look_up(pattern.slow or pattern, known)
        else:
            found = self.library.offers(pattern.slow or pattern)
        for offer in found:
            rate = offer.head.port.rate
            if offer.action in self._barred:
                continue
            if pattern.slow is None or rate >= min_rate:
                yield offer
            if min_rate and (not rate or pattern.slow is None):
                yield offer._replace(action=self._faster_action(offer.action))

    def crowd(self, pattern: Pattern) -> int | None:
        """Return what very many makers that may supply a pattern cost at least; None for few."""
        count, least = self.library.count_makers(pattern)
        return min([least, *self._floors.values()]) if count > MANY else None

    def facts(self, pattern: Pattern, known: Known = ()) -> Iterator[tuple[Head, Theta]]:
        """Return the facts that supply a pattern, the cheapest first."""
        heads: Iterable[Head] = candidates(self.library.buckets, pattern, known, self.names)
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

    def cheapest_facts(self, pattern: Pattern) -> Sequence[Head]:
        """Return the two cheapest suppliers that need nothing, as far as there are any."""
        if pattern.slow is None and not (self._local and self._has_local(pattern)):
            found = self.library.cheapest_facts(pattern)
            if not found or self._barred.isdisjoint([head.action for head in found]):
                return found
        return cheapest(self.facts(pattern))

    def _has_local(self, pattern: Pattern) -> bool:
        local = candidates(self._local, pattern, (), self.names, is_local=True)
        return next(local, None) is not None

    def is_met(self, pattern: Pattern, head: Head) -> bool:
        """Whether a fact that supplies a pattern is as good as any supplier."""
        if self.is_whole or (self.limit is not None and head.latency):
            return False
        if not head.cost or pattern is not self.goal:
            return not head.cost
        _, least = self.library.count_makers(pattern)
        return head.cost <= min([least, *self._floors.values()])

    def alike(self, pattern: Pattern) -> Iterator[Head]:
        """Yield out-ports that might supply a pattern with fewer constraints, excluded or not."""
        names, library = self.names, self.library
        loose = Pattern(pattern.atoms, "", (NO_TYPES,) * len(pattern.types), pattern.wanted)
        found = itertools.chain(
            candidates(library.buckets, loose, (), names),
            candidates(library.buckets, loose, (), names, is_maker=True),
            candidates(self._local, loose, (), names, is_local=True),
        )
        yield from itertools.islice(found, _MOST_ALIKE)
        for each in self._unusable:
            yield from self._source(each[0].label, 0, [each])

    # Rates

    def _faster(self, pattern: Pattern) -> Pattern:
        """Return the pattern of the same demand for a fast stream."""
        found = self._fast.get(pattern)
        if found is None:
            found = self._fast[pattern] = Pattern(*pattern.key, pattern, pattern.refused)
        return found

    def _faster_action(self, action: Operator) -> Operator:
        found = self._fast_actions.get(action)
        if found is None:
            inputs = tuple(map(self._faster, action.inputs))
            found = self._fast_actions[action] = replace(action, inputs=inputs, slow=action)
        return found

    def _is_fast(self, pattern: Pattern, action: Operator, head: Head) -> bool:
        """Whether an out-port of an action is as fast as a pattern demands it."""
        if pattern.slow is None:
            return True
        if head.port.rate:
            return head.port.rate >= self.demand.min_rate
        return action.slow is not None or not action.inputs


def matched(
    fitting: Mapping[Need, Iterable[Nodelet]], begun: Mapping[Need, Nodelet]
) -> dict[Need, Nodelet]:
    """Give as many needs as possible a nodelet that fits, by augmenting paths.

    H. W. Kuhn, "The Hungarian method for the assignment problem", Naval Research Logistics
    Quarterly 2, 1955. The preferred nodelets come first among those that fit a need. Needs that
    have a nodelet in the matching to begin with keep one.
    """
    found = dict(begun)
    users = {nodelet: need for need, nodelet in begun.items()}
    for need in [each for each in fitting if each not in found]:
        #: The needs that would take each nodelet.
        takers: Dict[Nodelet, Need] = {}
        waiting = [need]
        for taker in waiting:  # grows meanwhile
            left = [each for each in fitting[taker] if each not in takers]
            takers.update(dict.fromkeys(left, taker))
            unused = next((each for each in left if each not in users), None)
            if unused is None:
                waiting += [users[each] for each in left]
                continue
            path: Nodelet | None = unused
            while path is not None:  # each on the path takes the nodelet of the one before
                user = takers[path]
                before = found.get(user)
                users[path], found[user] = user, path
                path = before
            break
    return found
