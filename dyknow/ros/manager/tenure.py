# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which of two DyKnow managers of one name goes on.

A manager that finds a living one of its name does not start. During a split it cannot find it, so
there are two once the network is whole again. The ROS master then has the name's last
registration, and asks the process before it to end. Neither takes that for a user's order: the
elder goes on, and the other one leaves.

The parameter ``~tenure`` decides between them. Each manager writes it when it starts, with a
number one higher than it found; a manager that finds another entry restores its own if that is the
lower one, and leaves if it is the higher one. So both decide alike, by the master alone, and no
clocks are compared as long as there are numbers.

The elder lost its registrations, and maybe parameters, when the other one started. It puts the
parameters back and registers again by restarting in the same process: that is the way back from
``kill -9``, which no stream notices.
"""

from __future__ import annotations

import contextlib
import enum
import os
import socket
import time
from typing import Any, Callable, Mapping, NamedTuple

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.periodic import ControlLoop
from dyknow.ros.wire.master import Master

#: Its key in the manager's control loop.
KEY = "looking who bears our name"
#: Private parameter of the manager.
PARAMETER = "tenure"
#: Seconds between two looks, and for the master's answers.
PERIOD = 1.0
#: Seconds for which another process may bear the name without an entry of its own.
PATIENCE = 3.0
#: Variable of the environment with the entry of a process that starts again.
VARIABLE = "DYKNOW_TENURE"


class TenureEntry(NamedTuple):
    """The entry of one manager; the elder's is the lower one.

    Attributes:
        generation: one more than that of the entry before.
        started: time of its start (s, by its own clock), should the parameter have been lost.
        place: its host and process.
    """

    generation: int
    started: float
    place: str

    @classmethod
    def of(cls, value: object) -> TenureEntry | None:
        """Read a value of the parameter server; None if it is not an entry."""
        if not isinstance(value, (list, tuple)) or len(value) != len(cls._fields):
            return None
        try:
            return cls(int(value[0]), float(value[1]), str(value[2]))
        except (TypeError, ValueError):
            return None


class TenureVerdict(enum.Enum):
    """A manager's next step about its name."""

    HOLD = enum.auto()
    LEAVE = enum.auto()
    RETURN = enum.auto()


class Tenure:
    """One manager's right to its name."""

    def __init__(
        self,
        name: str,
        master: Master | None = None,
        kept: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare; ``take`` comes before the node registers. ``kept`` is from ``VARIABLE``."""
        self.name = name
        self._master = master or Master(name, timeout=PERIOD)
        self._clock = clock
        #: Our entry; None until it is taken.
        self.entry = TenureEntry.of(kept.split(maxsplit=2))
        #: Whether this process bore the name before it started again.
        self.is_resumed = self.entry is not None
        self._uri = ""
        self._lost_at: float | None = None

    @property
    def variables(self) -> Mapping[str, str]:
        return {VARIABLE: " ".join(map(str, self.entry))} if self.entry is not None else {}

    def take(self) -> None:
        """Write an entry after the one that is there; later, if the master does not answer."""
        try:
            found = self._read()
            if self.entry is None:
                generation = found.generation + 1 if found is not None else 1
                place = f"{socket.gethostname()}:{os.getpid()}"
                self.entry = TenureEntry(generation, time.time(), place)
            self._write()
        except PeerTimeout:
            return  # the first look takes it

    def look(self) -> TenureVerdict:
        """Decide by the master's present answers; a master that is away changes nothing."""
        try:
            if self.entry is None:
                self.take()
                return TenureVerdict.HOLD
            found, uri = self._ask()
            if found == self.entry:
                return self._holding(uri)
            if found is None:
                self._write()
                return TenureVerdict.HOLD
            return TenureVerdict.LEAVE if found < self.entry else TenureVerdict.RETURN
        except (LookupError, PeerTimeout):
            return TenureVerdict.HOLD

    def watch(
        self, loop: ControlLoop, uri: str, leave: Callable[[], None], come_back: Callable[[], None]
    ) -> None:
        """Look periodically, as ``KEY`` of the loop, and call ``leave`` or ``come_back``."""
        self._uri = uri

        def look() -> float | None:
            verdict = self.look()
            if verdict is TenureVerdict.HOLD:
                return PERIOD
            (leave if verdict is TenureVerdict.LEAVE else come_back)()
            return None

        loop.add(KEY, look, PERIOD)

    def take_back(self, parameters: Any) -> None:
        """Put the parameters of the name back as they were, with our entry."""
        assert self.entry is not None
        own = parameters if isinstance(parameters, dict) else {}
        with contextlib.suppress(LookupError, PeerTimeout):  # then the next life finds it lost
            self._master.ask("setParam", self.name, {**own, PARAMETER: list(self.entry)})

    def give_back(self) -> None:
        """Remove our entry, at an end on purpose."""
        try:
            if self._read() == self.entry:
                self._master.ask("deleteParam", self._key)
        except (LookupError, PeerTimeout):
            return  # the ROS master is gone

    # Inside

    def _holding(self, uri: str) -> TenureVerdict:
        """Whether a process without an entry has taken the name, and does not return it.

        ``uri`` is the address of the name.

        That is a manager of ours that registered something before it looked, or a stranger.
        """
        if not self._uri or uri in ("", self._uri):
            self._lost_at = None
            return TenureVerdict.HOLD
        if self._lost_at is None:
            self._lost_at = self._clock()
        is_late = self._clock() - self._lost_at >= PATIENCE
        return TenureVerdict.RETURN if is_late else TenureVerdict.HOLD

    @property
    def _key(self) -> str:
        return names.join(self.name, PARAMETER)

    def _ask(self) -> tuple[TenureEntry | None, str]:
        """Return the entry that is there and the address of the name, as of one moment."""
        entry, uri = self._master.ask_all(
            [("getParam", self.name, self._key), ("lookupNode", self.name, self.name)]
        )
        return TenureEntry.of(entry), uri or ""

    def _read(self) -> TenureEntry | None:
        try:
            return TenureEntry.of(self._master.ask("getParam", self._key))
        except LookupError:
            return None

    def _write(self) -> None:
        assert self.entry is not None
        self._master.ask("setParam", self._key, list(self.entry))
