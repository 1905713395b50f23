# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Texts for the log, of limited length."""

from __future__ import annotations

#: Characters of one text in the log. A list of problems may have many lines.
LONGEST = 4096


def for_log(text: object) -> str:
    """Return a text for the log; of a long one its beginning and its length."""
    words = str(text)
    if len(words) <= LONGEST:
        return words
    return f"{words[:LONGEST]}… ({len(words)} characters)"
