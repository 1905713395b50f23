# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Moves nodelets that compute much apart: one interpreter runs one of them at a time.

It is there for those who ask for it. The nodelets of the manager's own nodelet managers are moved,
one at a time, and none ever returns to a nodelet manager that it has left.
"""

from __future__ import annotations

import collections
import logging
import time
from dataclasses import dataclass
from typing import Callable, Deque, Iterable, Mapping, NamedTuple

from dyknow.backoff import Backoff
from dyknow.errors import DyKnowError
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host, ProcessState, Usage
from dyknow.manager.record import Record
from dyknow.manager.supervision.restarts import is_movable
from dyknow.model.graph import NodeletKind
from dyknow.model.transformation import FORMULA_CLASS

#: Seconds between two looks.
SPREAD_PERIOD = 1.0
#: Seconds over which the load is measured; they begin again with each move.
WINDOW = 5.0
#: Cores by which a move has to lower the load of the busier of its two processes.
MARGIN = 0.1
#: Seconds that a nodelet stays after its first move, and at most; they double.
_STAY, _LONGEST_STAY = 60.0, 3600.0

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class _Load:
    """The load of a process, in cores."""

    state: ProcessState  # the process
    cpu: float  # its processor time
    #: Time in callbacks, by nodelet; it includes waiting for the interpreter.
    busy: Mapping[str, float]

    @property
    def of_nodelets(self) -> float:
        """The part that is known to be its nodelets'."""
        return min(self.cpu, sum(self.busy.values()))

    def share(self, name: str) -> float:
        """The processor time of one nodelet, estimated from its time in callbacks."""
        busy = self.busy.get(name, 0.0)
        return min(busy, self.cpu * busy / max(sum(self.busy.values()), 1e-9))


class _Move(NamedTuple):
    """A possible move: the load of the busier process afterwards, the nodelet, where it goes."""

    load: float
    name: str
    target: str


class Spread:
    """Looks at the loads of processes; for one thread at a time.

    ``move`` moves a nodelet to a nodelet manager, and may raise DyKnowError; ``report`` is called
    with each move in words. One is moved if the nodelets of a process take more than ``limit``
    cores. There may be ``most`` nodelet managers of the manager's own for Python nodelets. ``now``
    returns the seconds for which this process has run.
    """

    def __init__(
        self,
        host: Host,
        graph: Graph,
        move: Callable[[str, str], object],
        report: Callable[[str], object],
        limit: float,
        most: int,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._host = host
        self._graph = graph
        self._move = move
        self._report = report
        self._limit = limit
        self._most = most
        self._usage: dict[str, Deque[Usage]] = {}  # by incarnation
        #: By nodelet, the incarnations of the processes that it has left.
        self._left: dict[str, frozenset[str]] = {}
        self._stays = Backoff(now, _STAY, _LONGEST_STAY, tolerated=0)

    def look(self) -> float:
        """Move the nodelet that helps most, if one does; returns the time to the next look (s)."""
        own = [
            each
            for each in self._host.states().values()
            if each.own and each.kind is NodeletKind.PYTHON and not each.isolated_for
        ]
        loads = self._loads(own)
        if len(loads) == len(own) and all(each.responsive for each in own):
            for load in sorted(loads, key=lambda each: (-each.cpu, each.state.name)):
                if load.of_nodelets > self._limit and self._relieve(load, loads):
                    break
        return SPREAD_PERIOD

    def _loads(self, own: Iterable[ProcessState]) -> list[_Load]:
        """Return the loads of the processes that have been measured for long enough."""
        states = {each.incarnation: each for each in own if each.alive}
        self._usage = {key: each for key, each in self._usage.items() if key in states}
        latest = self._host.usage()
        loads = []
        for incarnation, state in states.items():
            samples = self._usage.setdefault(incarnation, collections.deque())
            new = latest.get(state.name)
            if new is not None and (not samples or new.moment > samples[-1].moment):
                samples.append(new)
            while len(samples) > 2 and samples[1].moment <= samples[-1].moment - WINDOW:
                samples.popleft()
            if samples and samples[-1].moment - samples[0].moment >= WINDOW:
                loads.append(_load(state, samples[0], samples[-1]))
        return loads

    def _relieve(self, load: _Load, loads: Iterable[_Load]) -> bool:
        """Move a nodelet out of a process, or start a further one; returns whether it did."""
        records = {each.name: each for each in self._graph.all()}
        self._left = {name: each for name, each in self._left.items() if name in records}
        candidates = [
            name
            for name in load.busy
            if name in records and _may_move(records[name]) and self._stays.allows(name)
        ]
        targets = [
            each
            for each in loads
            if each is not load and each.state.host == load.state.host and each.state.rewirable
        ]
        best = min(
            (
                _Move(_after(load, name, target.cpu), name, target.state.name)
                for name in candidates
                for target in targets
                if target.state.incarnation not in self._left.get(name, ())
            ),
            default=None,
        )
        if best is not None and best.load <= load.cpu - MARGIN:
            self._act(load, best)
            return True
        helped = any(_after(load, name, 0.0) <= load.cpu - MARGIN for name in candidates)
        if helped and len([*loads]) < self._most:
            _log.info("a further nodelet manager is started, since %s is busy", load.state.name)
            self._host.widen(NodeletKind.PYTHON)
            return True
        return False

    def _act(self, load: _Load, best: _Move) -> None:
        source = load.state
        text = (
            f"{best.name} is moved from {source.name} to {best.target}: it takes "
            f"{load.share(best.name):.2f} of the {load.cpu:.2f} cores that {source.name} takes"
        )
        _log.info("%s", text)
        self._usage.clear()
        self._stays.failed(best.name)
        try:
            self._move(best.name, best.target)
        except DyKnowError as error:
            _log.error("%s", error)
        else:
            self._report(text)
            left = self._left.get(best.name, frozenset())
            self._left[best.name] = left | {source.incarnation}


def _load(state: ProcessState, first: Usage, last: Usage) -> _Load:
    seconds = last.moment - first.moment
    busy = {
        name: max(0.0, last.busy[name] - first.busy[name]) / seconds
        for name in last.busy
        if name in first.busy
    }
    return _Load(state, max(0.0, last.cpu - first.cpu) / seconds, busy)


def _after(load: _Load, name: str, target: float) -> float:
    """The load of the busier of two processes after a nodelet has moved between them."""
    share = load.share(name)
    return max(load.cpu - share, target + share)


def _may_move(record: Record) -> bool:
    """Whether a nodelet may be moved without a request.

    A protected one stays where it is, one whose files have changed stays as it is, and a formula
    would forget the states that it has seen.
    """
    return (
        is_movable(record)
        and not (record.is_protected or record.outdated)
        and record.transformation is not None
        and record.transformation.source != FORMULA_CLASS
    )
