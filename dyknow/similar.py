"""Suggests what somebody may have meant who named a thing that is not there."""

from __future__ import annotations

import difflib
from itertools import islice
from typing import Iterable

#: Names that are compared at most, which takes a tenth of a second.
_COMPARED = 10_000
#: Characters of a name beyond which nobody has mistyped it.
_LONGEST = 200


def did_you_mean(name: str, known: Iterable[str], at_most: int = 3, prefix: str = "") -> str:
    """Write `; did you mean a or b?` for the end of an error.

    Args:
        name: what is not there.
        known: what is, in any order.
        at_most: how many are suggested.
        prefix: stands before each of them.

    Returns:
        The words; empty if nothing is similar.
    """
    if len(name) > _LONGEST:
        return ""
    reach = 3 + len(name) // 3
    near = (each for each in sorted(known) if abs(len(each) - len(name)) <= reach)
    similar = difflib.get_close_matches(name, islice(near, _COMPARED), at_most)
    if not similar:
        return ""
    return f"; did you mean {' or '.join(prefix + each for each in similar)}?"
