# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tree of exceptions is as its module draws it."""

from __future__ import annotations

import inspect
import re
from typing import Dict, List

from dyknow import errors
from dyknow.errors import DyKnowError


def drawn() -> Dict[str, str]:
    """By name, the parent that the drawing gives each exception."""
    assert errors.__doc__ is not None
    parents: Dict[str, str] = {}
    above: List[str] = ["Exception"]
    for line in errors.__doc__.splitlines():
        found = re.match(r"    ((?:│   |    )*)(├── |└── |)([A-Z]\w+(?:, \w+)*)$", line)
        if found:
            depth = len(found.group(1) + found.group(2)) // 4 + 1
            for name in found.group(3).split(", "):
                above[depth:] = [name]
                parents[name] = above[depth - 1]
    return parents


def test_the_drawing_shows_every_exception_below_its_parent() -> None:
    classes = inspect.getmembers(errors, inspect.isclass)
    real = {name: each for name, each in classes if issubclass(each, DyKnowError)}
    assert drawn() == {name: each.__bases__[0].__name__ for name, each in real.items()}
