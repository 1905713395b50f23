# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a search found: the values of nodes, and what supplies them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, List, Optional

from dyknow.manager.planning.joins import Join


@dataclass
class Values:
    """What a search found.

    Attributes:
        value: cost of the cheapest way to each node that was met.
        chosen: the action with which it ends, or ``LIVE``.
        offers: all actions that supply a node, if everything was asked for.
        joins: what arrived at the in-ports of the actions that join them.
        reached: a plan with what was not found costs at least as much; None if there is none.
        is_complete: whether the budget was sufficient.
    """

    value: Dict[int, int] = field(default_factory=dict)
    chosen: Dict[int, int] = field(default_factory=dict)
    offers: Dict[int, List[int]] = field(default_factory=dict)
    joins: Dict[int, Join] = field(default_factory=dict)
    reached: Optional[int] = 0
    is_complete: bool = True
