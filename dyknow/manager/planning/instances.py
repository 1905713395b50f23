# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The instances that one search comes across, numbered beside the actions and demands.

A *node* is a demand under bindings of the variables that are wanted of it; a demand of which
nothing is wanted is the node of its own number. An action that joins in-ports is done under
bindings, so its instances get numbers of their own.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Dict, List, Mapping, Tuple

from dyknow.manager.planning.live_streams import LiveMatch
from dyknow.manager.planning.network import Network
from dyknow.manager.planning.patterns import Theta
from dyknow.manager.planning.problem import Live, New
from dyknow.manager.planning.reach import Reach
from dyknow.manager.specifications.tags import Bindings

LIVE = -1
"""Stands for a live stream where an action could be."""


NO_CHARGES: Mapping[str, int] = MappingProxyType({})
"""Nothing has to be paid besides the costs."""


class Instances:
    """Nodes and actions of a search: those of the network first, then what was instantiated."""

    def __init__(
        self,
        network: Network,
        reach: Reach,
        free: Mapping[str, Bindings],
        charges: Mapping[str, int] = NO_CHARGES,
    ) -> None:
        """Start with those of the network.

        Args:
            network: the library.
            reach: what the goal can reach.
            free: nodelets that cost nothing: label and bindings that they keep.
            charges: what has to be paid besides the costs, by label.
        """
        self.network = network
        self.reach = reach
        self.labels = network.labels.copy()
        self.needs = network.needs.copy()
        self.costs = network.costs.copy()
        self._free = {
            label: {variable: network.names.canonical(name) for variable, name in bindings}
            for label, bindings in free.items()
        }
        self._charges = charges
        for action in reach.actions if free or charges else ():
            is_open = reach.is_abstract or action not in network.joined
            if is_open and self.is_free(self.labels[action]):
                self.costs[action] = 0
            self.costs[action] += self.charge(action)
        #: Numbers from which on nodes and actions are those of this search.
        self.first_node = len(network.patterns)
        self.first_action = len(network.labels)
        self._nodes: Dict[Tuple[int, Theta], int] = {}
        self._of_nodes: List[Tuple[int, Theta]] = []
        self._actions: Dict[Tuple[int, Theta], int] = {}
        self._of_actions: List[Tuple[int, Theta]] = []
        #: For actions under bindings, the nodes of their in-ports in the order written.
        self.inputs: Dict[int, Tuple[int, ...]] = {}
        self.streams: Dict[int, Live] = {}

    def live(self, match: LiveMatch) -> int:
        """Return the node that a live stream supplies."""
        node = self.node(match.demand, () if self.reach.is_abstract else match.theta)
        self.streams[node] = match.stream
        return node

    @property
    def node_count(self) -> int:
        """Nodes that have a number."""
        return self.first_node + len(self._of_nodes)

    def node(self, demand: int, theta: Theta) -> int:
        """Return the number of a demand under bindings."""
        if not theta:
            return demand
        key = demand, theta
        found = self._nodes.get(key)
        if found is None:
            found = self._nodes[key] = self.first_node + len(self._of_nodes)
            self._of_nodes.append(key)
        return found

    def nodes_of(self, demand: int) -> List[Tuple[int, Theta]]:
        """Return the nodes of a demand, each with what its wanted variables stand for."""
        found = [(node, theta) for (of, theta), node in self._nodes.items() if of == demand]
        return found or [(demand, ())]

    def demand(self, node: int) -> Tuple[int, Theta]:
        """Return the demand of a node, and what its wanted variables stand for."""
        return (node, ()) if node < self.first_node else self._of_nodes[node - self.first_node]

    def action(self, rule: int, theta: Theta, needs: Tuple[int, ...]) -> int:
        """Return the number of an action under bindings; the needed nodes are in the join's order.

        Specialised actions under equal bindings are the same instance, and what they need is
        supplied by the same.
        """
        key = self.network.base(rule), theta
        found = self._actions.get(key)
        if found is None:
            found = self._actions[key] = self.first_action + len(self._of_actions)
            self._of_actions.append(key)
            self.labels.append(self.labels[rule])
            self.needs.append(tuple(dict.fromkeys(needs)))
            self.costs.append(self.cost(rule, theta))
            ports = [step.port for step in self.network.rules[rule].joins]
            self.inputs[found] = tuple([node for _, node in sorted(zip(ports, needs))])
        return found

    def rule(self, action: int) -> Tuple[int, Theta]:
        """Return the action of the network, not specialised, and its bindings."""
        if action < self.first_action:
            return self.network.base(action), ()
        return self._of_actions[action - self.first_action]

    def source(self, action: int, node: int) -> New:
        """Return the out-port with which an action supplies a node: of several the soonest."""
        network = self.network
        demand, theta = self.demand(node)
        rule, bound = self.rule(action)
        offers = network.found[demand][rule]
        if len(offers) == 1:
            return offers[0].head.source
        found = [
            each.head.source
            for each in offers
            if theta in each.of(network.patterns[demand], bound, network.names)
        ]
        return min(found, key=lambda each: network.latencies.get(each[:2], 0))

    def charge(self, action: int) -> int:
        """Return what has to be paid for an action besides its cost."""
        return self._charges.get(self.labels[action], 0)

    def is_free(self, label: str) -> bool:
        """Whether there is a nodelet of a transformation that costs nothing."""
        return label in self._free

    def floor(self, rule: int) -> int:
        """Return what an action costs at least."""
        own = 0 if self.is_free(self.labels[rule]) else self.network.costs[rule]
        return own + self.charge(rule)

    def cost(self, rule: int, theta: Theta) -> int:
        """Return what an action costs under bindings."""
        kept = self._free.get(self.labels[rule]) if self._free else None
        if kept is not None:
            bound = dict(zip(self.network.rules[rule].variables, theta))
            if all(bound.get(variable, name) == name for variable, name in kept.items()):
                return self.charge(rule)
        return self.network.costs[rule] + self.charge(rule)
