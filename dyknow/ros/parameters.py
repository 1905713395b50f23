# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parameters of nodelets, checked when a nodelet is loaded."""

from __future__ import annotations

from typing import Any

from dyknow.errors import BadParameter
from dyknow.ros.wire.message_classes import message_class


def get_datatype(nh: Any, parameter: str = "~datatype", default: str = "std_msgs/Header") -> Any:
    """Return the message class that a parameter names.

    Raises:
        BadParameter: no message type of that name can be imported.
    """
    name = nh.get_param(parameter, default)
    found = message_class(name) if isinstance(name, str) else None
    if found is None:
        expected = "a message type of a built package, such as sensor_msgs/Image"
        raise BadParameter(nh.resolve_name(parameter), name, expected)
    return found


def get_positive(nh: Any, name: str, default: float, unit: str) -> float:
    """Return a parameter that must be a number above zero, or its default.

    Raises:
        BadParameter: it is not such a number.
    """
    value = nh.get_param(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
        raise BadParameter(nh.resolve_name(name), value, f"a number above 0, in {unit}")
    return float(value)
