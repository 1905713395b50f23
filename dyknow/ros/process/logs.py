# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Output of processes: copied from files into other files, and cut for the log."""

from __future__ import annotations

import os
from typing import TextIO

from dyknow.locks import turn_lock

#: Characters of one text in the log. A list of problems may have many lines.
LONGEST = 4096
_CHUNK = 1 << 16


def for_log(text: object) -> str:
    """Return a text for the log; of a long one its beginning and its length."""
    words = str(text)
    if len(words) <= LONGEST:
        return words
    return f"{words[:LONGEST]}… ({len(words)} characters)"


class LogTail:
    """Copies additions to a file; safe from any thread."""

    def __init__(self, path: str, at_end: bool = False) -> None:
        """Start at the beginning of ``path``, or at its present end."""
        self._path = path
        self._turn = turn_lock("output of a child")
        self._position = os.path.getsize(path) if at_end and os.path.exists(path) else 0

    def copy(self, target: TextIO) -> None:
        """Copy the additions since the last call."""
        with self._turn:
            try:
                with open(self._path, "rb") as file:
                    file.seek(self._position)
                    while True:
                        chunk = file.read(_CHUNK)
                        if not chunk:
                            break
                        self._position += len(chunk)
                        target.write(chunk.decode("utf-8", "replace"))
                target.flush()
            except (OSError, ValueError):
                return  # the file is gone, or our own output closed
