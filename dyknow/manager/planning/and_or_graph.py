# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""AND/OR graphs: an instance of an action needs all of its nodes; any of its makers makes a node.

Nodes and instances are numbers, with their attributes in parallel lists: an object for each
would have to be visited by the garbage collector.
"""

from __future__ import annotations

import heapq
from functools import cached_property
from typing import Collection, Iterable, NamedTuple, Sequence

from dyknow.manager.planning.library import Head, Operator
from dyknow.manager.planning.patterns import Pattern, Theta
from dyknow.manager.planning.request import NEVER, Request, matched

#: Bits for the number of an instance in the keys of a heap, below its price.
_BITS = 32
_NUMBER = (1 << _BITS) - 1

#: Stands for very many actions that were not looked at.
CROWD = Operator("", 0, None, (), (), (), (), (), False, None)

Node = int
Instance = int


class Draft(NamedTuple):
    """A plan as numbers of a graph: makers of nodes, and its instances, makers first."""

    graph: AndOrGraph
    way: dict[Node, Instance]
    order: list[Instance]
    cost: int

    @property
    def is_sound(self) -> bool:
        """Whether no nodelet has both fast inputs and others, or would never be made."""
        if self.cost >= NEVER or not self.graph.request.demand.min_rate:
            return self.cost < NEVER
        nodelets = [self.graph.nodelet(each) for each in self.order]
        return len({*nodelets}) == len(nodelets)

    @property
    def latency(self) -> int:
        """The stated latencies along the longest path, in microseconds."""
        begun: dict[Instance, int] = {}
        done: dict[Node, int] = {}

        def until(node: Node) -> int:
            found = done.get(node)
            if found is None:
                maker = self.way[node]
                found = done[node] = begun[maker] + self.graph.head(maker, node).latency
            return found

        for each in self.order:
            begun[each] = max(map(until, self.graph.needs[each]), default=0)
        return until(0)


class AndOrGraph:
    """A graph that grows until it is searched."""

    def __init__(self, request: Request) -> None:
        self.request = request  # the problem
        self.patterns: list[Pattern] = []  # the demand of each node; node 0 is the goal
        #: The names that the wanted variables of each node's pattern stand for.
        self.names: list[Theta] = []
        self.actions: list[Operator] = []  # of each instance
        self.thetas: list[Theta] = []  # the names of each instance's variables
        self.costs: list[int] = []  # of each instance
        #: The nodes of each instance's in-ports, in the order written.
        self.needs: list[tuple[Node, ...]] = []
        self.makes: list[Sequence[Node]] = []  # the nodes that each instance can make

    def add_node(self, pattern: Pattern, names: Theta) -> Node:
        self.patterns.append(pattern)
        self.names.append(names)
        return len(self.patterns) - 1

    def add_instance(
        self, action: Operator, theta: Theta, cost: int, needs: tuple[Node, ...]
    ) -> Instance:
        self.actions.append(action)
        self.thetas.append(theta)
        self.costs.append(cost)
        self.needs.append(needs)
        self.makes.append(())
        return len(self.costs) - 1

    def add_maker(self, node: Node, instance: Instance) -> None:
        made = self.makes[instance]
        if isinstance(made, list):
            made.append(node)
        else:
            self.makes[instance] = [*made, node] if made else (node,)

    def nodelet(self, instance: Instance) -> tuple[Operator, Theta]:
        """Return a key that is equal for instances that are one nodelet.

        Private variables distinguish nodelets, but are bound only where a plan is written.
        """
        action = self.actions[instance]
        is_base = self.request.is_strict or not action.has_private
        return action.base if is_base else action, self.thetas[instance]

    def head(self, instance: Instance, node: Node) -> Head:
        """Return the out-port with which an instance makes a node."""
        action = self.actions[instance]
        if len(action.heads) == 1:
            return action.heads[0]
        pattern, names = self.patterns[node], self.names[node]
        return self.request.source(action, self.thetas[instance], pattern, names)

    def cost(self, instances: Collection[Instance]) -> int:
        """Sum up costs; only one instance can use each free nodelet."""
        total = sum([self.costs[each] for each in instances])
        if self.request.kept:
            for each in self.surplus(instances):
                base = self.actions[each].base
                total += NEVER if base in self.request.scarce else base.cost
        return total

    def surplus(self, instances: Collection[Instance]) -> set[Instance]:
        """Return those to which a free nodelet would fit, but other instances have it."""
        fitting: dict[Instance, Sequence[int]] = {}
        for each in sorted(instances):
            found = self.request.fitting(self.actions[each], self.thetas[each])
            if found:
                fitting[each] = found
        return fitting.keys() - matched(fitting, {}).keys()

    @cached_property
    def _users(self) -> tuple[list[int], list[Instance]]:
        """Where the users of each node begin in a list of them, which follows."""
        begins = [0] * (len(self.patterns) + 1)
        for needs in self.needs:
            for node in needs:
                begins[node] += 1
        total = 0
        for node, count in enumerate(begins):
            total += count
            begins[node] = total
        users = [0] * total
        for instance in range(len(self.needs) - 1, -1, -1):
            for node in self.needs[instance]:
                begins[node] -= 1
                users[begins[node]] = instance
        return begins, users

    def cheapest(
        self, prices: Sequence[int], use_sum: bool
    ) -> tuple[dict[Node, int], dict[Node, Instance], list[Node]]:
        """Make all nodes as cheaply as possible at prices of the instances, by Knuth's algorithm.

        D. E. Knuth, "A generalization of Dijkstra's algorithm", Information Processing Letters
        6(1), 1977.

        With ``use_sum`` an instance costs as much as all nodes that it needs: the cost of a tree,
        in which shared parts are paid again. Else it costs as much as the dearest of them, which
        no plan is below. Returns the price of each node that can be made, its maker, and the
        dearest node that each instance needs, -1 for none.
        """
        begins, users = self._users
        makes = self.makes
        missing = list(map(len, self.needs))
        total = list(prices)
        dearest = [-1] * len(missing)
        heap = [total[each] << _BITS | each for each, left in enumerate(missing) if not left]
        heapq.heapify(heap)
        pop, push = heapq.heappop, heapq.heappush
        value: dict[Node, int] = {}
        way: dict[Node, Instance] = {}
        while heap:
            key = pop(heap)
            price, instance = key >> _BITS, key & _NUMBER
            for node in makes[instance]:
                if node in value:
                    continue
                value[node] = price
                way[node] = instance
                for user in users[begins[node] : begins[node + 1]]:
                    # Nodes come in the order of their prices: the last is the dearest.
                    total[user] = price + (total[user] if use_sum else prices[user])
                    dearest[user] = node
                    missing[user] -= 1
                    if not missing[user]:
                        push(heap, total[user] << _BITS | user)
        return value, way, dearest

    def derive(self, instances: Iterable[Instance], is_late: bool = False) -> dict[Node, Instance]:
        """Make all nodes that some instances alone can make in time, each as soon as possible.

        Without a limit of the age no node is later than another one; ``is_late`` ignores it. Where
        a nodelet has fast inputs or others, the instance with fast ones counts, which makes all
        that the other does. Returns the maker of each node that is made, without a cycle.
        """
        begins, users = self._users
        missing = {each: len(self.needs[each]) for each in instances}
        if self.request.demand.min_rate:
            slow = {self.nodelet(each): each for each in missing if not self.actions[each].slow}
            for each in [each for each in missing if self.actions[each].slow]:
                missing.pop(slow.get(self.nodelet(each), -1), None)
        limit = self.request.limit
        way: dict[Node, Instance] = {}
        #: Nodes when they are made, and instances, as node -1, when they have their inputs.
        heap = sorted([(0, -1, each) for each, left in missing.items() if not left])
        while heap:
            begun, node, instance = heapq.heappop(heap)
            if node < 0:
                for made in self.makes[instance]:
                    done = begun + (0 if limit is None else self.head(instance, made).latency)
                    if made not in way and (limit is None or is_late or done <= limit):
                        heapq.heappush(heap, (done, made, instance))
            elif node not in way:
                way[node] = instance
                for user in users[begins[node] : begins[node + 1]]:
                    left = missing.get(user, 0)
                    if left:
                        missing[user] = left - 1
                        if left == 1:
                            heapq.heappush(heap, (begun, -1, user))
        return way

    def drafted(self, way: dict[Node, Instance]) -> Draft:
        """Follow makers, among which there is no cycle, from the goal."""
        order: list[Instance] = []
        stack = [way[0]]
        entered = set()
        while stack:
            instance = stack.pop()
            if instance < 0:
                order.append(~instance)
            elif instance not in entered:
                entered.add(instance)
                stack.append(~instance)
                stack += [way[need] for need in reversed(self.needs[instance])]
        return Draft(self, way, order, self.cost(order))


class Reach(AndOrGraph):
    """The reach of the goal without bindings: each pattern is a node, and each action an instance.

    A pattern counts as supplied here if it can be supplied under any bindings, and only the
    cheapest fact that supplies it is looked at. So the work is proportional to the part of the
    library that the goal reaches, for any individuals. The prices are lower bounds for the search,
    and exact if no variable is shared.
    """

    def __init__(self, request: Request) -> None:
        """Collect it; that of a whole request also where a demand is met at no cost."""
        super().__init__(request)
        self.size = 0  # how many actions that need something are reached
        self.is_simple = not request.goal.wanted  # whether no names are to be bound
        #: The node of each pattern that is reached.
        self.numbers = {request.goal: self.add_node(request.goal, ())}
        self._instances: dict[Operator, int] = {}
        #: Nodes that one instance alone can make, if no names are to be bound.
        self._single: dict[Node, int] = {}
        for node, pattern in enumerate(self.patterns):  # grows meanwhile
            facts = request.cheapest_facts(pattern)
            makers = [self._maker(node, head.action, head.cost) for head in facts[:1]]
            if not request.is_whole:
                if facts and not pattern.wanted and request.is_met(pattern, facts[0]):
                    continue
                crowd = request.crowd(pattern) if pattern.wanted else None
                if crowd is not None:  # they are looked at when more is known
                    self.add_maker(node, self.add_instance(CROWD, (), crowd, ()))
                    continue
            for offer in request.offers(pattern):
                makers.append(self._maker(node, offer.action, request.floor(offer.action)))
            if len(makers) + len(facts[1:]) == 1:
                self._single[node] = makers[0]

    def _maker(self, node: Node, action: Operator, cost: int) -> int:
        """Let an action, which may be new, make a node."""
        instance = self._instances.get(action)
        if instance is None:
            instance = self._instances[action] = self.add_instance(action, (), cost, ())
            if action.inputs:
                self.size += 1
                self.is_simple = self.is_simple and not action.variables
                for need in action.inputs:
                    if need not in self.numbers:
                        self.numbers[need] = self.add_node(need, ())
                self.needs[instance] = tuple([self.numbers[need] for need in action.inputs])
        made = self.makes[instance]
        if not made or made[-1] != node:
            self.add_maker(node, instance)
        return instance

    @cached_property
    def trees(self) -> tuple[dict[Node, int], dict[Node, Instance]]:
        """The price of the cheapest tree for each node that can be made, and its maker."""
        value, way, _ = self.cheapest(self.costs, use_sum=True)
        return value, way

    @cached_property
    def floors(self) -> dict[Node, int]:
        """A cost for each node that can be made, which no plan for it is below."""
        return self.cheapest(self.costs, use_sum=False)[0]

    @cached_property
    def forced(self) -> int:
        """The cost of the instances that every plan has; 0 if names are to be bound."""
        if not self.is_simple:
            return 0
        found = {}
        waiting = [0]
        for node in waiting:  # grows meanwhile
            instance = self._single.get(node, -1)
            if instance >= 0 and instance not in found:
                found[instance] = self.costs[instance]
                waiting += self.needs[instance]
        return sum(found.values())

    def above(self, below: int) -> tuple[dict[Pattern, int], int]:
        """Return the least cost of a plan below a bound, besides each demand.

        It comes with that besides a demand of which nothing is known.
        """
        found: dict[Pattern, int] = {}
        least, rest = self.floors, below
        floors = [
            cost + max([least.get(need, below) for need in needs], default=0)
            for cost, needs in zip(self.costs, self.needs)
        ]
        makers: list[list[int]] = [[] for _ in self.patterns]
        for instance, nodes in enumerate(self.makes):
            for node in nodes:
                makers[node].append(instance)
        heap = [(0, 0)]
        while heap:
            price, node = heapq.heappop(heap)
            if self.patterns[node] in found:
                continue
            found[self.patterns[node]] = price
            for instance in makers[node]:
                cost = price + self.costs[instance]
                if self.actions[instance] is CROWD:
                    rest = min(rest, cost)
                elif price + floors[instance] < below:
                    for need in self.needs[instance]:
                        if self.patterns[need] not in found:
                            heapq.heappush(heap, (cost, need))
        if rest < below:
            found = {pattern: min(price, rest) for pattern, price in found.items()}
        return found, rest
