# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The search over ground instances, which begins at the goal and passes bound names on.

A *node* is a pattern under bindings of its wanted variables; a *subgoal* is a pattern of which
some of these names are known. A subgoal begins all actions that can supply it. Each asks for its
in-ports one after the other, and the names that supply one of them are known to the next: so a
subgoal is about those individuals alone that the goal can use (F. Bancilhon et al., "Magic sets
and other strange ways to implement logic programs", PODS 1986).

All steps are taken in the order of the least cost of a plan with them: the cost of the way up to
the goal, the known costs of its inputs, and a lower bound for the rest (P. F. Felzenszwalb and D.
McAllester, "The generalized A* architecture", JAIR 29, 2007). So the first that supplies a node is
the end of its cheapest tree.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Callable, Iterator, NamedTuple, Sequence

from dyknow.manager.planning.bounds import Bounds
from dyknow.manager.planning.library import Head, Offer, Operator
from dyknow.manager.planning.patterns import Known, Limit, Pattern, Theta, ground, solutions
from dyknow.manager.planning.request import Need, Request

#: Steps of a budget that one entry of the search's queue takes.
_EFFORT = 200
#: Orders of in-ports that are remembered.
_REMEMBERED = 1_000


@dataclass(eq=False)
class Instance:
    """An action under bindings; a search has one of each.

    Attributes:
        theta: names of its variables.
        needs: the needs of its in-ports, in the order written.
    """

    __slots__ = ("action", "cost", "needs", "theta")
    action: Operator
    theta: Theta
    cost: int
    needs: tuple[Need, ...]

    @property
    def key(self) -> tuple[Operator, Theta]:
        """Equal for equal instances of several searches."""
        return self.action, self.theta


class Subgoal:
    """A pattern of which some names are known.

    Attributes:
        above: least cost of a plan with it, besides its own.
        is_bound: whether it has one node alone.
        is_done: whether nothing more is to be found for it.
        answers: the nodes that were supplied, with their values.
        waiting: the joins that go on with each of them.
        uses: the actions that may supply it, the cheapest last: least cost of a plan, label,
            place, action, and how.
    """

    def __init__(self, pattern: Pattern, known: Known, above: int) -> None:
        self.pattern = pattern
        self.known = known
        self.above = above
        self.is_bound = all(isinstance(each, str) for each in known)
        self.is_done = False
        self.answers: dict[Need, int] = {}
        self.waiting: list[_Join] = []
        self.facts: Iterator[tuple[Head, Theta]] = iter(())
        self.uses: list[tuple[int, str, int, Operator, Offer]] = []


class _Use(NamedTuple):
    """An action that is to supply a subgoal.

    Attributes:
        order: the in-ports in the order of the search.
        rest: for each place of that order, what the in-ports from there on cost at least.
    """

    subgoal: Subgoal
    action: Operator
    offer: Offer
    order: Sequence[int]
    rest: Sequence[int]


class _Join(NamedTuple):
    """An action whose first in-ports are supplied: with names, cost and nodes."""

    use: _Use
    bounds: Known
    value: int
    nodes: tuple[Need, ...]


@lru_cache(maxsize=_REMEMBERED)
def _ordered(shares: tuple[tuple[int, ...], ...], known: tuple[int, ...]) -> Sequence[int]:
    """Order in-ports by their variables, of which some are known."""
    bound = set(known)
    left = list(range(len(shares)))
    order: list[int] = []

    def rank(port: int) -> tuple[bool, int, int]:
        free = sum([each not in bound for each in shares[port]])
        return 0 < free == len(shares[port]), free, port

    while left:
        order.append(min(left, key=rank))
        left.remove(order[-1])
        bound.update(shares[order[-1]])
    return order


class Search:
    """Finds the cheapest tree, or everything that plans of less than some cost can have.

    Attributes:
        goal: the subgoal of the goal.
        value: the cost of each node.
        chosen: its supplier at that cost.
        offers: all that supplies it, if that is collected.
        is_complete: whether the search came to its end, and not to its limit.
        reached: no plan with parts that were not found costs less.
    """

    def __init__(
        self,
        request: Request,
        bounds: Bounds,
        least: dict[Pattern, int],
        below: int | None = None,
    ) -> None:
        """Start the search at the goal.

        Args:
            request: the problem.
            bounds: the reach of the goal.
            least: least costs of the reached patterns; others cannot be supplied.
            below: collect all that a plan which costs less can have. Costs are then the maximum
                over the inputs, not the sum, and no plan costs less than that.
        """
        self._request = request
        self._names = request.names
        self._least = least
        self._combine: Callable[[list[int]], int] = sum if below is None else max
        self._users = bounds.users
        self._below = below
        #: Least cost of a plan besides each pattern, and others; by default that is found.
        self._above: dict[Pattern, int] | None = None
        self._above_others = 0
        if below is not None:
            self._above, self._above_others = bounds.above(least, below)
        self.value: dict[Need, int] = {}
        self.chosen: dict[Need, Instance] = {}
        self.offers: dict[Need, dict[Instance, None]] = {}
        self._subgoals: dict[tuple[Pattern, Known], Subgoal] = {}
        self.is_complete = True
        self.reached = 0
        self._best: dict[Need, int] = {}
        #: The subgoals of each pattern, by the places and names that are known exactly, and types.
        self._listeners: dict[Pattern, dict[Any, dict[Theta, Subgoal]]] = {}
        self._heap: list[tuple[Any, ...]] = []
        self._pushed = 0
        self._instances: dict[tuple[Operator, Theta], Instance] = {}
        known = (None,) * len(request.goal.wanted)
        self.goal = self._ask(request.goal, known, least.get(request.goal, 0))

    def run(self, steps: int, is_all: bool = False) -> int:
        """Search within a budget of steps; return those that are left.

        It ends when the goal is supplied, unless all that supplies it is wanted.
        """
        heap, goal = self._heap, self.goal
        is_all = is_all or self._below is not None
        while heap and (is_all or not goal.answers):
            self.reached = heap[0][0]
            if self._pushed * _EFFORT > steps:
                self.is_complete = False
                break
            *_, go_on, details = heapq.heappop(heap)
            go_on(*details)
        return max(0, steps - self._pushed * _EFFORT)

    def can_be(self, pattern: Pattern) -> bool:
        """Whether a pattern could be supplied if no names were shared."""
        return pattern in self._least or pattern not in self._users

    def answers(self, pattern: Pattern, known: Known) -> list[Need]:
        """Return the nodes that were supplied for a subgoal."""
        found = self._subgoals.get((pattern, known))
        return list(found.answers) if found is not None else []

    def _push(
        self,
        key: int,
        subgoal: Subgoal,
        label: str,
        theta: tuple[str, ...],
        go_on: Callable[..., None],
        *details: Any,
    ) -> None:
        """Put off a step for a subgoal until its turn: the least cost of a plan with it."""
        if self._below is None or key < self._below:
            self._pushed += 1
            entry = (key, subgoal.above, label, theta, self._pushed, go_on, details)
            heapq.heappush(self._heap, entry)

    # Subgoals

    def _ask(self, pattern: Pattern, known: Known, key: int) -> Subgoal:
        """Return a subgoal, which is begun if it is new; no plan that needs it is below a cost."""
        subgoal = self._subgoals.get((pattern, known))
        if subgoal is not None:
            return subgoal
        if self._above is not None:
            above = self._above.get(pattern, self._above_others)
        else:
            above = key - self._least.get(pattern, 0)
        subgoal = self._subgoals[pattern, known] = Subgoal(pattern, known, above)
        places = [at for at, each in enumerate(known) if isinstance(each, str)]
        types = tuple([(at, e) for at, e in enumerate(known) if isinstance(e, frozenset)])
        names: Theta = tuple([known[at] for at in places])  # type: ignore[misc]
        tables = self._listeners.setdefault(pattern, {})
        tables.setdefault((tuple(places), types), {})[names] = subgoal
        if subgoal.is_bound:
            node = Need(pattern, names)
            if node in self.value:
                subgoal.answers[node] = self.value[node]
                subgoal.is_done = self._below is None
                if subgoal.is_done:
                    return subgoal
        subgoal.facts = self._request.facts(pattern, known)
        fact = self._push_fact(subgoal)
        if fact is None or not subgoal.is_bound or not self._request.is_met(pattern, fact):
            self._list_uses(subgoal)
            self._push_use(subgoal)
        return subgoal

    def _push_fact(self, subgoal: Subgoal) -> Head | None:
        head, theta = next(subgoal.facts, (None, ()))
        if head is not None:
            key, label = subgoal.above + head.cost, head.action.label
            self._push(key, subgoal, label, theta, self._take_fact, subgoal, head, theta)
        return head

    def _take_fact(self, subgoal: Subgoal, head: Head, theta: Theta) -> None:
        if subgoal.is_done:
            return
        instance = self._instance(head.action, (), head.cost, ())
        self._supply(instance, subgoal, Need(subgoal.pattern, theta), head.cost)
        if not subgoal.is_done:
            self._push_fact(subgoal)

    def _list_uses(self, subgoal: Subgoal) -> None:
        request, least, users, combine = (self._request, self._least, self._users, self._combine)
        for action, offer in request.offers(subgoal.pattern, subgoal.known):
            floors = [least.get(each, -1 if each in users else 0) for each in action.inputs]
            if -1 not in floors:
                key = subgoal.above + request.floor(action) + combine(floors)
                if self._below is None or key < self._below:
                    place = len(subgoal.uses)
                    subgoal.uses.append((key, action.label, place, action, offer))
        subgoal.uses.sort(reverse=True)

    def _push_use(self, subgoal: Subgoal) -> None:
        if subgoal.uses:
            key, label = subgoal.uses[-1][:2]
            self._push(key, subgoal, label, (), self._begin_use, subgoal)

    def _begin_use(self, subgoal: Subgoal) -> None:
        """Expand the cheapest action that is left to supply a subgoal."""
        if subgoal.is_done:
            return
        key, _, _, action, offer = subgoal.uses.pop()
        self._push_use(subgoal)
        bounds = self.passed(subgoal.pattern, subgoal.known, offer)
        if bounds is not None:
            order = self.order(action, bounds)
            floors = [self._least.get(action.inputs[port], 0) for port in order]
            rest = [self._combine([*floors[at:], 0]) for at in range(len(floors) + 1)]
            self._go_on(_Join(_Use(subgoal, action, offer, order, rest), bounds, 0, ()), key)

    def passed(self, pattern: Pattern, known: Known, offer: Offer) -> Known | None:
        """Return the constraints on an action's variables, or None if it cannot supply this."""
        names = self._names
        if offer.places is None and offer.head.is_ground:
            found = solutions(offer.head.atoms, pattern, names)
            if not any(names.agrees(theta, known) for theta in found):
                return None
        bounds = list(map(names.limit, offer.types))
        for place, each in zip(offer.places or (), known):
            if isinstance(place, int):
                bounds[place] = names.both(bounds[place], each)
            elif not names.agrees((place,), (each,)):
                return None
        return None if "" in bounds else tuple(bounds)

    # Joins

    def _go_on(self, join: _Join, key: int) -> None:
        """Ask for the next in-port of an action."""
        use, bounds = join.use, join.bounds
        if use.subgoal.is_done:
            return
        port = use.order[len(join.nodes)]
        known = tuple([bounds[each] for each in use.action.shares[port]])
        subgoal = self._ask(use.action.inputs[port], known, key)
        if not subgoal.is_done:
            subgoal.waiting.append(join)
        for node, value in subgoal.answers.items():
            self._extend(join, node, value)

    def order(self, action: Operator, bounds: Known) -> Sequence[int]:
        """Return the order of an action's in-ports: each time the one of which most is known."""
        if len(action.shares) < 2:
            return range(len(action.shares))
        known = tuple([at for at, each in enumerate(bounds) if self._is_one(each)])
        return _ordered(action.shares, known)

    def _is_one(self, limit: Limit) -> bool:
        """Whether the constraint of a variable leaves one name at most."""
        if isinstance(limit, frozenset):
            return len(self._names.below(limit)) < 2
        return limit is not None

    def _extend(self, join: _Join, node: Need, value: int) -> None:
        """Go on with a join when its next in-port is supplied."""
        use, bounds, before, nodes = join
        more = list(bounds)
        for variable, name in zip(use.action.shares[use.order[len(nodes)]], node.theta):
            more[variable] = name
        total = self._combine([before, value])
        joined = _Join(use, tuple(more), total, (*nodes, node))
        if len(joined.nodes) < len(use.order):
            rest = self._combine([total, use.rest[len(joined.nodes)]])
            key = use.subgoal.above + self._request.floor(use.action) + rest
            theta = tuple([each for each in more if isinstance(each, str)])
            self._push(key, use.subgoal, use.action.label, theta, self._go_on, joined, key)
        else:
            self._finish(joined)

    def _finish(self, join: _Join) -> None:
        """Let an action under bindings wait for its turns to supply nodes."""
        subgoal, action, offer, order, _ = join.use
        theta: Theta = join.bounds  # type: ignore[assignment]
        cost = self._request.cost(action, theta)
        nodes = tuple([node for _, node in sorted(zip(order, join.nodes), key=lambda e: e[0])])
        instance = self._instance(action, theta, cost, nodes)
        value = join.value + cost
        found: Sequence[Theta]
        if offer.places is not None:
            found = [tuple([e if isinstance(e, str) else theta[e] for e in offer.places])]
        else:
            atoms = [ground(atom, theta) for atom in offer.head.atoms]
            found = solutions(atoms, subgoal.pattern, self._names)
        for each in found:
            node = Need(subgoal.pattern, each)
            if not self._names.agrees(each, subgoal.known):
                continue
            if self._below is None:
                if node in subgoal.answers or self._best.get(node, value) < value:
                    continue
                self._best[node] = value
            key = subgoal.above + value
            details = instance, subgoal, node, value
            self._push(key, subgoal, action.label, theta, self._supply, *details)

    def _instance(
        self, action: Operator, theta: Theta, cost: int, needs: tuple[Need, ...]
    ) -> Instance:
        key = action, theta
        found = self._instances.get(key)
        if found is None:
            found = self._instances[key] = Instance(action, theta, cost, needs)
        return found

    def _supply(self, instance: Instance, subgoal: Subgoal, node: Need, value: int) -> None:
        """Supply a node of a subgoal; the first time is the cheapest."""
        if self._below is not None:
            self.offers.setdefault(node, {})[instance] = None
        if node in self.value:
            if node not in subgoal.answers:
                self._answer(subgoal, node, self.value[node])
            return
        self.value[node] = value
        self.chosen[node] = instance
        theta = node.theta
        for (places, types), table in self._listeners[node.pattern].items():
            found = table.get(tuple([theta[at] for at in places]))
            if found is not None and all(self._names.fits(theta[at], each) for at, each in types):
                self._answer(found, node, value)

    def _answer(self, subgoal: Subgoal, node: Need, value: int) -> None:
        """Let the joins that wait for a subgoal go on with a node of it."""
        subgoal.answers[node] = value
        waiting = subgoal.waiting
        if subgoal.is_bound:
            subgoal.waiting = []
            subgoal.is_done = self._below is None
        for join in waiting:
            self._extend(join, node, value)
