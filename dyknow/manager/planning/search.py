# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The search over ground instances, which begins at the goal and passes bound names on.

A *node* is a demand under bindings of what is wanted of it; a *subgoal* is a demand of which some
of these names are known. A subgoal begins all actions that can supply it. Each asks for its
in-ports one after the other, and what one of them is supplied with is known to the next: so a
subgoal is about those individuals alone that the goal can use (F. Bancilhon et al., "Magic sets
and other strange ways to implement logic programs", PODS 1986).

All steps are taken in the order of what a plan with them costs at least: what its way up to the
goal costs, what is known of its inputs, and a lower bound for the rest (P. F. Felzenszwalb and
D. McAllester, "The generalized A* architecture", JAIR 29, 2007). So the first that supplies a node
is the end of its cheapest tree.
"""

from __future__ import annotations

import heapq
from typing import (
    Any,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from dyknow.manager.planning.bounds import Bounds
from dyknow.manager.planning.library import Head, Offer
from dyknow.manager.planning.patterns import Known, Theta, Types, agrees, solutions
from dyknow.manager.planning.request import Need, Request

#: Steps of a budget that it takes to go on with something.
_EFFORT = 200


class Instance:
    """An action under bindings; a search has one of each.

    Attributes:
        action: its number.
        theta: names of its variables.
        cost: what it costs.
        needs: what its in-ports need, in the order written.
    """

    __slots__ = ("action", "cost", "needs", "theta")

    def __init__(self, action: int, theta: Theta, cost: int, needs: Tuple[Need, ...]) -> None:
        self.action = action
        self.theta = theta
        self.cost = cost
        self.needs = needs

    @property
    def key(self) -> Tuple[int, Theta]:
        """What tells it from others."""
        return self.action, self.theta


class _Subgoal:
    """A demand of which some names are known.

    Attributes:
        above: what a plan with it costs at least besides.
        is_bound: whether it has one node alone.
        is_done: whether nothing more is to be found for it.
        answers: the nodes that were supplied, with their values.
        waiting: the joins that go on with each of them.
        facts: what supplies it and needs nothing.
        uses: the actions that may supply it: least cost of a plan, label, place, number, and how.
    """

    def __init__(self, number: int, known: Known, above: int) -> None:
        self.number = number
        self.known = known
        self.above = above
        self.is_bound = all(type(each) is str for each in known)
        self.is_done = False
        self.answers: Dict[Need, int] = {}
        self.waiting: List[_Join] = []
        self.facts: Iterator[Tuple[Head, Theta]] = iter(())
        self.uses: List[Tuple[int, str, int, int, Offer]] = []


class _Use:
    """An action that is to supply a subgoal.

    Attributes:
        label: its transformation.
        cost: what it costs at least.
        inputs: what its in-ports demand.
        variables: those of each in-port.
        order: the in-ports in the order in which they are asked for; empty before the first.
        rest: what the in-ports from each place of that order on cost at least.
    """

    def __init__(self, request: Request, subgoal: _Subgoal, action: int, offer: Offer) -> None:
        self.subgoal = subgoal
        self.action = action
        self.offer = offer
        self.label = request.label(action)
        self.cost = request.floor(action)
        self.inputs = request.inputs(action)
        self.variables: Sequence[Tuple[int, ...]] = ()
        self.order: Sequence[int] = ()
        self.rest: List[int] = []


class _Join(NamedTuple):
    """An action whose first in-ports are supplied: how many, with what names, cost and nodes."""

    use: _Use
    step: int
    bounds: Known
    value: int
    nodes: Tuple[Need, ...]


class Search:
    """Finds the cheapest tree, or everything that plans of less than some cost can have.

    Attributes:
        value: what each node costs.
        chosen: what supplies it so.
        offers: all that supplies it, if that is collected.
        is_complete: whether the search came to its end, and not to its limit.
        reached: no plan with what was not found costs less.
    """

    def __init__(
        self,
        request: Request,
        bounds: Bounds,
        least: Dict[int, int],
        use_sum: bool = True,
        below: Optional[int] = None,
    ) -> None:
        """Begin with the goal.

        Args:
            request: the problem.
            bounds: what the goal can reach.
            least: what the demands cost at least that it reaches; others cannot be supplied.
            use_sum: use the sum over the inputs; else the maximum, which no plan is below.
            below: collect all that a plan which costs less can have.
        """
        self._request = request
        self._least = least
        self._use_sum = use_sum
        self._users = bounds.users
        #: What a plan costs at least besides each demand, and others; by default that is found.
        self._above: Optional[Dict[int, int]] = None
        self._above_others = 0
        if below is not None:
            self._above, self._above_others = bounds.above(least, below)
        self._below = below
        self._collects = below is not None
        self.value: Dict[Need, int] = {}
        self.chosen: Dict[Need, Instance] = {}
        self.offers: Dict[Need, Dict[Instance, None]] = {}
        self.subgoals: Dict[Tuple[int, Known], _Subgoal] = {}
        self.is_complete = True
        self.reached = 0
        self._best: Dict[Need, int] = {}
        #: The subgoals of each demand, by the places and names that are known exactly, and types.
        self._listeners: Dict[int, Dict[Any, Dict[Tuple[str, ...], _Subgoal]]] = {}
        self._heap: List[Tuple[Any, ...]] = []
        self._pushed = 0
        self._instances: Dict[Tuple[int, Theta], Instance] = {}
        known = (None,) * len(request.pattern(request.goal).wanted)
        self.goal = self._ask(request.goal, known, least.get(request.goal, 0))

    def run(self, steps: int, is_all: bool = False) -> int:
        """Search.

        Args:
            steps: what it may take.
            is_all: go on when the goal is supplied.

        Returns:
            The steps that are left.
        """
        heap, goal = self._heap, self.goal
        while heap and (is_all or self._collects or not goal.answers):
            if self._pushed * _EFFORT > steps:
                self.is_complete = False
                self.reached = heap[0][0]
                break
            key, _, _, _, _, item, more = heapq.heappop(heap)
            self.reached = key
            if type(item) is _Subgoal:
                if more is None:
                    self._next_use(item, key)
                else:
                    self._next_fact(item, more)
            elif type(item) is _Join:
                if self._collects or not item.use.subgoal.is_done:
                    self._go_on(item, key)
            else:
                self._supply(item, *more)
        return max(0, steps - self._pushed * _EFFORT)

    def can_be(self, number: int) -> bool:
        """Whether a demand could be supplied if no names were shared."""
        return number in self._least or number not in self._users

    def answers(self, number: int, known: Known) -> List[Need]:
        """Return the nodes that were supplied for a subgoal."""
        found = self.subgoals.get((number, known))
        return list(found.answers) if found is not None else []

    # Subgoals

    def _ask(self, number: int, known: Known, key: int) -> _Subgoal:
        """Return a subgoal, which is begun if it is new.

        Args:
            number: the demand.
            known: what is known of its names.
            key: what a plan that needs it costs at least.
        """
        found = self.subgoals.get((number, known))
        if found is not None:
            return found
        if self._above is not None:
            above = self._above.get(number, self._above_others)
        else:
            above = key - self._least.get(number, 0)
        subgoal = self.subgoals[number, known] = _Subgoal(number, known, above)
        mask = tuple([at for at, each in enumerate(known) if type(each) is str])
        types = tuple([(at, each) for at, each in enumerate(known) if type(each) is frozenset])
        names = tuple([known[at] for at in mask])
        tables = self._listeners.setdefault(number, {})
        tables.setdefault((mask, types), {})[names] = subgoal  # type: ignore[index]
        if subgoal.is_bound:
            node = Need(number, known)  # type: ignore[arg-type]
            if node in self.value:
                subgoal.answers[node] = self.value[node]
                subgoal.is_done = True
                if not self._collects:
                    return subgoal
        subgoal.facts = self._request.facts(number, known)
        fact = next(subgoal.facts, None)
        if fact is not None:
            self._push_fact(subgoal, *fact)
            if subgoal.is_bound and self._request.is_met(fact[0]):
                return subgoal
        self._list_uses(subgoal)
        self._push_use(subgoal)
        return subgoal

    def _push_fact(self, subgoal: _Subgoal, head: Head, theta: Theta) -> None:
        key = subgoal.above + head.cost
        if self._below is None or key < self._below:
            self._push(key, subgoal.above, head.source[0], theta, subgoal, (head, theta))

    def _next_fact(self, subgoal: _Subgoal, fact: Tuple[Head, Theta]) -> None:
        head, theta = fact
        if subgoal.is_done and not self._collects:
            return
        instance = self._instance(head.action, (), head.cost, ())
        self._supply(instance, subgoal, Need(subgoal.number, theta), head.cost)
        if not subgoal.is_done or self._collects:
            more = next(subgoal.facts, None)
            if more is not None:
                self._push_fact(subgoal, *more)

    def _list_uses(self, subgoal: _Subgoal) -> None:
        """List the actions that may supply a subgoal, the cheapest last."""
        request, least, users = self._request, self._least, self._users
        use_sum, below, above = self._use_sum, self._below, subgoal.above
        found = subgoal.uses
        for action, offer in request.offers(subgoal.number, subgoal.known):
            floors = []
            for each in request.inputs(action):
                floor = least.get(each)
                if floor is None:
                    if each in users:
                        break
                    floor = 0
                floors.append(floor)
            else:
                key = above + request.floor(action) + (sum(floors) if use_sum else max(floors))
                if below is None or key < below:
                    found.append((key, request.label(action), len(found), action, offer))
        found.sort(reverse=True)

    def _push_use(self, subgoal: _Subgoal) -> None:
        if subgoal.uses:
            key, label = subgoal.uses[-1][:2]
            self._push(key, subgoal.above, label, (), subgoal, None)

    def _next_use(self, subgoal: _Subgoal, key: int) -> None:
        """Begin the cheapest action that is left to supply a subgoal."""
        if subgoal.is_done and not self._collects:
            return
        _, _, _, action, offer = subgoal.uses.pop()
        self._push_use(subgoal)
        bounds = self.passed(subgoal.known, offer)
        if bounds is not None:
            join = _Join(_Use(self._request, subgoal, action, offer), 0, bounds, 0, ())
            self._order(join)
            self._go_on(join, key)

    def passed(self, known: Known, offer: Offer) -> Optional[Known]:
        """Return what is known of the variables of an action that supplies a subgoal.

        Returns:
            That, or None if the action cannot supply it.
        """
        names = self._request.names
        fixed = offer.solutions if known else None
        if fixed is not None and not any(agrees(theta, known, names) for theta in fixed):
            return None
        if not offer.types:
            rule = self._request.library.rules.get(offer.head.action)
            return (None,) * len(rule.variables) if rule is not None else ()
        if not any(offer.types) and not any(known):
            return (None,) * len(offer.types)
        bounds: List[Any] = list(map(names.is_known, offer.types))
        for place, each in zip(offer.places or (), known):
            if each is None:
                continue
            if isinstance(place, str):
                if not agrees((place,), (each,), names):
                    return None
                continue
            old = bounds[place]
            if old is None:
                bounds[place] = each
            elif isinstance(old, str):
                if not agrees((old,), (each,), names):
                    return None
            elif isinstance(each, str):
                if not names.fits(each, old):
                    return None
                bounds[place] = each
            else:
                bounds[place] = names.narrowed(old | each)
        if names.is_plain and any(type(each) is frozenset for each in bounds):
            return None  # of two different names
        return tuple(bounds)

    # Joins

    def _push_join(self, join: _Join, key: int) -> None:
        use = join.use
        if self._below is None or key < self._below:
            known = tuple([each for each in join.bounds if type(each) is str])
            self._push(key, use.subgoal.above, use.label, known, join, None)

    def _go_on(self, join: _Join, key: int) -> None:
        """Ask for the next in-port of an action."""
        use = join.use
        port = use.order[join.step]
        known = tuple([join.bounds[each] for each in use.variables[port]])
        subgoal = self._ask(use.inputs[port], known, key)
        if not subgoal.is_done:
            subgoal.waiting.append(join)
        for node, value in subgoal.answers.items():
            self._extend(join, node, value)

    def _order(self, join: _Join) -> None:
        """Choose the order in which an action asks for its in-ports."""
        use = join.use
        use.variables = self._request.variables(use.action)
        use.order = self.order(use.action, join.bounds)
        rest = [0]
        for port in reversed(use.order):
            floor = self._least.get(use.inputs[port], 0)
            rest.append(rest[-1] + floor if self._use_sum else max(rest[-1], floor))
        use.rest = rest[::-1]

    def order(self, action: int, bounds: Known) -> Sequence[int]:
        """Return the order of an action's in-ports: each time the one of which most is known."""
        variables = self._request.variables(action)
        left = list(range(len(variables)))
        if len(left) < 2:
            return left
        order: List[int] = []
        bound = {at for at, each in enumerate(bounds) if self._is_one(each)}
        while left:

            def rank(port: int) -> Tuple[bool, int, int]:
                free = sum([each not in bound for each in variables[port]])
                is_open = 0 < free == len(variables[port])
                return is_open, free, port

            best = min(left, key=rank)
            order.append(best)
            left.remove(best)
            bound.update(variables[best])
        return order

    def _is_one(self, known: Union[None, str, Types]) -> bool:
        """Whether what is known of a variable leaves one name at most."""
        if isinstance(known, frozenset):
            return len(self._request.names.below(known)) < 2
        return known is not None

    def _extend(self, join: _Join, node: Need, value: int) -> None:
        """Go on with a join when its next in-port is supplied."""
        use, step, bounds, before, nodes = join
        more = list(bounds)
        for variable, name in zip(use.variables[use.order[step]], node.theta):
            more[variable] = name
        total = before + value if self._use_sum else max(before, value)
        step += 1
        joined = _Join(use, step, tuple(more), total, (*nodes, node))
        if step < len(use.order):
            rest = use.rest[step]
            floor = total + rest if self._use_sum else max(total, rest)
            self._push_join(joined, use.subgoal.above + use.cost + floor)
        else:
            self._finish(joined)

    def _finish(self, join: _Join) -> None:
        """Let an action under bindings wait for its turns to supply nodes."""
        request, use = self._request, join.use
        theta: Theta = join.bounds  # type: ignore[assignment]
        cost = request.cost(use.action, theta)
        nodes = tuple([node for _, node in sorted(zip(use.order, join.nodes))])
        instance = self._instance(use.action, theta, cost, nodes)
        value = join.value + cost
        subgoal = use.subgoal
        number, offer = subgoal.number, use.offer
        found: Sequence[Theta]
        if offer.solutions is not None:
            found = offer.solutions
        elif offer.places is not None:
            found = [tuple([e if type(e) is str else theta[e] for e in offer.places])]  # type: ignore[index]
        else:
            atoms = [atom.ground(theta) for atom in offer.head.atoms]
            found = solutions(atoms, request.pattern(number), request.names)
        key = subgoal.above + value
        for each in found:
            if not agrees(each, subgoal.known, request.names):
                continue
            node = Need(number, each)
            if self._below is not None:
                if key >= self._below:
                    continue
            elif node in subgoal.answers or self._best.get(node, value) < value:
                continue
            self._best[node] = value
            more = subgoal, node, value
            self._push(key, subgoal.above, use.label, theta, instance, more)

    def _instance(self, action: int, theta: Theta, cost: int, needs: Tuple[Need, ...]) -> Instance:
        key = action, theta
        found = self._instances.get(key)
        if found is None:
            found = self._instances[key] = Instance(action, theta, cost, needs)
        return found

    def _supply(self, instance: Instance, subgoal: _Subgoal, node: Need, value: int) -> None:
        """Supply a node of a subgoal; the first time is the cheapest."""
        if self._collects:
            self.offers.setdefault(node, {})[instance] = None
        if node in self.value:
            if node not in subgoal.answers:
                self._answer(subgoal, node, self.value[node])
            return
        self.value[node] = value
        self.chosen[node] = instance
        theta, fits = node.theta, self._request.names.fits
        for (mask, types), table in self._listeners[node.number].items():
            found = table.get(tuple([theta[at] for at in mask]))
            if found is not None and all(fits(theta[at], each) for at, each in types):
                self._answer(found, node, value)

    def _answer(self, subgoal: _Subgoal, node: Need, value: int) -> None:
        """Let the joins that wait for a subgoal go on with a node of it."""
        subgoal.answers[node] = value
        waiting = subgoal.waiting
        if subgoal.is_bound:
            subgoal.is_done = True
            subgoal.waiting = []
        for join in waiting:
            self._extend(join, node, value)

    def _push(self, key: int, above: int, label: str, theta: Theta, item: Any, more: Any) -> None:
        self._pushed += 1
        heapq.heappush(self._heap, (key, above, label, theta, self._pushed, item, more))
