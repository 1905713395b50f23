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
from functools import lru_cache
from operator import itemgetter
from typing import Any, Callable, Iterable, Iterator, NamedTuple, Sequence, Tuple

from dyknow.manager.planning.and_or_graph import AndOrGraph, Instance, Node, Reach
from dyknow.manager.planning.library import Offer, Operator
from dyknow.manager.planning.patterns import Known, Pattern, Theta, ground, solutions

#: Steps of a budget that one entry of the search's queue takes.
_EFFORT = 200
#: Orders of in-ports that are remembered.
_REMEMBERED = 1_000

_Supplier = Tuple[int, Any, Any]
"""A floor of the cost, and a fact with the names that it binds, or an offer and nothing."""


class Subgoal:
    """A pattern of which some names are known."""

    def __init__(self, pattern: Pattern, known: Known, above: int) -> None:
        self.pattern = pattern
        self.known = known
        self.above = above  # least cost of a plan with it, besides its own
        #: Whether it has one node alone.
        self.is_bound = all(isinstance(each, str) for each in known)
        self.is_done = False  # whether nothing more is to be found for it
        self.answers: dict[Node, None] = {}  # the nodes that were supplied
        self.waiting: list[_Join] = []  # the joins that go on with each of them
        #: Its further possible suppliers, the cheapest first.
        self.suppliers: Iterator[_Supplier] = iter(())


class _Use(NamedTuple):
    """An action that is to supply a subgoal."""

    subgoal: Subgoal
    offer: Offer
    order: Sequence[int]  # the in-ports in the order of the search
    #: For each place of that order, the least cost of the in-ports from there on.
    rest: Sequence[int]


_Join = Tuple[_Use, Known, int, Tuple[Node, ...]]
"""An action whose first in-ports are supplied: with names, cost and nodes."""


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
    """Finds the cheapest tree, or everything that plans of less than some cost can have."""

    def __init__(self, reach: Reach, below: int | None = None) -> None:
        """Start at the goal of a reach, whose nodes without a least cost cannot be supplied.

        With ``below`` collect all that a plan which costs less can have. Costs are then the
        maximum over the inputs, not the sum, and no plan costs less than that.
        """
        self._request = request = reach.request
        self._names = request.names
        self._numbers = reach.numbers
        least = reach.trees[0] if below is None else reach.floors
        self._least = {reach.patterns[node]: cost for node, cost in least.items()}
        self._combine: Callable[[Sequence[int]], int] = sum if below is None else max
        self._below = below
        #: Least cost of a plan besides each pattern, and others; by default that is found.
        self._above: dict[Pattern, int] | None = None
        self._above_others = 0
        if below is not None:
            self._above, self._above_others = reach.above(below)
        #: The nodes and instances that were found; with their makers, if these are collected.
        self.graph = AndOrGraph(request)
        self.value: dict[Node, int] = {}  # the cost of each node that was supplied
        self.way: dict[Node, Instance] = {}  # its supplier at that cost
        self._nodes: dict[tuple[Pattern, Theta], Node] = {}
        self._instances: dict[tuple[Operator, Theta], Instance] = {}
        self._subgoals: dict[tuple[Pattern, Known], Subgoal] = {}
        self._uses: dict[Pattern, list[_Supplier]] = {}
        self.is_complete = True  # whether the search came to its end, and not to its limit
        self.reached = 0  # no plan with parts that were not found costs less
        self._best: dict[Node, int] = {}
        self._made: set[tuple[Instance, Node]] = set()
        self._heap: list[tuple[Any, ...]] = []
        self._pushed = 0
        known = (None,) * len(request.goal.wanted)
        if not known:
            self._node(request.goal, ())
        #: The subgoal of the goal.
        self.goal = self._ask(request.goal, known, self._least.get(request.goal, 0))

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
            _, _, _, go_on, details = heapq.heappop(heap)
            go_on(self, *details)
        return max(0, steps - self._pushed * _EFFORT)

    def can_be(self, pattern: Pattern) -> bool:
        """Whether a pattern could be supplied if no names were shared."""
        return pattern in self._least or pattern not in self._numbers

    def answers(self, pattern: Pattern, known: Known) -> list[Theta]:
        """Return the names with which a subgoal was supplied."""
        found = self._subgoals.get((pattern, known))
        return [self.graph.names[node] for node in found.answers] if found is not None else []

    def _push(self, key: int, above: int, go_on: Callable[..., None], *details: Any) -> None:
        """Put off a step until its turn: the least cost of a plan with it."""
        if self._below is None or key < self._below:
            self._pushed += 1
            heapq.heappush(self._heap, (key, above, self._pushed, go_on, details))

    def _node(self, pattern: Pattern, names: Theta) -> Node:
        key = pattern, names
        node = self._nodes.get(key)
        if node is None:
            node = self._nodes[key] = self.graph.add_node(pattern, names)
        return node

    def _instance(
        self, action: Operator, theta: Theta, cost: int, needs: tuple[Node, ...]
    ) -> Instance:
        key = action, theta
        instance = self._instances.get(key)
        if instance is None:
            instance = self.graph.add_instance(action, theta, cost, needs)
            self._instances[key] = instance
        return instance

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
        if subgoal.is_bound:
            node = self._nodes.get((pattern, known), -1)  # type: ignore[arg-type]
            if node in self.value:
                subgoal.answers[node] = None
                subgoal.is_done = self._below is None
                if subgoal.is_done:
                    return subgoal
        subgoal.suppliers = iter(self._suppliers(subgoal))
        self._advance(subgoal)
        return subgoal

    def _suppliers(self, subgoal: Subgoal) -> Iterable[_Supplier]:
        """Return the possible suppliers of a subgoal, the cheapest first."""
        request, pattern, known = self._request, subgoal.pattern, subgoal.known
        facts = ((head.cost, head, theta) for head, theta in request.facts(pattern, known))
        first = next(facts, None)
        if first is None:
            return self._uses_of(pattern, known)
        if subgoal.is_bound and request.is_met(pattern, first[1]):
            return (first,)
        return heapq.merge((first,), facts, self._uses_of(pattern, known), key=itemgetter(0))

    def _uses_of(self, pattern: Pattern, known: Known) -> list[_Supplier]:
        """List the actions that may supply a pattern."""
        is_crowd = any(known) and self._request.crowd(pattern) is not None
        found = None if is_crowd else self._uses.get(pattern)
        if found is None:
            found = []
            for offer in self._request.offers(pattern, known if is_crowd else ()):
                action = offer.action
                if all(map(self.can_be, action.inputs)):
                    floors = [self._least.get(each, 0) for each in action.inputs]
                    floor = self._request.floor(action) + self._combine(floors)
                    found.append((floor, offer, None))
            found.sort(key=lambda use: (use[0], use[1].action.label))
            if not is_crowd:
                self._uses[pattern] = found
        return found

    def _advance(self, subgoal: Subgoal) -> None:
        """Let the next supplier of a subgoal wait for its turn."""
        found = next(subgoal.suppliers, None)
        if found is not None:
            key = subgoal.above + found[0]
            self._push(key, subgoal.above, Search._begin, subgoal, key, found)

    def _begin(self, subgoal: Subgoal, key: int, supplier: _Supplier) -> None:
        """Take a fact, or begin an action."""
        if subgoal.is_done:
            return
        cost, found, theta = supplier
        if theta is not None:
            instance = self._instance(found.action, (), cost, ())
            self._supply(subgoal, instance, self._node(subgoal.pattern, theta), cost)
            if not subgoal.is_done:
                self._advance(subgoal)
            return
        self._advance(subgoal)
        bounds = self.passed(subgoal.pattern, subgoal.known, found)
        if bounds is not None:
            order = self.order(found.action, bounds)
            floors = [self._least.get(found.action.inputs[port], 0) for port in order]
            rest = [self._combine([*floors[at:], 0]) for at in range(len(floors) + 1)]
            self._go_on((_Use(subgoal, found, order, rest), bounds, 0, ()), key)

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
        use, bounds, _, nodes = join
        if use.subgoal.is_done:
            return
        port = use.order[len(nodes)]
        known = tuple([bounds[each] for each in use.offer.action.shares[port]])
        subgoal = self._ask(use.offer.action.inputs[port], known, key)
        if not (subgoal.is_bound and subgoal.answers):
            subgoal.waiting.append(join)
        for node in list(subgoal.answers):
            self._extend(join, node)

    def order(self, action: Operator, bounds: Known) -> Sequence[int]:
        """Return the order of an action's in-ports: each time the one of which most is known."""
        if len(action.shares) < 2:
            return range(len(action.shares))
        known = tuple([at for at, each in enumerate(bounds) if self._names.is_one(each)])
        return _ordered(action.shares, known)

    def _extend(self, join: _Join, node: Node) -> None:
        """Go on with a join when its next in-port is supplied."""
        use, bounds, value, nodes = join
        combine, shares, inputs = self._combine, use.offer.action.shares, use.offer.action.inputs
        while True:
            more = list(bounds)
            for variable, name in zip(shares[use.order[len(nodes)]], self.graph.names[node]):
                more[variable] = name
            bounds, nodes = tuple(more), (*nodes, node)
            value = combine((value, self.value[node]))
            if len(nodes) == len(use.order):
                self._complete(use, bounds, value, nodes)  # type: ignore[arg-type]
                return
            port = use.order[len(nodes)]
            known = tuple([bounds[each] for each in shares[port]])
            asked = self._subgoals.get((inputs[port], known))
            if asked is None or not (asked.is_bound and asked.answers):
                break
            node = next(iter(asked.answers))
        rest = combine((value, use.rest[len(nodes)]))
        key = use.subgoal.above + self._request.floor(use.offer.action) + rest
        self._push(key, use.subgoal.above, Search._go_on, (use, bounds, value, nodes), key)

    def _complete(self, use: _Use, theta: Theta, value: int, nodes: tuple[Node, ...]) -> None:
        """Let an action under bindings wait for its turns to supply nodes."""
        subgoal, action, offer = use.subgoal, use.offer.action, use.offer
        if self._request.is_barred(action, theta):
            return
        cost = self._request.cost(action, theta)
        needs = tuple([node for _, node in sorted(zip(use.order, nodes))])
        value += cost
        found: Sequence[Theta]
        if offer.places is not None:
            found = [tuple([e if isinstance(e, str) else theta[e] for e in offer.places])]
        else:
            atoms = [ground(atom, theta) for atom in offer.head.atoms]
            found = solutions(atoms, subgoal.pattern, self._names)
        for each in found:
            if not self._names.agrees(each, subgoal.known):
                continue
            node = self._node(subgoal.pattern, each)
            if self._below is None:
                if node in subgoal.answers or self._best.get(node, value) < value:
                    continue
                self._best[node] = value
            instance = self._instance(action, theta, cost, needs)
            key = subgoal.above + value
            self._push(key, subgoal.above, Search._supply, subgoal, instance, node, value)

    def _supply(self, subgoal: Subgoal, instance: Instance, node: Node, value: int) -> None:
        """Supply a node of a subgoal; the first time is the cheapest."""
        if self._below is not None and (instance, node) not in self._made:
            self._made.add((instance, node))
            self.graph.add_maker(node, instance)
        if node not in self.value:
            self.value[node] = value
            self.way[node] = instance
        if node not in subgoal.answers:
            subgoal.answers[node] = None
            waiting = subgoal.waiting
            if subgoal.is_bound:
                subgoal.waiting = []
                subgoal.is_done = self._below is None
            for join in waiting:
                self._extend(join, node)
