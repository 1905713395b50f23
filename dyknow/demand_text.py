# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Demands for streams as text: written where a plan fails, read back by the client that gets it.

The answer of ``acquire_stream`` names the tags that nothing supplies in its message only.
"""

from __future__ import annotations

import json
import re
from typing import Iterable

_PLAIN = r'[^\s;&\[\]"()]+(?:\([^;&\[\]"()\n]*\))?'
_QUOTED = r'"(?:[^"\\]|\\.)*"'
_TAG = re.compile(f"{_QUOTED}|{_PLAIN}")
_DEMAND = (
    rf"(?:{_TAG.pattern})(?: & (?:{_TAG.pattern}))*(?: \[[^\[\]]*\])?"
    r"(?=; | \(excluded: |\n|\Z)"
)
_NOTHING_SUPPLIES = "nothing supplies "
_MISSING = re.compile(rf": {_NOTHING_SUPPLIES}({_DEMAND}(?:; {_DEMAND})*)")
_OTHERS = re.compile(r" \[[^\[\]]*\]\Z")


def write_demand(tags: Iterable[str], *others: str) -> str:
    """Write the demand on one stream: its tags, and the further demands that are not empty."""
    text = " & ".join(sorted(map(_quoted, tags)))
    asked = ", ".join(filter(None, others))
    return f"{text} [{asked}]" if asked else text


def write_missing(demand: str, missing: Iterable[str]) -> str:
    """Write that a demand cannot be met, since nothing supplies these other demands."""
    return f"no plan for {demand}: {_NOTHING_SUPPLIES}{'; '.join(missing)}"


def read_missing(text: str) -> tuple[str, ...]:
    """Return the tags that nothing supplies, out of a text that begins as ``write_missing``'s.

    Returns:
        The tags, sorted; empty if the text names none.
    """
    found = _MISSING.search(text)
    if found is None:
        return ()
    tags = set()
    for demand in re.findall(_DEMAND, found.group(1)):
        tags.update(_TAG.findall(_OTHERS.sub("", demand)))
    return tuple(sorted(json.loads(tag) if tag[0] == '"' else tag for tag in tags))


def _quoted(tag: str) -> str:
    """Quote a tag that would blend into the words around it."""
    return tag if re.fullmatch(_PLAIN, tag) else json.dumps(tag, ensure_ascii=False)
