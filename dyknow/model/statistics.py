# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts of nodelets and ports, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, NamedTuple, Optional, Tuple


@dataclass(frozen=True)
class PortStatistics:
    """Messages of a port since its nodelet was loaded; None where they are not counted."""

    port: str  #: its name
    direction: str  #: ``in`` or ``out``
    topic: str  #: global name, empty when disconnected
    messages: Optional[int]  #: received or sent
    dropped: Optional[int]  #: refused by a full queue, or published while disconnected
    #: Hz over the last messages; 0 for less than two, falling while none come.
    rate: Optional[float]
    mean_callback: Optional[float]  #: seconds that a callback takes on average; 0 for an out-port
    max_callback: Optional[float]  #: seconds that the longest callback took
    latched: bool = False  #: an out-port that keeps a message for subscribers that connect later
    #: Seconds between the stamp and the publishing of the first message that an out-port sent
    #: after the last query; None where that is unknown.
    age: Optional[float] = None
    size: int = 0  #: bytes of that message as it would be serialised; 0 where that is unknown


@dataclass(frozen=True)
class NodeletStatistics:
    """Counts of a nodelet since it was loaded."""

    uptime: float  #: seconds, steady
    reconfigurations: int  #: how often its ports were connected elsewhere
    callback_errors: Optional[int]  #: callbacks that raised; None where they are not counted
    ports: Tuple[PortStatistics, ...]  #: the counts of each port
    #: Text of the last error of a callback, if that was lately; empty if not.
    recent_error: str = ""


class NodeletLoad(NamedTuple):
    """What a nodelet takes of its machine."""

    #: Share of the time that its callbacks take, waiting included; beyond 1 with several threads.
    busy: float
    #: Share of one core; None if it is not known, as where nodelets share a process.
    cpu: Optional[float]
    memory: Optional[int]  #: bytes of resident memory; None as for ``cpu``


class PortCount(NamedTuple):
    """Counts of a port since its nodelet was loaded, and what its messages are like."""

    messages: int  #: received or sent
    dropped: int  #: refused by a full queue, or published while disconnected
    #: Seconds between the stamp and the publishing of a message; None where unknown.
    age: Optional[float] = None
    size: int = 0  #: bytes of a message; 0 where unknown


@dataclass(frozen=True)
class NodeletCount:
    """Counts of a nodelet at one moment."""

    nodelet: str  #: its name
    uptime: float  #: the moment, in seconds since it was loaded, steady
    reconfigurations: int  #: how often its ports had been connected elsewhere before
    ports: Mapping[str, PortCount]  #: by name
    callback_errors: int = 0  #: callbacks that have raised
    #: Text of the last error of a callback, if that was lately; empty if not.
    recent_error: str = ""
    #: Seconds that its callbacks have taken, with those that run now and with waiting.
    busy: float = 0.0
    #: Seconds of processor time of its process; None if other nodelets share it.
    cpu: Optional[float] = None
    #: Bytes of resident memory of its process; None if other nodelets share it.
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
