# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The classes of message types. Names come from outside: only generated modules are imported."""

from __future__ import annotations

from typing import Any

from dyknow.datatypes import is_built


def message_class(datatype: str) -> Any:
    """Return the class of a message type; None if it is not built here, or cannot be imported."""
    if not is_built(datatype):
        return None
    import roslib.message  # it takes its time

    try:
        return roslib.message.get_message_class(datatype)
    except Exception:  # whatever the code of the package does
        return None
