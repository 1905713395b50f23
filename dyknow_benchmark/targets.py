# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ratios that DyKnow is measured against, and whether a run reached them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from dyknow_benchmark import tables

HEADER = ("what", "measured", "target", "met")


@dataclass(frozen=True)
class Verdict:
    """One quantity beside its target.

    Attributes:
        what: the quantity, with its unit if it has one.
        measured: its value.
        limit: the value to reach.
        at_least: whether larger is better.
    """

    what: str
    measured: float
    limit: float
    at_least: bool = False

    @property
    def met(self) -> bool:
        """Whether the target is reached."""
        if self.at_least:
            return self.measured >= self.limit
        return self.measured <= self.limit

    @property
    def row(self) -> Sequence[tables.Cell]:
        """A row under ``HEADER``."""
        sign = ">=" if self.at_least else "<="
        met = "met" if self.met else "NOT met"
        return (self.what, self.measured, f"{sign} {self.limit:g}", met)


def show(verdicts: Sequence[Verdict]) -> str:
    """Lay verdicts out as a table; a line that says so when there are none."""
    if not verdicts:
        return "no target applies to what was measured"
    return tables.render(HEADER, [verdict.row for verdict in verdicts])
