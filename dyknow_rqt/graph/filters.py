# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Filters of names as people type them: ``/robot, /cam.*, -/robot/debug``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Callable, Iterable, Sequence

_PLAIN = re.compile(r"[A-Za-z0-9_/]*\Z")


class BadFilter(ValueError):
    """A part of a filter is not a regular expression."""

    def __init__(self, part: str, reason: object) -> None:
        self.part = part
        super().__init__(f"filter '{part}' is not a regular expression: {reason}")


@dataclass(frozen=True)
class Filter:
    """Selects names.

    A part without special characters stands for that name and for the namespace of that name;
    any other is a regular expression for the beginning of a name. A part that begins with ``-``
    excludes. If all parts exclude, everything else is included.
    """

    includes: tuple[Callable[[str], bool], ...] = ()
    excludes: tuple[Callable[[str], bool], ...] = ()

    def __call__(self, name: str) -> bool:
        if any(exclude(name) for exclude in self.excludes):
            return False
        return not self.includes or any(include(name) for include in self.includes)


def parse(text: str) -> Filter:
    """Read a filter; a part that is neither a name nor a regular expression is a BadFilter."""
    includes: list[Callable[[str], bool]] = []
    excludes: list[Callable[[str], bool]] = []
    for part in _parts(text):
        if part.startswith("-"):
            if part[1:].strip():
                excludes.append(_matcher(part[1:].strip()))
        else:
            includes.append(_matcher(part))
    return Filter(tuple(includes), tuple(excludes))


def completions(text: str, names: Iterable[str]) -> list[str]:
    """Whole texts, sorted, whose last part is completed to a name or a namespace."""
    head, comma, last = text.rpartition(",")
    stem = last.strip()
    minus = "-" if stem.startswith("-") else ""
    stem = stem[len(minus) :]
    prefix = head + comma + (" " if comma else "") + minus
    known = {space for name in names for space in with_namespaces(name)}
    return [prefix + name for name in sorted(known) if name.startswith(stem) and name != stem]


def _parts(text: str) -> list[str]:
    """Split at commas that do not stand in brackets: ``/a{1,2}`` is one part."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "({[") - (character in ")}]")
        if character == "," and depth <= 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts if part.strip()]


def _matcher(part: str) -> Callable[[str], bool]:
    if _PLAIN.match(part):
        whole = part.rstrip("/")
        return lambda name: name == whole or name.startswith(whole + "/")
    try:
        pattern = re.compile(part)
    except (re.error, OverflowError, RecursionError) as error:
        raise BadFilter(part, error) from error
    return lambda name: pattern.match(name) is not None


def with_namespaces(name: str) -> list[str]:
    """Return the namespaces that a name is in, the outermost first, and the name."""
    pieces = name.strip("/").split("/")
    return ["/" + "/".join(pieces[: count + 1]) for count in range(len(pieces))]


def _name_and_arguments(tag: str) -> tuple[str, list[str]]:
    name, _, rest = tag.partition("(")
    return name.strip(), [word.strip() for word in rest.rstrip(") ").split(",")]


def tag_completions(text: str, tags: Sequence[str]) -> list[str]:
    """Complete a tag, or within its parentheses the next of its arguments."""
    concept, opened, inside = text.rpartition("(")
    if not opened or ")" in inside:
        return [tag for tag in tags if text.lower() in tag.lower()]
    before = inside.split(",")
    part, place = before[-1].strip(), len(before) - 1
    known = [_name_and_arguments(tag) for tag in tags]
    own = concept.strip()
    ends = {len(words) for name, words in known if name == own} == {place + 1}
    found = []
    for name, words in known:
        is_last = len(words) == place + 1 if name == own else ends
        for word in words:
            if word and not word.startswith("?") and word.lower().startswith(part.lower()):
                found.append((name != own, word + ")" if is_last else word))
    start = text[: len(text) - len(part)]
    return list(dict.fromkeys(start + word for _, word in sorted(found)))
