# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts of nodelets and ports, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, NamedTuple, Optional, Tuple


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
        size: bytes of that message as it would be serialised; 0 where that is unknown.
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
    size: int = 0


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


class NodeletLoad(NamedTuple):
    """What a nodelet takes of its machine.

    Attributes:
        busy: share of the time that its callbacks take, waiting included; beyond 1 with several
            threads.
        cpu: share of one core; None if it is not known, as where nodelets share a process.
        memory: bytes of resident memory; None as for ``cpu``.
    """

    busy: float
    cpu: Optional[float]
    memory: Optional[int]


class PortCount(NamedTuple):
    """Counts of a port since its nodelet was loaded, and what its messages are like.

    Attributes:
        messages: received or sent.
        dropped: refused by a full queue, or published while disconnected.
        age: seconds between the stamp and the publishing of a message; None where unknown.
        size: bytes of a message; 0 where unknown.
    """

    messages: int
    dropped: int
    age: Optional[float] = None
    size: int = 0


@dataclass(frozen=True)
class NodeletCount:
    """Counts of a nodelet at one moment.

    Attributes:
        nodelet: its name.
        uptime: the moment, in seconds since it was loaded, steady.
        reconfigurations: how often its ports had been connected elsewhere before.
        ports: by name.
        callback_errors: callbacks that have raised.
        recent_error: text of the last error of a callback, if that was lately; empty if not.
        busy: seconds that its callbacks have taken, with those that run now and with waiting.
        cpu: seconds of processor time of its process; None if other nodelets share it.
        memory: bytes of resident memory of its process; None if other nodelets share it.
    """

    nodelet: str
    uptime: float
    reconfigurations: int
    ports: Mapping[str, PortCount]
    callback_errors: int = 0
    recent_error: str = ""
    busy: float = 0.0
    cpu: Optional[float] = None
    memory: Optional[int] = None

    def load_since(self, before: NodeletCount) -> Optional[NodeletLoad]:
        """Return the load since an earlier moment; None if it was loaded again since."""
        seconds = self.uptime - before.uptime
        if seconds <= 0.0:
            return None
        cpu = None
        if self.cpu is not None and before.cpu is not None:
            cpu = max(0.0, self.cpu - before.cpu) / seconds
        return NodeletLoad(max(0.0, self.busy - before.busy) / seconds, cpu, self.memory)
