# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Transcripts of a shell: command lines after ``$``, each with its output below it.

``...`` stands for any text, in a line of its own for any lines.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import Iterator

_BLOCK = re.compile(
    r"^\.\. code-block:: console\n(?: +:caption: (.*)\n)?\n((?: +.*\n|\n)+)", re.MULTILINE
)


@dataclass(frozen=True)
class Step:
    """A command line of a transcript.

    Attributes:
        line: the command; empty where a command that runs on goes on printing.
        printed: the text below it.
        terminal: the caption of the block that it is in; empty for none.
    """

    line: str
    printed: str
    terminal: str = ""

    @property
    def pattern(self) -> str:
        """A regular expression for the expected output of the command, to a last newline."""
        lines = (
            r"(?:.*\n)*"
            if line.strip() == "..."
            else re.escape(line).replace(r"\.\.\.", "(?s:.*)") + r"\n"
            for line in self.printed.splitlines()
        )
        return "".join(lines)


def steps(transcript: str, terminal: str = "") -> Iterator[Step]:
    """Split a transcript into its commands."""
    first, *commands = re.split(r"^\$ ", textwrap.dedent(transcript), flags=re.MULTILINE)
    if first.strip():
        yield Step("", first.strip("\n"), terminal)
    for each in commands:
        line, _, printed = each.rstrip().partition("\n")
        printed, is_ended, _ = printed.partition("^C")
        yield Step(line, printed, terminal)
        if is_ended:
            yield Step("", "^C", terminal)


def steps_of_page(text: str) -> Iterator[Step]:
    """Return the commands in all blocks ``.. code-block:: console`` of a page."""
    for block in _BLOCK.finditer(text):
        yield from steps(block.group(2), block.group(1) or "")
