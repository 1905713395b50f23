# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""DyKnow: streams in ROS 1 that can be re-wired while everything runs.

The names below are loaded when they are first used, so that ``import dyknow`` alone imports
neither rospy nor a message.

DyKnow implements the framework of Daniel de Leng and Fredrik Heintz, "DyKnow: A Dynamically
Reconfigurable Stream Reasoning Framework as an Extension to the Robot Operating System", IEEE
International Conference on Simulation, Modeling, and Programming for Autonomous Robots (SIMPAR),
2016, pages 55-60.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dyknow import formulas
    from dyknow.nodelet.handle import Nodelet
    from dyknow.proxy.handle import NodeHandle
    from dyknow.ros.acquiring import acquire
    from dyknow.ros.client import ManagerClient

__all__ = ["ManagerClient", "NodeHandle", "Nodelet", "acquire", "formulas"]

__version__ = "0.2.0"

_HOMES = {
    "ManagerClient": "dyknow.ros.client",
    "Nodelet": "dyknow.nodelet",
    "NodeHandle": "dyknow.proxy",
    "acquire": "dyknow.ros.acquiring",
    "formulas": "dyknow",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if _HOMES[name] == __name__:
        return importlib.import_module(f"{__name__}.{name}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
