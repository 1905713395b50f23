# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Where the messages of a type carry their time stamp."""

from __future__ import annotations

from typing import Any


def stamp_field(datatype: Any) -> str:
    """Return the field of a message class that says when a message was made; empty for none.

    That is ``header.stamp`` where there is a header, else the first field of type ``time``:
    ``std_msgs/Header.stamp``, ``std_msgs/Time.data``, ``rosgraph_msgs/Clock.clock``.
    """
    types = dict(zip(datatype.__slots__, datatype._slot_types))
    if types.get("header") in ("std_msgs/Header", "Header"):
        return "header.stamp"
    return next((name for name, field_type in types.items() if field_type == "time"), "")
