# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What actions cost one request: less where there is a nodelet, more where a wish is ignored."""

from __future__ import annotations

from types import MappingProxyType
from typing import Dict, Mapping, Sequence

from dyknow.manager.planning.network import Network
from dyknow.manager.planning.patterns import Theta
from dyknow.manager.specifications.tags import Bindings

NO_CHARGES: Mapping[str, int] = MappingProxyType({})
"""Nothing has to be paid besides the costs."""


class Costs:
    """Costs of actions, with what is free and what is charged besides."""

    def __init__(
        self,
        network: Network,
        free: Mapping[str, Bindings],
        charges: Mapping[str, int] = NO_CHARGES,
    ) -> None:
        """Set it up.

        Args:
            network: the library.
            free: nodelets that cost nothing: label and bindings that they keep.
            charges: what has to be paid besides the costs, by label.
        """
        self._network = network
        self._free = {
            label: {variable: network.names.canonical(name) for variable, name in bindings}
            for label, bindings in free.items()
        }
        self._charges = charges
        #: Floors of actions, not specialised, that differ from their costs.
        self._changed: Dict[int, int] = {}
        for action in network.numbers([*free, *charges]):
            own = 0 if network.labels[action] in free else network.costs[action]
            self._changed[action] = own + self.charge(action)

    @property
    def are_plain(self) -> bool:
        """Whether all actions cost what their transformations state."""
        return not self._changed

    def charge(self, action: int) -> int:
        """Return what has to be paid for an action of the network besides its cost."""
        return self._charges.get(self._network.labels[action], 0)

    def is_free(self, label: str) -> bool:
        """Whether there is a nodelet of a transformation that costs nothing."""
        return label in self._free

    def floor(self, action: int) -> int:
        """Return what an action costs at least: without variables, what it costs."""
        cost = self._network.costs[action]
        return self._changed.get(self._network.base(action), cost) if self._changed else cost

    def floors(self) -> Sequence[int]:
        """Return what all actions that the network has now cost at least."""
        if not self._changed:
            return self._network.costs
        found = self._network.costs.copy()
        for action, floor in self._changed.items():
            found[action] = floor
        for action, base in self._network.general.items():
            found[action] = found[base]
        return found

    def bound(self, rule: int, theta: Theta) -> int:
        """Return what an action costs under bindings."""
        network = self._network
        if not self._changed:
            return network.costs[rule]
        kept = self._free.get(network.labels[rule])
        if kept is not None:
            bound = dict(zip(network.rules[rule].variables, theta))
            if all(bound.get(variable, name) == name for variable, name in kept.items()):
                return self.charge(rule)
        return network.costs[rule] + self.charge(rule)
