# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Signed messages: the tags that a stream claims to have, and whether they meet a demand.

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


def ways(supplied: Iterable[str], demanded: Iterable[str], kinds: Kinds) -> list[dict[str, str]]:
    """All ways in which a stream meets demands: names for their variables."""
    tags = list(supplied)
    found: list[dict[str, str]] = [{}]
    for demand in demanded:
        tried = [_bind(tag, demand, kinds, names) for names in found for tag in tags]
        found = [names for names in tried if names is not None]
    return found


def all_met(supplied: Iterable[str], demanded: Iterable[str], kinds: Kinds) -> bool:
    """Whether one stream with these tags meets each of those demands."""
    return bool(ways(supplied, demanded, kinds))


def filled(tag: str, names: Mapping[str, str]) -> str:
    """Put names for the variables of a tag; one that has no name stays."""
    functor, terms = parse(tag)
    return f"{functor}({', '.join(names.get(each, each) for each in terms)})" if terms else functor


def _bind(
    supplied: str, demanded: str, kinds: Kinds, names: Mapping[str, str]
) -> dict[str, str] | None:
    """Match one tag with one demand."""
    functor, arguments = parse(supplied)
    wanted, terms = parse(demanded)
    if not _is(functor, wanted, kinds) or len(arguments) != len(terms):
        return None
    bound = dict(names)
    for argument, term in zip(arguments, terms):
        variable, _, kind = term.partition(": ")
        if not term.startswith("?"):
            variable, kind = "", term
        if variable and bound.setdefault(variable, argument) != argument:
            return None
        if kind and not _is(argument, kind, kinds):
            return None
    return bound


def _is(term: str, wanted: str, kinds: Kinds) -> bool:
    return term == wanted or wanted in kinds.get(term, ())


def sign(message: Any, name: str, number: int, tags: Sequence[str]) -> Any:
    """Write the sender, the number and the stream's tags into a message."""
    message.frame_id = json.dumps({"by": name, "number": number, "tags": list(tags)})
    return message


def signature(message: Any) -> dict[str, Any]:
    """Read the sender, the number and the tags that ``sign`` wrote."""
    return json.loads(message.frame_id)
