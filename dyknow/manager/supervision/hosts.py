# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Hosts: which are there, for how long, and which are left alone since they were away too often.

A host is away while none of its processes answers. Its nodelets are lost then, and the parts of
claims are replaced elsewhere. When it is back it is used again: at once after the first time, and
after a pause that doubles with each further one. So a host that comes and goes does not take the
streams along each time. The pause is a preference: where there is no other host, it is used.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any, Callable, Iterable, Iterator, Mapping

from dyknow.backoff import Backoff
from dyknow.errors import HostError
from dyknow.locks import state_lock
from dyknow.manager.host import Host, ProcessState
from dyknow.manager.record import Record
from dyknow.model.graph import NodeletKind
from dyknow.model.hosts import HostStatus

#: Seconds of the first pause of a host that has come back again, and of the longest.
_FIRST_PAUSE, _LONGEST_PAUSE = 15.0, 600.0
#: Seconds for which a host has to stay before its earlier absences are forgiven.
_FORGIVEN_AFTER = 300.0


class HostTable:
    """The hosts of the processes that a manager knows; safe from any thread."""

    def __init__(self, host: Host, clock: Callable[[], float]) -> None:
        """Know our own host alone, with a steady clock in seconds."""
        self._host = host
        self._clock = clock
        self._state_lock = state_lock("hosts")
        #: Hosts that were away too often lately to be relied on, as of the last look.
        self.paused: frozenset[str] = frozenset()
        self._absences = Backoff(clock, _FIRST_PAUSE, _LONGEST_PAUSE, _FORGIVEN_AFTER)
        self._places: dict[str, str] = {}  # the host of each process, also of one that has ended
        #: Whether each host is away, and since when it is as it is.
        self._since = {host.here: (False, clock())}

    def look(self, states: Mapping[str, ProcessState]) -> None:
        """Note which hosts answer, and which have gone or come back."""
        held = {name for name, each in states.items() if self._host.may_publish(name)}
        now = self._clock()
        with self._state_lock:
            self._places = {
                name: each.host or self._places.get(name, "") for name, each in states.items()
            }
            here = {self._places[each.name] for each in states.values() if _answers(each)}
            here.add(self._host.here)
            undecided = {self._places[name] for name in held}
            known = {self._host.here, *filter(None, self._places.values())}
            self._since = {name: self._since.get(name, (False, now)) for name in known}
            changed = {
                name: (name not in here, now - since)
                for name, (was_away, since) in self._since.items()
                if was_away is not (name not in here) and (was_away or name not in undecided)
            }
            self._since.update((name, (is_away, now)) for name, (is_away, _) in changed.items())
        for name, (is_away, seconds) in changed.items():
            if is_away:
                self._absences.served(name, seconds)
            else:
                self._absences.failed(name)
        self.paused = self._absences.paused

    def check(self, name: str, kind: NodeletKind) -> None:
        """Raise HostError if a nodelet of a kind cannot be made on a host."""
        if name == self._host.here:
            return
        states = self._host.states()
        if name not in {each.host for each in states.values()}:
            for each in states.values():  # one may have been started just now
                if not each.alive:
                    self._host.look_for(each.name)
            self.look(self._host.states())
        with self._state_lock:
            known = sorted(self._since)
        if name not in known:
            raise HostError(f"unknown host '{name}'; known: {', '.join(known)}")
        if not any(self.managers(name, kind)):
            running = [e for e in self._host.states().values() if e.alive and e.host == name]
            if any(each.kind is kind and _answers(each) for each in running):
                raise HostError(
                    f"the nodelet managers of host '{name}' for {kind.title}s have no live ports: "
                    "name one, or start one of 'rosrun dyknow cpp_nodelet_manager' there"
                )
            if any(map(_answers, running)):
                raise HostError(
                    f"no nodelet manager on host '{name}' hosts {kind.title}s; start one there, "
                    "and name it in ~nodelet_managers"
                )
            raise HostError(f"host '{name}' does not answer")

    def managers(self, name: str, kind: NodeletKind) -> Iterator[ProcessState]:
        """Yield the shared nodelet managers for a kind that answer, on one host or, if '', all."""
        for state in self._host.states().values():
            fits = state.kind is kind and state.rewirable
            fits = fits and not (state.isolated_for or state.foreign)
            if fits and state.alive and state.responsive and name in ("", state.host):
                yield state

    def all(self, records: Iterable[Record]) -> tuple[HostStatus, ...]:
        """Describe every host, by name."""
        states, records, now = self._host.states(), list(records), self._clock()
        with self._state_lock:
            since, places = dict(self._since), dict(self._places)
        places.update((each.name, each.host) for each in states.values() if each.host)
        return tuple(
            HostStatus(
                name,
                name == self._host.here,
                is_away,
                now - began,
                pause=self._absences.remaining(name),
                address=self._host.address_of(name),
                nodelets=tuple(e.name for e in records if places.get(e.manager) == name),
                pinned=tuple(e.name for e in records if e.pinned and e.pinned == name),
                **_facts([e for e in states.values() if places.get(e.name) == name]),
            )
            for name, (is_away, began) in sorted(since.items())
        )


def _answers(state: ProcessState) -> bool:
    return state.alive and state.responsive


def _facts(states: list[ProcessState]) -> dict[str, Any]:
    """Return the facts of a host that its processes state; the surest clock counts."""
    running = [each for each in states if each.alive]
    found: dict[str, Any] = {
        "managers": tuple(sorted(each.name for each in running if not each.kind.is_node))
    }
    stated = [each for each in running if not math.isnan(each.clock.error)]
    if stated:
        best = min(stated, key=lambda each: each.clock.error)
        found.update(**asdict(best.machine), **asdict(best.clock))
    return found
