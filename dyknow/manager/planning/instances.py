# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The instances that one search comes across, numbered beside the actions and demands.

A *node* is a demand under bindings of the variables that are wanted of it; a demand of which
nothing is wanted is the node of its own number. An action that joins in-ports is done under
bindings, so its instances get numbers of their own.
"""

from __future__ import annotations

from typing import Dict, List, Tuple

from dyknow.manager.planning.costs import Costs
from dyknow.manager.planning.live_streams import LiveMatch
from dyknow.manager.planning.network import Network
from dyknow.manager.planning.patterns import Theta
from dyknow.manager.planning.problem import Live, New
from dyknow.manager.planning.reach import Reach

LIVE = -1
"""Stands for a live stream where an action could be."""
FIRST = 1 << 32
"""Nodes and actions from this number on are those of a search, others those of the network."""


class Instances:
    """Nodes and actions of a search: those of the network, and what was instantiated."""

    def __init__(self, network: Network, reach: Reach, costs: Costs) -> None:
        """Start with those of the network.

        Args:
            network: the library.
            reach: what the goal can reach.
            costs: what actions cost.
        """
        self.network = network
        self.reach = reach
        self.costs = costs
        self._nodes: Dict[Tuple[int, Theta], int] = {}
        self._of_nodes: List[Tuple[int, Theta]] = []
        self._actions: Dict[Tuple[int, Theta], int] = {}
        self._of_actions: List[Tuple[int, Theta]] = []
        self._costs: List[int] = []
        self._needs: List[Tuple[int, ...]] = []
        #: For actions under bindings, the nodes of their in-ports in the order written.
        self.inputs: Dict[int, Tuple[int, ...]] = {}
        self.streams: Dict[int, Live] = {}

    def live(self, match: LiveMatch) -> int:
        """Return the node that a live stream supplies."""
        node = self.node(match.demand, match.theta)
        self.streams[node] = match.stream
        return node

    def node(self, demand: int, theta: Theta) -> int:
        """Return the number of a demand under bindings."""
        if not theta:
            return demand
        key = demand, theta
        found = self._nodes.get(key)
        if found is None:
            found = self._nodes[key] = FIRST + len(self._of_nodes)
            self._of_nodes.append(key)
        return found

    def nodes_of(self, demand: int) -> List[Tuple[int, Theta]]:
        """Return the nodes of a demand, each with what its wanted variables stand for."""
        found = [(node, theta) for (of, theta), node in self._nodes.items() if of == demand]
        return found or [(demand, ())]

    def demand(self, node: int) -> Tuple[int, Theta]:
        """Return the demand of a node, and what its wanted variables stand for."""
        return (node, ()) if node < FIRST else self._of_nodes[node - FIRST]

    def action(self, rule: int, theta: Theta, needs: Tuple[int, ...]) -> int:
        """Return the number of an action under bindings; the needed nodes are in the join's order.

        Specialised actions under equal bindings are the same instance, and what they need is
        supplied by the same.
        """
        key = self.network.base(rule), theta
        found = self._actions.get(key)
        if found is None:
            found = self._actions[key] = FIRST + len(self._of_actions)
            self._of_actions.append(key)
            self._needs.append(tuple(dict.fromkeys(needs)))
            self._costs.append(self.costs.bound(rule, theta))
            ports = [step.port for step in self.network.rules[rule].joins]
            self.inputs[found] = tuple([node for _, node in sorted(zip(ports, needs))])
        return found

    def rule(self, action: int) -> Tuple[int, Theta]:
        """Return the action of the network, not specialised, and its bindings."""
        if action < FIRST:
            return self.network.base(action), ()
        return self._of_actions[action - FIRST]

    def label(self, action: int) -> str:
        """Return the transformation of an action."""
        return self.network.labels[self.rule(action)[0]]

    def needs(self, action: int) -> Tuple[int, ...]:
        """Return the nodes that an action needs."""
        return self.network.needs[action] if action < FIRST else self._needs[action - FIRST]

    def cost(self, action: int) -> int:
        """Return what an action costs."""
        return self.costs.floor(action) if action < FIRST else self._costs[action - FIRST]

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
