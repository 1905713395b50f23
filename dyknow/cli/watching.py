# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Repeated output: in place on a terminal, one after the other elsewhere."""

from __future__ import annotations

import json
import shutil
import time
from typing import Any, Sequence

from dyknow.cli.shell import Shell

_HOME = "\x1b[H"
_CLEAR = "\x1b[2J"
_CLEAR_LINE = "\x1b[K"
_CLEAR_BELOW = "\x1b[J"


class Screen:
    """Shows a value that changes.

    On a terminal each value replaces the one before, cut to the window; lines are rewritten
    without clearing the screen, so that nothing flickers. Elsewhere an empty line separates
    values; as JSON each is one line.
    """

    def __init__(self, shell: Shell, period: float) -> None:
        """Show through `shell`, every `period` seconds."""
        self._shell = shell
        self._period = period
        self._in_place = shell.out.isatty() and not shell.as_json
        self._shown = False

    def show(self, value: Any, lines: Sequence[str]) -> None:
        """Show a value."""
        out = self._shell.out
        if self._shell.as_json:
            out.write(json.dumps(value) + "\n")
        elif self._in_place:
            out.write(self._page(lines))
        else:
            out.write(("\n" if self._shown else "") + "".join(line + "\n" for line in lines))
        self._shown = True
        out.flush()

    def wait(self, begin: float) -> None:
        """Wait until a period has passed since `begin`, a time of the steady clock."""
        time.sleep(max(0.0, begin + self._period - time.monotonic()))

    def _page(self, lines: Sequence[str]) -> str:
        width, height = shutil.get_terminal_size()
        shown = list(lines)
        if len(shown) > height - 1:
            hidden = len(shown) - (height - 2)
            shown = [*shown[: height - 2], f"... {hidden} more lines"]
        text = _HOME if self._shown else _CLEAR + _HOME
        text += "".join(line[:width] + _CLEAR_LINE + "\n" for line in shown)
        return text + _CLEAR_BELOW
