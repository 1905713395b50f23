# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Imported before rospy by each program of ours: two libraries wait until something uses them.

genpy imports numpy to accept its numbers in fields of floats. That takes a process 0.1 s of a
processor at its start, 16 MB, and a thread for each core. roslib's search for packages imports
pyparsing, for conditions in package.xml: another 0.03 s.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any, Mapping

_CONDITIONS = "catkin_pkg.condition"

if "numpy" not in sys.modules and "genpy" not in sys.modules:
    sys.modules["numpy"] = None  # type: ignore[assignment]  # an import of it fails
    try:
        from genpy import message
    finally:
        del sys.modules["numpy"]

    class _FloatTypes(list):  # type: ignore[type-arg]
        """The types whose values genpy accepts in such fields; those of numpy are named."""

        def __contains__(self, kind: object) -> bool:
            return super().__contains__(kind) or (
                isinstance(kind, type) and kind.__module__ == "numpy" and kind.__name__ in _NUMPY
            )

    _NUMPY = {f"{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)}
    _NUMPY |= {"float32", "float64"}
    message._valid_float_types = _FloatTypes(getattr(message, "_valid_float_types", ()))

if _CONDITIONS not in sys.modules:

    def _evaluate_condition(condition: str | None, context: Mapping[str, str]) -> Any:
        from catkin_pkg.condition import evaluate_condition

        return evaluate_condition(condition, context)

    sys.modules[_CONDITIONS] = ModuleType(_CONDITIONS)
    sys.modules[_CONDITIONS].evaluate_condition = _evaluate_condition  # type: ignore[attr-defined]
    try:
        import catkin_pkg.package  # noqa: F401
    finally:
        del sys.modules[_CONDITIONS]
