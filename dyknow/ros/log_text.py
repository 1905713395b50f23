"""Texts for the log: what others sent is never written there whole, however long it is."""

from __future__ import annotations

#: Characters of one text in the log. A list of problems may have many lines.
LONGEST = 4096


def for_log(text: object) -> str:
    """Write something for the log, cut to its beginning; the length says what is missing."""
    words = str(text)
    if len(words) <= LONGEST:
        return words
    return f"{words[:LONGEST]}… ({len(words)} characters)"
