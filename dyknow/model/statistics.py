# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts of nodelets and ports, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional, Tuple


@dataclass(frozen=True)
class PortStatistics:
    """Messages of a port since its nodelet was loaded; None where they are not counted.

    Attributes:
        port: its name.
        direction: ``in`` or ``out``.
        topic: global name, empty when disconnected.
        messages: received or sent.
        dropped: refused by a full queue, or published while disconnected.
        rate: Hz over the last messages; 0 for less than two, falling while none come.
        mean_callback: seconds that a callback takes on average; 0 for an out-port.
        max_callback: seconds that the longest callback took.
        latched: an out-port that keeps a message for subscribers that connect later.
        age: seconds between the stamp and the publishing of the first message that an out-port
            sent after the last query; None where that is unknown.
    """

    port: str
    direction: str
    topic: str
    messages: Optional[int]
    dropped: Optional[int]
    rate: Optional[float]
    mean_callback: Optional[float]
    max_callback: Optional[float]
    latched: bool = False
    age: Optional[float] = None


@dataclass(frozen=True)
class NodeletStatistics:
    """Counts of a nodelet since it was loaded.

    Attributes:
        uptime: seconds, steady.
        reconfigurations: how often its ports were connected elsewhere.
        callback_errors: callbacks that raised; None where they are not counted.
        ports: the counts of each port.
        recent_error: text of the last error of a callback, if that was lately; empty if not.
    """

    uptime: float
    reconfigurations: int
    callback_errors: Optional[int]
    ports: Tuple[PortStatistics, ...]
    recent_error: str = ""


@dataclass(frozen=True)
class NodeletCount:
    """Counts of a nodelet at one moment.

    Attributes:
        nodelet: its name.
        uptime: the moment, in seconds since it was loaded, steady.
        reconfigurations: how often its ports had been connected elsewhere before.
        ports: messages and dropped messages by port.
    """

    nodelet: str
    uptime: float
    reconfigurations: int
    ports: Mapping[str, Tuple[int, int]]
