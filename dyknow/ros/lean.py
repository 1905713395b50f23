# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Imported before rospy by each program of ours: numpy is not imported until something uses it.

genpy imports it to accept its numbers in fields of floats. That takes a process 0.1 s of a
processor at its start, 16 MB, and a thread for each core.
"""

from __future__ import annotations

import sys

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
