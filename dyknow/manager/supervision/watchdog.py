# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Restarts nodelet managers that hang, have a callback that does not return, or grow too large.

It is there for those who ask for it. Only processes that the DyKnow manager started are restarted,
one at a time, and one of the same name again only after a pause.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Callable, Iterator

from dyknow.backoff import Backoff
from dyknow.errors import DyKnowError
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host, ProcessState
from dyknow.model.graph import STUCK

#: Seconds between two looks.
WATCH_PERIOD = 1.0
#: Seconds of the first pause after a restart, and of the longest.
_PAUSE, _LONGEST_PAUSE = 30.0, 600.0

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class WatchdogLimits:
    """Limits of a process, beyond which it is restarted; 0: none."""

    hung: float = 0.0  # seconds without an answer
    stuck: float = 0.0  # seconds for which a callback is reported that does not return
    memory: float = 0.0  # MB of resident memory

    def __bool__(self) -> bool:
        return (self.hung, self.stuck, self.memory) != (0.0, 0.0, 0.0)


NO_WATCHDOG = WatchdogLimits()
"""Nothing is restarted."""


class Watchdog:
    """Looks at the processes of a host; for one thread at a time.

    ``restart`` restarts one by name, and may raise DyKnowError; ``report`` is called with each
    restart in words. ``now`` returns the seconds for which this process has run: a stopped one has
    received nothing.
    """

    def __init__(
        self,
        host: Host,
        graph: Graph,
        restart: Callable[[str], object],
        limits: WatchdogLimits,
        report: Callable[[str], object],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._host = host
        self._graph = graph
        self._restart = restart
        self._limits = limits
        self._report = report
        self._now = now
        #: Since when something holds of a process, by its incarnation.
        self._since: dict[tuple[str, str], float] = {}
        self._backoff = Backoff(now, _PAUSE, _LONGEST_PAUSE, tolerated=0)

    def look(self) -> float:
        """Restart the first process beyond a limit; returns the seconds until the next look."""
        own = [each for each in self._host.states().values() if each.own and each.alive]
        found = [(each, why) for each in own for why in self._causes(each)]
        known = {each.incarnation for each in own}
        self._since = {key: since for key, since in self._since.items() if key[0] in known}
        for state, why in found:
            if self._backoff.remaining(state.name) <= 0.0:
                self._act(state.name, why)
                break
        return WATCH_PERIOD

    def _causes(self, state: ProcessState) -> Iterator[str]:
        """Say why a process is to be restarted."""
        limits = self._limits
        silent = self._lasts(state, "silent", not state.responsive)
        if 0.0 < limits.hung <= silent:
            yield f"it has not answered for {silent:.0f} s"
        for record in self._graph.all() if limits.stuck and state.responsive else ():
            if record.manager == state.name or record.name == state.name:
                stuck = self._lasts(state, record.name, record.detail.startswith(STUCK))
                if stuck >= limits.stuck:
                    yield f"{record.name}: {record.detail}"
        memory = self._host.memory(state.name) / 1e6 if limits.memory else 0.0
        if memory > limits.memory:
            yield f"it takes {memory:.0f} MB of memory; expected at most {limits.memory:g} MB"

    def _lasts(self, state: ProcessState, what: str, holds: bool) -> float:
        """Return the seconds for which something holds of a process."""
        key = (state.incarnation, what)
        if not holds:
            self._since.pop(key, None)
            return 0.0
        now = self._now()
        return now - self._since.setdefault(key, now)

    def _act(self, name: str, why: str) -> None:
        self._backoff.failed(name)
        text = f"the watchdog restarts {name}: {why}"
        _log.warning("%s", text)
        self._report(text)
        try:
            self._restart(name)
        except DyKnowError as error:
            _log.error("the watchdog could not restart %s: %s", name, error)
