# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Signed messages: what a stream says it is, and whether that meets a demand.

The matching is written here once more, from the contract alone, so that it judges DyKnow's own.
"""

from __future__ import annotations

import json
import re
from typing import Any, Iterable, Mapping, Sequence

#: For each term the classes it is an instance or a subclass of, however indirectly.
Kinds = Mapping[str, Sequence[str]]

_TERM = re.compile(r"\s*([^(),\s]+)\s*(?:\((.*)\))?\s*$")


def parse(tag: str) -> tuple[str, list[str]]:
    """Split ``F(a, b)`` into F and [a, b]."""
    functor, arguments = _TERM.match(tag).groups()
    return functor, [each.strip() for each in arguments.split(",")] if arguments else []


def meets(supplied: str, demanded: str, kinds: Kinds) -> bool:
    """Whether a stream of one tag is one of another."""
    functor, arguments = parse(supplied)
    wanted, terms = parse(demanded)
    return (
        _is(functor, wanted, kinds)
        and len(arguments) == len(terms)
        and all(t.startswith("?") or _is(a, t, kinds) for a, t in zip(arguments, terms))
        and all(
            len({a for a, other in zip(arguments, terms) if other == t}) == 1
            for t in terms
            if t.startswith("?")
        )
    )


def all_met(supplied: Iterable[str], demanded: Iterable[str], kinds: Kinds) -> bool:
    """Whether one stream with these tags meets each of those demands."""
    tags = list(supplied)
    return all(any(meets(each, demand, kinds) for each in tags) for demand in demanded)


def _is(term: str, wanted: str, kinds: Kinds) -> bool:
    return term == wanted or wanted in kinds.get(term, ())


def sign(message: Any, name: str, number: int, tags: Sequence[str]) -> Any:
    """Write into a message whose it is and what its stream supplies."""
    header = getattr(message, "header", message)
    header.frame_id = json.dumps({"by": name, "number": number, "tags": list(tags)})
    return message


def signature(message: Any) -> dict[str, Any]:
    """Read what ``sign`` wrote."""
    return json.loads(getattr(message, "header", message).frame_id)
