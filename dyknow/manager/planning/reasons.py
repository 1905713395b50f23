# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Why there is no plan: the demands that nothing meets, each with the cause that holds.

From the goal on, the subgoals are followed that were not supplied. One that no action can supply
is looked at again with fewer constraints: without exclusions, without types of its variables,
without a rate, without a ROS type. The fewest of these that stand in the way are the cause.
"""

from __future__ import annotations

import itertools
from typing import Iterator, Mapping, NamedTuple, Sequence

from dyknow.manager.planning.and_or_graph import Draft
from dyknow.manager.planning.library import Head, Operator
from dyknow.manager.planning.patterns import Atom, Known, Names, Pattern, Types
from dyknow.manager.planning.problem import Demand, NoPlan, Obstacle
from dyknow.manager.planning.request import Request
from dyknow.manager.planning.search import Search
from dyknow.manager.specifications.tags import Term, read_tags, types_of

#: Answers of one in-port with which the next one is looked at, and obstacles that are named.
_MOST_NAMED = 10
#: Names, labels and the like in one sentence.
_MOST_LISTED = 3
_CAUSES = _EXCLUDED, _PAUSED, _VERDICT, _TYPE, _RATE, _DATATYPE = range(6)


class _Open(NamedTuple):
    """A demand that nothing meets."""

    pattern: Pattern  # its pattern
    known: Known  # constraints on its names
    demand: Demand  # it, as people write it
    rest: tuple[str, ...] = ()  # what cannot be written so, as sentences
    why: tuple[str, ...] = ()  # the causes, if they are known


def no_plan(search: Search) -> NoPlan:
    """Return the reasons why there is no plan."""
    request = search.graph.request
    if not search.is_complete:
        return NoPlan(request.demand, (), False, is_cut_short=True)
    missing: set[Demand] = set()
    obstacles: set[Obstacle] = set()
    for each in _leaves(search):
        causes = each.rest + (each.why or _causes(request, each))
        if causes:
            obstacles.add(Obstacle(each.demand, causes))
        else:
            missing.add(each.demand)
    return NoPlan(
        request.demand,
        tuple(sorted(missing, key=str)),
        not missing and not obstacles,
        obstacles=tuple(sorted(obstacles, key=str)[:_MOST_NAMED]),
    )


def too_few(draft: Draft) -> NoPlan:
    """Return the reason why there is no plan if all need more nodelets than there are."""
    graph, demand = draft.graph, draft.graph.request.demand
    actions = [graph.actions[each].base for each in graph.surplus(draft.order)]
    labels = sorted({each.label for each in actions if each in graph.request.scarce})
    cause = f"no nodelet of {_listed(labels)} is free, and none is made now"
    return NoPlan(demand, (), False, obstacles=(Obstacle(demand, (cause,)),))


def _leaves(search: Search) -> Iterator[_Open]:
    """Yield the demands that no action can supply, and that have to be met."""
    request = search.graph.request
    goal = _Open(request.goal, search.goal.known, request.demand)
    seen = {goal[:2]}
    waiting = [goal]
    for each in waiting:  # grows meanwhile
        is_leaf = True
        for offer in request.offers(each.pattern, each.known):
            action = offer.action
            if action.slow is not None and each.pattern.slow is None:
                continue  # as the same action that need not be fast
            bounds = search.passed(each.pattern, each.known, offer)
            if bounds is not None:
                unmet = _unmet(search, action, bounds)
                # Else it supplies other names, or its free nodelets have to keep other ones.
                is_other = (
                    offer.places is None and _lacking(request.names, each, offer.head) is None
                )
                is_leaf = is_leaf and (is_other or action.base in request.scarce) and not unmet
                if action.requires and not (is_other or unmet):  # all else that it needs is there
                    why = f"a verdict that {action.label} requires is not TRUE"
                    yield each._replace(why=(why,))
                for below in unmet:
                    if below[:2] not in seen:
                        seen.add(below[:2])
                        waiting.append(below)
        if is_leaf:
            yield each


def _unmet(search: Search, action: Operator, bounds: Known) -> list[_Open]:
    """Return the unmet demands of an action's in-ports."""
    request = search.graph.request

    def opened(port: int, bounds: Known) -> _Open:
        known = tuple([bounds[each] for each in action.shares[port]])
        known_of = {
            variable: _joined(each, types, request.names)
            for variable, each, types in zip(action.variables, bounds, action.types)
        }
        shown, rest = _shown(read_tags(action.in_ports[port].tags), known_of, request.names)
        pattern = action.inputs[port]
        rate = 0.0 if pattern.slow is None else request.demand.min_rate
        return _Open(pattern, known, Demand(frozenset(shown), pattern.datatype, rate), tuple(rest))

    never = [opened(at, bounds) for at, e in enumerate(action.inputs) if not search.can_be(e)]
    if never:
        return never
    found: list[_Open] = []
    joins = [bounds]
    for port in search.order(action, bounds):
        more: list[Known] = []
        for each in joins[:_MOST_NAMED]:
            below = opened(port, each)
            answers = search.answers(below.pattern, below.known)
            if not answers:
                found.append(below)
            for theta in answers[:_MOST_NAMED]:
                names = list(each)
                for variable, name in zip(action.shares[port], theta):
                    names[variable] = name
                more.append(tuple(names))
        joins = more
    return found


def _joined(known: None | str | Types, types: Types, names: Names) -> str | Types:
    """Return the constraint of a variable together with its type."""
    if isinstance(known, frozenset):
        if len(known) == 1 and known.issuperset(names.below(known)):
            return next(iter(known))  # nothing else is that
        return known | types
    return known or types


def _shown(
    terms: Sequence[Term], known: Mapping[str, str | Types], names: Names
) -> tuple[list[Term], list[str]]:
    """Write constraints of variables into terms; returns those without a place in them, too."""
    bound = {each: names.written(name) for each, name in known.items() if isinstance(name, str)}
    own = types_of(terms)
    wanted: dict[str, list[str]] = {}
    for variable, more in known.items():
        if isinstance(more, frozenset) and any(variable in term.args for term in terms):
            said = frozenset(map(names.canonical, own.get(variable, ())))
            wanted[variable] = [*map(names.written, sorted(names.narrowed(more | said)))]
    left = {variable: list(types) for variable, types in wanted.items()}
    found = []
    for term in terms:
        types = list(term.types or ("",) * len(term.args))
        for at, arg in enumerate(term.args):
            if wanted.get(arg):
                types[at] = left[arg].pop(0) if left[arg] else wanted[arg][0]
        found.append(term._replace(types=tuple(types) if any(types) else ()).substitute(bound))
    rest = [
        f"{variable} has to be a {' and a '.join(wanted[variable])}"
        for variable, types in sorted(left.items())
        if types
    ]
    return found, rest


def _causes(request: Request, demand: _Open) -> tuple[str, ...]:
    """Return why nothing supplies a demand, as sentences, if anything like it is supplied."""
    alike = _alike(request, demand)
    for count in range(1, len(_CAUSES) + 1):
        for causes in itertools.combinations(_CAUSES, count):
            chosen = [each for each in alike if each.failing <= {*causes}]
            if chosen:
                return tuple([_sentence(request, demand, cause, chosen) for cause in causes])
    return ()


class _Alike(NamedTuple):
    """An out-port that would supply a demand if less were demanded."""

    head: Head  # the out-port
    lacking: dict[str, Types]  # the names in it that lack types
    failing: set[int]  # the causes that are in the way


def _alike(request: Request, demand: _Open) -> list[_Alike]:
    found = []
    pattern = demand.pattern
    for head in request.alike(pattern):
        lacking = _lacking(request.names, demand, head)
        if lacking is None:
            continue
        label = head.label
        is_excluded = label in request.exclude
        is_new = head.live is None
        checks = {
            _TYPE: bool(lacking),
            _EXCLUDED: is_excluded,
            _PAUSED: not is_excluded and is_new and label in request.paused,
            _VERDICT: not head.action.variables and request.is_barred(head.action, ()),
            _DATATYPE: not head.has_type(pattern),
            _RATE: pattern.slow is not None and 0 < head.port.rate < request.demand.min_rate,
        }
        found.append(_Alike(head, lacking, {cause for cause, fails in checks.items() if fails}))
    return found


def _lacking(names: Names, demand: _Open, head: Head) -> dict[str, Types] | None:
    """Match an out-port without regard to types of the demand's variables.

    Returns the names that lack some of these types; None if other names are demanded.
    """
    atoms = demand.pattern.atoms
    ways = [
        _lacking_so(names, head.action, demand, list(zip(supplied, atoms)))
        for supplied in itertools.product(head.atoms, repeat=len(atoms))
    ]
    found = [each for each in ways if each is not None]
    return min(found, key=len) if found else None


def _lacking_so(
    names: Names, action: Operator, demand: _Open, pairs: Sequence[tuple[Atom, Atom]]
) -> dict[str, Types] | None:
    """Match pairs of atoms, as `_lacking` does."""
    for supplied, demanded in pairs:
        if len(supplied) != len(demanded):
            return None
    known = dict(zip(demand.pattern.wanted, demand.known))
    bound = {each: name for each, name in known.items() if isinstance(name, str)}
    for variable, limit in known.items():
        if isinstance(limit, frozenset) and len(limit) == 1 and [*limit] == [*names.below(limit)]:
            bound[variable] = next(iter(limit))  # an individual: nothing else is that
    own: dict[int, str] = {}  # of the action
    arguments = [args for one, other in pairs for args in zip(one, other)]
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
    for variable in {have for have, _ in arguments if isinstance(have, int)}:
        said = [each for have, each in arguments if have == variable and isinstance(each, str)]
        needed = action.types[variable].union(said)
        if variable in own:
            if not names.fits(own[variable], needed):
                return None
        elif needed and not (names.below(needed) or any(names.fits(e, needed) for e in said)):
            return None
    lacking: dict[str, Types] = {}
    for variable, name in bound.items():
        more = known.get(variable)
        if isinstance(more, frozenset) and not names.fits(name, more):
            return None
        types = demand.pattern.types[variable]
        if not names.fits(name, types):
            lacking[name] = frozenset(each for each in types if not names.subsumes(each, name))
    return lacking


def _sentence(request: Request, demand: _Open, cause: int, alike: Sequence[_Alike]) -> str:
    names, heads = request.names, [each.head for each in alike]
    labels = sorted({head.label for head in heads})
    if cause == _EXCLUDED:
        return f"{_listed(labels)} {'is' if len(labels) == 1 else 'are'} excluded"
    if cause == _PAUSED:
        return f"no nodelet of {_listed(labels)} is free, and none is made now"
    if cause == _VERDICT:
        return f"a verdict that {_listed(labels)} requires is not TRUE"
    if cause == _RATE:
        fastest = max([head.port.rate for head in heads])
        return f"it is stated at {fastest:.12g} Hz, below {request.demand.min_rate:.12g} Hz"
    if cause == _DATATYPE:
        datatypes = sorted({head.port.datatype for head in heads})
        return f"it is a {_listed(datatypes)}, not a {demand.pattern.datatype}"
    lacking = {name: types for each in alike for name, types in each.lacking.items()}
    said = []
    for name in sorted(lacking)[:_MOST_LISTED]:
        wanted = " and ".join(sorted(map(names.written, lacking[name])))
        kinds = " and ".join(names.kinds(name))
        how = f"is a {kinds}, not a" if kinds else "is not known to be a"
        said.append(f"{names.written(name)} {how} {wanted}")
    return "; ".join(said)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_LISTED
    return ", ".join(names[:_MOST_LISTED]) + (f" and {more} more" if more > 0 else "")
