# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which names can matter: a semi-join of what is supplied, before anything is searched.

Upwards from what is supplied it is collected which names the variables of demands can stand for;
downwards from the goal, which of them others can be joined with. What a rule's in-ports share is
narrowed by each of them. So a demand for one robot does not combine the cameras of all others.
D. Maier, "The Theory of Relational Databases", 1983, has the theory of semi-joins.
"""

from __future__ import annotations

from typing import Dict, Iterator, List, Sequence, Tuple, Union

from dyknow.manager.planning.network import Network
from dyknow.manager.planning.patterns import Domain, Domains, Theta
from dyknow.manager.planning.reach import Reach

#: Names of one variable beyond which it is taken to stand for any.
_MOST_NAMES = 1_000
#: How often each in-port of a rule narrows what it shares with others.
_ROUNDS = 2
#: How often more is wanted of one demand before it is taken to be wanted with any name.
_MOST_GROWTHS = 5

_Place = Union[int, str, None]
"""A variable of a rule, a name, or something that is not known."""


def useful_names(network: Network, reach: Reach) -> Dict[int, Domains]:
    """Return which names demands are to be supplied with; no plan needs others.

    Args:
        network: the library.
        reach: what the goal can reach, specialised.
    """
    return _Narrowing(network, reach).run()


class _Narrowing:
    def __init__(self, network: Network, reach: Reach) -> None:
        self._network = network
        self._reach = reach
        #: For each demand the rules that supply it, and what they put in the wanted places.
        self._rules: Dict[int, List[Tuple[int, Sequence[_Place]]]] = {}
        for rule in sorted(network.joined.intersection(reach.serves)):
            for demand in reach.serves[rule]:
                self._rules.setdefault(demand, []).extend(self._heads(rule, demand))
        self._live = {each.demand for each in reach.live}
        self._rows: Dict[int, List[Theta]] = {}
        self._can: Dict[int, Domains] = {}
        self._may: Dict[int, Domains] = {}
        self._growths: Dict[int, int] = {}

    def run(self) -> Dict[int, Domains]:
        network, reach = self._network, self._reach
        for demand in reach.above:
            self._can[demand] = self._supplied(demand)
        is_new = True
        while is_new:
            is_new = False
            for demand in reversed(list(reach.above)):  # first what others need
                for rule, places in self._rules.get(demand, ()):
                    found = _united(self._can[demand], self._made(rule, places))
                    is_new = is_new or found != self._can[demand]
                    self._can[demand] = found
        waiting = [reach.goal]
        for action in reach.serves:
            if action not in network.joined:
                waiting += network.needs[action]
        for demand in waiting:
            self._may[demand] = (None,) * len(network.patterns[demand].wanted)
        for demand in waiting:  # grows meanwhile
            for rule, places in self._rules.get(demand, ()):
                waiting += self._narrow(rule, places, self._may[demand])
        return self._may

    def _heads(self, rule: int, demand: int) -> Iterator[Tuple[int, Sequence[_Place]]]:
        """Yield what out-ports put in the wanted places: variables, names, or unknown things."""
        unknown = [None] * len(self._network.patterns[demand].wanted)
        for offer in self._network.offers(demand, rule):
            yield rule, unknown if offer.places is None else offer.places

    def _thetas(self, demand: int) -> Iterator[Theta]:
        """Yield what is supplied without a rule."""
        for offers in self._network.found[demand].values():
            for offer in offers:
                yield from offer.solutions or ()

    def _supplied(self, demand: int) -> Domains:
        wanted = self._network.patterns[demand].wanted
        if not wanted or demand in self._live:
            return (None,) * len(wanted)
        found: List[Dict[str, None]] = [{} for _ in wanted]
        for theta in self._thetas(demand):
            for names, name in zip(found, theta):
                names[name] = None
            if min(map(len, found)) > _MOST_NAMES:
                break
        return tuple([_domain(names) for names in found])

    def _made(self, rule: int, places: Sequence[_Place]) -> Domains:
        """Return what a rule can put in the wanted places."""
        domains = self._joined(rule, [None] * len(self._network.rules[rule].variables))
        return tuple([_at(place, domains) for place in places])

    def _joined(self, rule: int, domains: List[Domain]) -> List[Domain]:
        """Narrow the variables of a rule by what each in-port can be supplied with."""
        inputs = self._network.inputs[rule]
        for step in self._network.rules[rule].joins:
            for variable, names in zip(step.variables, self._can[inputs[step.port]]):
                domains[variable] = _common(domains[variable], names)
        return domains

    def _narrow(self, rule: int, places: Sequence[_Place], wanted: Domains) -> List[int]:
        """Pass on what is wanted of a rule; return the demands of which more is wanted now."""
        network = self._network
        domains: List[Domain] = [None] * len(network.rules[rule].variables)
        for place, names in zip(places, wanted):
            if isinstance(place, int):
                domains[place] = _common(domains[place], names)
        domains = self._joined(rule, domains)
        steps, inputs = network.rules[rule].joins, network.inputs[rule]
        for _ in range(_ROUNDS):
            for step in steps:
                self._select(inputs[step.port], step.variables, domains)
        if any(names is not None and not names for names in domains):
            return []
        grown = []
        for step in steps:
            need = inputs[step.port]
            more = tuple([domains[each] for each in step.variables])
            known = self._may.get(need)
            if known is not None:
                more = _united(known, more)
            if more != known:
                self._growths[need] = self._growths.get(need, 0) + 1
                if self._growths[need] > _MOST_GROWTHS:
                    more = (None,) * len(more)
                self._may[need] = more
                grown.append(need)
        return grown

    def _select(self, demand: int, variables: Sequence[int], domains: List[Domain]) -> None:
        """Narrow variables that a demand has in common, if no rule supplies it."""
        known = [domains[each] for each in variables]
        chosen = [(at, names) for at, names in enumerate(known) if names is not None]
        if not chosen or len(variables) < 2 or demand in self._rules or demand in self._live:
            return
        if demand not in self._rows:
            self._rows[demand] = list(self._thetas(demand))
        rows = self._rows[demand]
        for at, names in chosen:
            rows = [theta for theta in rows if theta[at] in names]
        for at, variable in enumerate(variables):
            domains[variable] = _domain(dict.fromkeys([theta[at] for theta in rows]))


def _domain(names: Dict[str, None]) -> Domain:
    return frozenset(names) if len(names) <= _MOST_NAMES else None


def _at(place: _Place, domains: Sequence[Domain]) -> Domain:
    if isinstance(place, str):
        return frozenset((place,))
    return None if place is None else domains[place]


def _common(one: Domain, other: Domain) -> Domain:
    if one is None or other is None:
        return one if other is None else other
    return one & other


def _united(some: Domains, more: Domains) -> Domains:
    return tuple(
        [
            None if one is None or other is None else _domain(dict.fromkeys([*one, *other]))
            for one, other in zip(some, more)
        ]
    )
