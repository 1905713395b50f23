# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What one request may be planned with, and what everything costs it.

Beside the library there are live streams, which are facts without a cost. A demand that has to be
*fast* has the complement of its number. An out-port that states no rate is as fast as all that
feeds it: for it an action is needed whose in-ports are fast, with the complement of its number.
"""

from __future__ import annotations

import heapq
import itertools
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
    Tuple,
)

from dyknow.manager.planning.library import (
    Bucket,
    Buckets,
    Head,
    Offer,
    RuleLibrary,
    candidates,
    microseconds,
)
from dyknow.manager.planning.patterns import (
    NO_TYPES,
    Atom,
    Known,
    Pattern,
    Theta,
    atoms_of,
    matcher,
    pattern_of,
    solutions,
)
from dyknow.manager.planning.problem import NO_FREE, NO_LABELS, Demand, Live, TaggedStream
from dyknow.manager.specifications.tags import Bindings, Term

GOAL = 1 << 60
"""The number of the demand that is asked for."""
_LOCAL = 1 << 50
"""Actions from this number on are live streams, those of a nodelet together."""
#: Out-ports that are looked at to explain why one demand is not met.
_MOST_ALIKE = 5_000

NO_CHARGES: Mapping[str, int] = MappingProxyType({})
"""Nothing has to be paid besides the costs."""
NO_FEEDERS: Mapping[str, FrozenSet[str]] = MappingProxyType({})
"""It is not known what feeds the live streams."""


class Need(NamedTuple):
    """A demand under bindings of the variables that are wanted of it."""

    number: int
    theta: Theta


class Request:
    """The problem of one request."""

    def __init__(
        self,
        library: RuleLibrary,
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
            library: what can be made.
            demand: what is asked for.
            streams: what is live.
            exclude: labels that must not be used, live or new.
            paused: labels of which nothing new is made.
            free: nodelets that cost nothing: label and bindings that they keep.
            charges: what has to be paid besides the costs, by label.
            feeders: labels of what feeds a nodelet, by its name.
            wanted: variables of the demand of which every name matters.
        """
        self.library = library
        self.names = names = library.names
        self.demand = demand
        self.limit = microseconds(demand.max_age) if demand.max_age else None
        self.goal = ~GOAL if demand.min_rate else GOAL
        self._pattern = pattern_of(demand.tags, demand.datatype, names, wanted)
        self._offers: Optional[Tuple[Offer, ...]] = None
        by_label = library.by_label
        self._exclude, self._paused = exclude, paused
        self._excluded = {by_label[each] for each in (*exclude, *paused) if each in by_label}
        self.kept = {
            by_label[label]: {variable: names.canonical(name) for variable, name in bindings}
            for label, bindings in free.items()
            if label in by_label
        }
        self.charges = {by_label[each]: n for each, n in charges.items() if n and each in by_label}
        #: What actions cost at least where that is not what they state.
        self._floors: Dict[int, int] = {}
        #: The out-ports of live actions, and what these are charged, with their names.
        self._heads: Dict[int, Tuple[Head, ...]] = {}
        self.charged: Dict[int, Tuple[str, int]] = {}
        entries: Dict[Tuple[str, int], Dict[Tuple[Head, Atom], None]] = {}
        self._unusable = [each for each in streams if each[0].label in exclude]
        usable = [each for each in streams if each[0].label not in exclude]
        self._add_streams(usable, charges, feeders, entries)
        for action in [*self.kept, *self.charges]:
            own = 0 if action in self.kept else library.costs[action]
            floor = self._floors[action] = own + self.charges.get(action, 0)
            if not library.inputs[action]:
                heads = [head._replace(cost=floor) for head in library.heads[action]]
                self._heads[action] = tuple(heads)
                _enter(heads, entries)
        self._local: Buckets = {key: Bucket(found) for key, found in entries.items()}

    # Actions

    def label(self, action: int) -> str:
        """Return the label of an action, or the name of a live one."""
        if action >= _LOCAL:
            return self.charged[action][0]
        return self.library.labels[base(action)]

    def heads(self, action: int) -> Tuple[Head, ...]:
        """Return the out-ports of an action."""
        action = base(action)
        return self._heads.get(action) or self.library.heads[action]

    def inputs(self, action: int) -> Tuple[int, ...]:
        """Return what the in-ports of an action demand, in the order written."""
        if action >= 0:
            return self.library.inputs[action] if action < _LOCAL else ()
        return tuple([~each for each in self.library.inputs[~action]])

    def variables(self, action: int) -> Sequence[Tuple[int, ...]]:
        """Return the variables that the in-ports of an action share, in the order written."""
        rule = self.library.rules.get(base(action))
        if rule is None or not rule.variables:
            return ((),) * len(self.inputs(action))
        found: List[Tuple[int, ...]] = [()] * len(rule.premises)
        for step in rule.joins:
            found[step.port] = step.variables
        return found

    def needs(self, action: int) -> Tuple[int, ...]:
        """Return the same, each once."""
        if action >= 0:
            return self.library.needs[action]
        return tuple([~each for each in self.library.needs[~action]])

    def floor(self, action: int) -> int:
        """Return what an action costs at least."""
        action = base(action)
        found = self._floors.get(action)
        return self.library.costs[action] if found is None else found

    def cost(self, action: int, theta: Theta) -> int:
        """Return what an action costs under bindings, if its nodelet that is free is not used."""
        action = base(action)
        if action in self._floors and not self.is_free(action, theta):
            return self.library.costs[action] + self.charges.get(action, 0)
        return self.floor(action)

    def is_free(self, action: int, theta: Theta) -> bool:
        """Whether a nodelet that costs nothing could be this one."""
        action = base(action)
        kept = self.kept.get(action)
        if kept is None:
            return False
        rule = self.library.rules.get(action)
        bound = dict(zip(rule.variables, theta)) if rule else {}
        return all(bound.get(variable, name) == name for variable, name in kept.items())

    # Demands

    def pattern(self, number: int) -> Pattern:
        """Return the pattern of a demand."""
        number = base(number)
        return self._pattern if number == GOAL else self.library.patterns[number]

    def makers(self, number: int) -> Sequence[int]:
        """Return the actions with in-ports that can supply a demand, each once."""
        if self.demand.min_rate or number == GOAL:
            return list(dict.fromkeys([action for action, _ in self.offers(number)]))
        found = self.library.makers_of.get(number)
        if found is None:
            offers = self.library.offers_to(number)
            found = tuple(dict.fromkeys([offer.head.action for offer in offers]))
            self.library.makers_of[number] = found
        if self._excluded:
            return [action for action in found if action not in self._excluded]
        return found

    def offers(self, number: int, known: Known = ()) -> Iterator[Tuple[int, Offer]]:
        """Yield how actions with in-ports can supply a demand; if names are known, some cannot."""
        for offer in self._all_offers(number, known):
            head = offer.head
            if head.action in self._excluded:
                continue
            if not self.demand.min_rate:
                yield head.action, offer
            elif number >= 0:
                yield head.action, offer
                yield ~head.action, offer
            elif not head.rate:
                yield ~head.action, offer
            elif head.rate >= self.demand.min_rate:
                yield head.action, offer

    def _all_offers(self, number: int, known: Known) -> Tuple[Offer, ...]:
        number = base(number)
        if number != GOAL:
            if any(known) and self.library.many(number) is not None:
                return self.library.offers(self.library.patterns[number], known)
            return self.library.offers_to(number)
        if self._offers is None:
            self._offers = self.library.offers(self._pattern)
        return self._offers

    def many(self, number: int) -> Optional[int]:
        """Return what very many makers that may supply a demand cost at least; None if few may."""
        number = base(number)
        found = None if number == GOAL else self.library.many(number)
        return found if found is None else min([found, *self._floors.values()])

    def facts(self, number: int, known: Known) -> Iterator[Tuple[Head, Theta]]:
        """Yield what supplies a demand and needs nothing, the cheapest first."""
        pattern = self.pattern(number)
        match = matcher(pattern, known, self.names)
        heads: Iterable[Head] = candidates(self.library.facts, pattern, known, self.names)
        if self._local:
            local = candidates(self._local, pattern, known, self.names, is_local=True)
            heads = heapq.merge(local, self._unchanged(heads), key=_cost)
        for head in heads:
            if head.action in self._excluded or not head.goes_with(pattern.datatype):
                continue
            if number < 0 and head.rate and head.rate < self.demand.min_rate:
                continue
            for theta in match(head.atoms):
                yield head, theta

    def cheapest_fact(self, number: int) -> Optional[Head]:
        """Return the cheapest supplier of a demand that needs nothing."""
        if not self._local and 0 <= number < GOAL:
            cheapest = self.library.cheapest
            if number not in cheapest:
                pattern = self.pattern(number)
                match = matcher(pattern, (), self.names)
                cheapest[number] = next(
                    (
                        head
                        for head in candidates(self.library.facts, pattern, (), self.names)
                        if head.goes_with(pattern.datatype) and match(head.atoms)
                    ),
                    None,
                )
            found = cheapest[number]
            if found is None or found.action not in self._excluded:
                return found
        return next((head for head, _ in self.facts(number, ())), None)

    def source(self, action: int, theta: Theta, node: Need) -> Head:
        """Return the out-port with which an instance supplies a node: of several the soonest."""
        heads = self.heads(action)
        if len(heads) == 1:
            return heads[0]
        pattern = self.pattern(node.number)
        found = []
        for head in heads:
            if not head.goes_with(pattern.datatype):
                continue
            if node.number < 0 and action >= 0 and not self._is_fast(action, head):
                continue
            atoms = [atom.ground(theta) for atom in head.atoms]
            if node.theta in solutions(atoms, pattern, self.names):
                found.append(head)
        return min(found, key=lambda head: head.latency)

    def alike(self, pattern: Pattern) -> Iterator[Head]:
        """Yield what may supply a pattern if less were demanded, excluded or not; some may not."""
        names = self.names
        loose = pattern._replace(datatype="", types=(NO_TYPES,) * len(pattern.types))
        library = self.library
        found = itertools.chain(
            candidates(library.facts, loose, (), names),
            candidates(library.makers, loose, (), names),
            candidates(self._local, loose, (), names, is_local=True),
        )
        yield from itertools.islice(found, _MOST_ALIKE)
        for each in self._unusable:
            yield self._head(*each)

    def is_excluded(self, head: Head) -> bool:
        """Whether an out-port must not be used."""
        return head.source.label in self._exclude

    def is_paused(self, head: Head) -> bool:
        """Whether nothing new is to be made for an out-port."""
        return not isinstance(head.source, Live) and head.source.label in self._paused

    def is_met(self, head: Head) -> bool:
        """Whether a supplier is as good as any."""
        return not head.cost and (self.limit is None or not head.latency)

    # Inside

    def _is_fast(self, action: int, head: Head) -> bool:
        """Whether an out-port of an action whose in-ports need not be fast is so."""
        if not head.rate:
            return not (action < _LOCAL and self.library.inputs[action])
        return head.rate >= self.demand.min_rate

    def _unchanged(self, heads: Iterable[Head]) -> Iterator[Head]:
        changed = self._floors
        return (head for head in heads if head.action not in changed)

    def _add_streams(
        self,
        streams: Sequence[TaggedStream],
        charges: Mapping[str, int],
        feeders: Mapping[str, FrozenSet[str]],
        entries: Dict[Tuple[str, int], Dict[Tuple[Head, Atom], None]],
    ) -> None:
        numbers: Dict[str, int] = {}
        for stream, terms in sorted(streams):
            name = stream.nodelet or stream.topic
            action = numbers.setdefault(name, _LOCAL + len(numbers))
            labels = {stream.label, *feeders.get(stream.nodelet, ())}
            charge = sum([charges.get(each, 0) for each in labels])
            head = self._head(stream, terms)._replace(cost=charge, action=action)
            self._heads[action] = (*self._heads.get(action, ()), head)
            self.charged[action] = (name, charge)
            self._floors[action] = charge
            _enter([head], entries)

    def _head(self, stream: Live, terms: Tuple[Term, ...]) -> Head:
        ground = tuple([term for term in terms if term.is_ground])
        return Head(
            0,
            stream,
            _LOCAL,
            tuple(map(str, ground)),
            atoms_of(ground, (), self.names),
            stream.datatype,
            True,
            stream.rate,
            microseconds(stream.latency),
        )


def base(number: int) -> int:
    """Return the number of a demand or an action, fast or not."""
    return number if number >= 0 else ~number


def _cost(head: Head) -> int:
    return head.cost


def _enter(
    heads: Iterable[Head], entries: Dict[Tuple[str, int], Dict[Tuple[Head, Atom], None]]
) -> None:
    for head in heads:
        for atom in head.atoms:
            entries.setdefault((atom.functor, len(atom.args)), {})[head, atom] = None
