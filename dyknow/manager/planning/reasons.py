# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Why there is no plan: the demands that nothing meets, each with the cause that holds.

From the goal on, the subgoals are followed that were not supplied. One that no action can supply
is looked at again with less demanded: without what is excluded, without types of its variables,
without a rate, without a ROS type. The fewest of these that stand in the way are the cause.
"""

from __future__ import annotations

import itertools
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple, Union

from dyknow.manager.planning.library import Head
from dyknow.manager.planning.patterns import Atom, Known, Names, Pattern, Types
from dyknow.manager.planning.problem import Demand, NoPlan, Obstacle
from dyknow.manager.planning.request import Request, base
from dyknow.manager.planning.search import Search
from dyknow.manager.specifications.tags import Term, types_of

#: Answers of one in-port with which the next one is looked at, and obstacles that are told.
_MOST_TOLD = 10
#: Names, labels and the like in one sentence.
_MOST_NAMED = 3
_EXCLUDED, _PAUSED, _TYPE, _RATE, _DATATYPE = range(5)
_CAUSES = (_EXCLUDED, _PAUSED, _TYPE, _RATE, _DATATYPE)


class _Open(NamedTuple):
    """A demand that nothing meets.

    Attributes:
        number: its number.
        known: what is known of its names.
        demand: it, as people write it.
        rest: what cannot be written so, as sentences.
    """

    number: int
    known: Known
    demand: Demand
    rest: Tuple[str, ...] = ()


def no_plan(request: Request, search: Search) -> NoPlan:
    """Tell why there is no plan."""
    if not search.is_complete:
        return NoPlan(request.demand, (), False, is_cut_short=True)
    missing: Dict[Demand, None] = {}
    obstacles: Dict[Obstacle, None] = {}
    for each in _leaves(request, search):
        causes = each.rest + _Causes(request, each).find()
        if causes:
            obstacles[Obstacle(each.demand, causes)] = None
        else:
            missing[each.demand] = None
    return NoPlan(
        request.demand,
        tuple(sorted(missing, key=str)),
        not missing and not obstacles,
        obstacles=tuple(sorted(obstacles, key=str)[:_MOST_TOLD]),
    )


def _leaves(request: Request, search: Search) -> Iterator[_Open]:
    """Yield the demands that no action can supply, and that have to be met."""
    goal = _Open(request.goal, search.goal.known, request.demand)
    seen = {goal[:2]}
    waiting = [goal]
    for each in waiting:  # grows meanwhile
        is_leaf = True
        for action, offer in request.offers(each.number, each.known):
            if (action < 0) > (each.number < 0):
                continue  # as the same action that need not be fast
            bounds = search.passed(each.known, offer)
            if bounds is None:
                continue
            is_leaf = False
            for below in _unmet(request, search, action, bounds):
                if below[:2] not in seen:
                    seen.add(below[:2])
                    waiting.append(below)
        if is_leaf:
            yield each


def _unmet(request: Request, search: Search, action: int, bounds: Known) -> List[_Open]:
    """Return what the in-ports of an action lack."""
    library, inputs = request.library, request.inputs(action)
    rule = library.rules.get(base(action))
    variables = request.variables(action)

    def opened(port: int, bounds: Known) -> _Open:
        known = tuple([bounds[each] for each in variables[port]])
        rest: List[str] = []
        terms: Sequence[Term]
        if rule is None:
            terms, datatype = library.written[base(inputs[port])]
        else:
            _, terms, datatype = rule.premises[port]
            known_of = {
                variable: _joined(each, types, request.names)
                for variable, each, types in zip(rule.variables, bounds, rule.types)
            }
            terms, rest = _shown(terms, known_of, request.names)
        rate = request.demand.min_rate if inputs[port] < 0 else 0.0
        return _Open(inputs[port], known, Demand(frozenset(terms), datatype, rate), tuple(rest))

    never = [opened(port, bounds) for port, each in enumerate(inputs) if not search.can_be(each)]
    if never:
        return never
    found: List[_Open] = []
    joins = [bounds]
    for port in search.order(action, bounds):
        more: List[Known] = []
        for each in joins[:_MOST_TOLD]:
            below = opened(port, each)
            answers = search.answers(below.number, below.known)
            if not answers:
                found.append(below)
            for node in answers[:_MOST_TOLD]:
                names = list(each)
                for variable, name in zip(variables[port], node.theta):
                    names[variable] = name
                more.append(tuple(names))
        joins = more
    return found


def _joined(known: Union[None, str, Types], types: Types, names: Names) -> Union[str, Types]:
    """Return what is known of a variable together with its types."""
    if isinstance(known, frozenset):
        if len(known) == 1 and known.issuperset(names.below(known)):
            return next(iter(known))  # nothing else is that
        return known | types
    return known or types


def _shown(
    terms: Sequence[Term], known: Mapping[str, Union[str, Types]], names: Names
) -> Tuple[List[Term], List[str]]:
    """Write what is known of variables into terms, as people write it.

    Returns:
        The terms, and what they have no place for.
    """
    bound = {each: names.written(name) for each, name in known.items() if isinstance(name, str)}
    own = types_of(terms)
    left: Dict[str, List[str]] = {}
    for variable, more in known.items():
        if isinstance(more, frozenset) and any(variable in term.args for term in terms):
            said = frozenset(map(names.canonical, own.get(variable, ())))
            left[variable] = sorted(names.narrowed(more | said))
    wanted = {variable: list(types) for variable, types in left.items()}
    found = []
    for term in terms:
        types = list(term.types or ("",) * len(term.args))
        for at, arg in enumerate(term.args):
            if wanted.get(arg):
                types[at] = names.written(left[arg].pop(0) if left[arg] else wanted[arg][0])
        found.append(term._replace(types=tuple(types) if any(types) else ()).substitute(bound))
    rest = [
        f"{variable} has to be a {' and a '.join(map(names.written, wanted[variable]))}"
        for variable, types in sorted(left.items())
        if types
    ]
    return found, rest


class _Causes:
    """Finds out why nothing supplies a demand."""

    def __init__(self, request: Request, demand: _Open) -> None:
        self._request = request
        self._open = demand
        self._names: Names = request.names
        self._pattern: Pattern = request.pattern(demand.number)

    def find(self) -> Tuple[str, ...]:
        """Return the causes as sentences; nothing if nothing like it is supplied."""
        heads = self._alike()
        best: Sequence[int] = ()
        chosen: List[Head] = []
        for count in range(1, len(_CAUSES) + 1):
            for causes in itertools.combinations(_CAUSES, count):
                chosen = [head for head, failing in heads if failing <= {*causes}]
                if chosen:
                    best = causes
                    break
            if chosen:
                break
        return tuple([self._sentence(cause, chosen) for cause in best])

    def _alike(self) -> List[Tuple[Head, Set[int]]]:
        """Return what would supply it if less were demanded, each with what is in the way."""
        request, pattern = self._request, self._pattern
        found = []
        for head in request.alike(pattern):
            matched = self._matches(head)
            if matched is None:
                continue
            failing = set()
            if matched:
                failing.add(_TYPE)
            if request.is_excluded(head):
                failing.add(_EXCLUDED)
            elif request.is_paused(head):
                failing.add(_PAUSED)
            if not head.goes_with(pattern.datatype):
                failing.add(_DATATYPE)
            if self._open.number < 0 and head.rate and head.rate < request.demand.min_rate:
                failing.add(_RATE)
            found.append((head, failing))
        return found

    def _matches(self, head: Head) -> Optional[Dict[str, Types]]:
        """Return the names in an out-port that lack a type; None if other names are demanded."""
        demanded = self._pattern.atoms
        best: Optional[Dict[str, Types]] = None
        for supplied in itertools.product(head.atoms, repeat=len(demanded)):
            lacking = self._way(head, list(zip(supplied, demanded)))
            if lacking is not None and (best is None or len(lacking) < len(best)):
                best = lacking
        return best

    def _way(self, head: Head, pairs: Sequence[Tuple[Atom, Atom]]) -> Optional[Dict[str, Types]]:
        """Match atoms without regard to types of variables; return the names that lack these."""
        names, types = self._names, self._pattern.types
        for supplied, demanded in pairs:
            if len(supplied.args) != len(demanded.args):
                return None
            if not names.subsumes(demanded.functor, supplied.functor):
                return None
        known = dict(zip(self._pattern.wanted, self._open.known))
        bound = {each: name for each, name in known.items() if isinstance(name, str)}
        own: Dict[int, str] = {}  # of the out-port's action
        arguments = [args for one, other in pairs for args in zip(one.args, other.args)]
        for have, want in arguments * 2:  # at first not all that are the same are known
            name = own.get(have) if isinstance(have, int) else have
            if isinstance(want, str):
                if name is not None and not names.subsumes(want, name):
                    return None
                name = want if name is None and names.is_plain else name
            else:
                name = bound.get(want) if name is None else name
                if name is not None and bound.setdefault(want, name) != name:
                    return None
            if isinstance(have, int) and name is not None:
                own[have] = name
        rule = self._request.library.rules.get(head.action)
        for variable in {have for have, _ in arguments if isinstance(have, int)}:
            assert rule is not None
            needed = rule.types[variable].union(
                [want for have, want in arguments if have == variable and isinstance(want, str)]
            )
            if variable in own:
                if not names.fits(own[variable], needed):
                    return None
            elif needed and not names.below(needed):
                return None
        lacking: Dict[str, Types] = {}
        for variable, name in bound.items():
            more = known.get(variable)
            if isinstance(more, frozenset) and not names.fits(name, more):
                return None
            if not names.fits(name, types[variable]):
                lacking[name] = frozenset(
                    each for each in types[variable] if not names.subsumes(each, name)
                )
        return lacking

    def _sentence(self, cause: int, heads: Sequence[Head]) -> str:
        labels = sorted({head.source.label for head in heads})
        if cause == _EXCLUDED:
            return f"{_listed(labels)} {'is' if len(labels) == 1 else 'are'} excluded"
        if cause == _PAUSED:
            return f"no new nodelet of {_listed(labels)} is made now"
        if cause == _RATE:
            fastest = max([head.rate for head in heads])
            return f"it is stated at {fastest:g} Hz, below {self._request.demand.min_rate:g} Hz"
        if cause == _DATATYPE:
            kinds = sorted({head.datatype for head in heads})
            return f"it is a {_listed(kinds)}, not a {self._pattern.datatype}"
        lacking: Dict[str, Types] = {}
        for head in heads:
            lacking.update(self._matches(head) or {})
        said = []
        for name in sorted(lacking)[:_MOST_NAMED]:
            wanted = " and ".join(sorted(map(self._names.written, lacking[name])))
            kinds = self._names.kinds(name)
            shown = self._names.written(name)
            if kinds:
                said.append(f"{shown} is a {' and '.join(kinds)}, not a {wanted}")
            else:
                said.append(f"{shown} is not known to be a {wanted}")
        return "; ".join(said)


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more
