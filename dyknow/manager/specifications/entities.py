# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Refuses RDF/XML whose entities would expand to far more text than the file has.

Editors of ontologies declare entities as shorthands for namespaces, so a DOCTYPE alone is
accepted. External entities are harmless: nothing fetches them.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from typing import Dict
from xml.parsers import expat

from dyknow.manager.specifications.limits import SpecificationLimits

_REFERENCE = re.compile(rb"&([^;&<>#\s]+);")
_WIDE = (b"\xff\xfe", b"\xfe\xff", b"\x00<", b"<\x00")


class _Begun(Exception):
    """The first element has begun: entities are only declared before it."""


def check_entities(data: bytes, limits: SpecificationLimits) -> None:
    """Refuse a text with dangerous entities before anything is expanded.

    A text that is not well-formed passes: the parser that follows refuses it.

    Raises:
        ValueError: entities contain entities, or expand to more than the limit.
    """
    sizes = _declared(data)
    if not sizes:
        return
    if data[:2] in _WIDE:
        raise ValueError("entities in UTF-16; expected UTF-8")
    counts = Counter(match.group(1) for match in _REFERENCE.finditer(data))
    expanded = sum(count * sizes.get(name, 0) for name, count in counts.items())
    if expanded > limits.expanded_entities:
        raise ValueError(
            f"its entities expand to {expanded} bytes; expected at most {limits.expanded_entities}"
        )


def _declared(data: bytes) -> Dict[bytes, int]:
    """Sizes in bytes of the entities that a text declares, by name."""
    sizes: Dict[bytes, int] = {}

    def note(name: str, is_parameter: bool, value: str | None, *_: object) -> None:
        if value is None:
            return
        if is_parameter or "&" in value:
            what = "is one for declarations" if is_parameter else "contains others"
            raise ValueError(f"the entity '{name[:60]}' {what}; expected plain text in it")
        sizes.setdefault(name.encode("utf-8"), len(value.encode("utf-8")))

    def begin(*_: object) -> None:
        raise _Begun

    parser = expat.ParserCreate()
    parser.EntityDeclHandler = note
    parser.StartElementHandler = begin
    with contextlib.suppress(_Begun, expat.ExpatError):
        parser.Parse(data, True)
    return sizes
