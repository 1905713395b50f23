# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Suggestions for a name that is not known: the known names that resemble it."""

from __future__ import annotations

import difflib
from itertools import islice
from typing import Iterable

_COMPARED = 10_000  # most names that are compared, which takes a tenth of a second
LONGEST = 200  # characters of the longest name that suggestions are made for


def did_you_mean(name: str, known: Iterable[str], at_most: int = 3, prefix: str = "") -> str:
    """Write `; did you mean a or b?` for the end of an error; empty if no known name is similar.

    ``prefix`` stands before each of them.
    """
    if len(name) > LONGEST:
        return ""
    reach = 3 + len(name) // 3
    near = (each for each in sorted(known) if abs(len(each) - len(name)) <= reach)
    similar = difflib.get_close_matches(name, islice(near, _COMPARED), at_most)
    if not similar:
        return ""
    return f"; did you mean {' or '.join(prefix + each for each in similar)}?"
