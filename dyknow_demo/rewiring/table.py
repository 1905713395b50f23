# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What the demonstration prints: a table line by line, and progress where there is a terminal."""

from __future__ import annotations

import sys
from typing import TextIO

from dyknow_demo.rewiring.accounting import Account

_HEAD = (
    f"{'wiring':44}{'image':>9}{'frames':>8}{'Hz':>7}{'mean ms':>9}{'p99 ms':>8}"
    f"{'lost':>6}{'doubled':>9}{'re-wired in':>13}"
)


class ReportTable:
    """Prints to a stream; the line of progress is only for people who watch a terminal."""

    def __init__(self, stream: TextIO = sys.stdout) -> None:
        self._stream = stream
        self._watched = stream.isatty()

    def line(self, text: str = "") -> None:
        """Print a line for good."""
        self._erase()
        print(text, file=self._stream, flush=True)

    def head(self) -> None:
        """Print the names of the columns."""
        self.line(_HEAD)
        self.line("-" * len(_HEAD))

    def row(self, wiring: str, account: Account, took: str) -> None:
        """Print what became of the frames of one stage.

        Args:
            wiring: the chain.
            account: of the stage.
            took: time that the re-wiring took.
        """
        size = "{}x{}".format(*account.size)
        self.line(
            f"{wiring:44}{size:>9}{account.messages:8}{account.rate:7.1f}"
            f"{1000 * account.mean:9.2f}{1000 * account.percentile(99):8.2f}"
            f"{account.lost:6}{account.doubled:9}{took:>13}"
        )

    def progress(self, text: str) -> None:
        """Show what goes on now, until the next line."""
        if self._watched:
            self._erase()
            self._stream.write(text)
            self._stream.flush()

    def _erase(self) -> None:
        if self._watched:
            self._stream.write("\r\033[K")
