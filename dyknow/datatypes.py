# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which types of messages are one, as ROS sees it: those whose checksums are equal.

``tf/tfMessage`` and ``tf2_msgs/TFMessage`` are such a pair. Names are for people; roscpp and rospy
connect by checksum. It is read from the Python module that is generated for every message, without
executing it: a name from outside must not choose an import.
"""

from __future__ import annotations

import functools
import re
import sys
from pathlib import Path

ANY = ("", "*")  # how a type is written that matches every one: not known, or any on purpose

_NAME = re.compile(r"([A-Za-z]\w*)/([A-Za-z]\w*)\Z", re.ASCII)
_CHECKSUM = re.compile(r'^\s*_md5sum = "([0-9a-f]{32})"', re.MULTILINE)


@functools.lru_cache(maxsize=10_000)
def canonical(datatype: str) -> str:
    """Return the same text for types with equal checksums: the checksum.

    Where none can be had, because the type is not installed or stands for any, the name stands
    for itself.
    """
    return _checksum(datatype) or datatype


def is_built(datatype: str) -> bool:
    """Whether the module that is generated for a message type can be found."""
    return bool(_checksum(datatype))


def _checksum(datatype: str) -> str:
    """Return the checksum of a type; empty if none can be had."""
    match = _NAME.match(datatype)
    if match is None:
        return ""
    package, name = match.groups()
    for folder in sys.path:
        try:
            text = Path(folder, package, "msg", f"_{name}.py").read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            continue
        found = _CHECKSUM.search(text)
        if found is not None:
            return found.group(1)
    return ""


def same_type(one: str, other: str) -> bool:
    """Whether two names stand for one type."""
    return one == other or canonical(one) == canonical(other)


def types_fit(one: str, other: str) -> bool:
    """Whether streams of two types may be connected; an unknown type fits every one."""
    return one in ANY or other in ANY or same_type(one, other)
