# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a search found: the values of nodes, and what supplies them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, List, Mapping, Optional, Sequence, Union

from dyknow.manager.planning.joins import Join

Chosen = Union[Mapping[int, int], Sequence[int]]
"""For each node the action that supplies it, or ``LIVE``."""


@dataclass
class Values:
    """What a search found.

    Attributes:
        value: cost of the cheapest way to each node that was met, -1 for others.
        chosen: the action with which it ends.
        offers: all actions that supply a node, if everything was asked for.
        joins: what arrived at the in-ports of the actions that join them.
        reached: a plan with what was not found costs at least as much; None if there is none.
        is_complete: whether the budget was sufficient.
    """

    value: List[int]
    chosen: List[int]
    offers: Dict[int, List[int]] = field(default_factory=dict)
    joins: Dict[int, Join] = field(default_factory=dict)
    reached: Optional[int] = 0
    is_complete: bool = True

    def is_met(self, node: int) -> bool:
        """Whether there is a way to a node."""
        return self.value[node] >= 0

    @property
    def floors(self) -> List[int]:
        """What each node costs at least; -1 for those that cannot be met."""
        rest = -1 if self.reached is None else self.reached
        return [rest if each < 0 else each for each in self.value]
