# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The order of actions by their labels, which decides between equal costs."""

from __future__ import annotations

from typing import List, Mapping, Sequence


class Ranks:
    """Grows with the actions; a specialised one has the rank of the one that it specialises.

    Attributes:
        of: the rank of each action.
        ordered: the actions by their ranks.
    """

    def __init__(self) -> None:
        """Start without an action."""
        self.of: List[int] = []
        self.ordered: List[int] = []

    def update(self, labels: Sequence[str], general: Mapping[int, int]) -> None:
        """Take in new actions.

        Args:
            labels: of all actions.
            general: of specialised actions, those that they specialise.
        """
        new = range(len(self.of), len(labels))
        inserted = [action for action in new if action not in general]
        if not inserted:
            self.of += [self.of[general[action]] for action in new]
            return
        self.ordered += inserted
        self.ordered.sort(key=labels.__getitem__)
        self.of = [0] * len(labels)
        for rank, action in enumerate(self.ordered):
            self.of[action] = rank
        for special, action in general.items():
            self.of[special] = self.of[action]
