# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which nodelets of this process may publish on topics of claims at this moment.

A topic of a claim has one publisher at a time. A DyKnow manager that cannot reach a nodelet
manager replaces its parts of claims, but cannot stop them. So each nodelet manager holds a lease,
which its DyKnow manager renews several times a second, and stops publishing on topics of claims
when the lease has run out. The manager replaces nothing before that
(``dyknow.ros.hosting.grants``).

A lease is counted from a moment of this process's own clock that the manager has confirmed: it
sends back the clock of the last answer that it received. However late a renewal arrives, the
lease ends no later than the manager knows. The clock runs on while the process is stopped, and is
read when a message is published, so a process that goes on after a pause sends nothing first.

A manager that was killed, is being restarted or is stopped replaces nothing either. When renewals
stay away, this process probes the manager's host: one that refuses the connection, or takes it and
does not answer, has no manager at work, and the lease is extended. A silent host may be cut off.
An extension ends before a manager that goes on, or the next one, may judge that the lease is over,
so the process must not be held up for longer than that while the manager is away. A manager that
ends on purpose and leaves the streams as they are grants as long a lease.

Only the manager renews a lease that has run out. It names the nodelets that are to publish; the
other nodelets stay silent on these topics.
"""

from __future__ import annotations

import enum
import functools
import time
from dataclasses import dataclass
from typing import Callable, Iterable, Mapping

from dyknow import names
from dyknow.locks import state_lock
from dyknow.nodelet.streams.endpoints import Fence

DURATION = 2.0  # seconds that a lease holds; a manager that ends on purpose grants longer ones
PROBE_AFTER = 0.8  # seconds without a renewal after which the manager's host is probed
PROBE_AGAIN = 0.3  # seconds from a probe that extends a lease to the next one


class Sight(enum.Enum):
    """The result of probing a manager's host."""

    AT_WORK = enum.auto()
    STOPPED = enum.auto()  # it does not answer, and may go on at any moment
    GONE = enum.auto()  # nothing listens there; the next manager has another address
    SILENT = enum.auto()


#: Seconds, from the probe on, by which a lease is extended if no manager is at work.
EXTENSIONS: Mapping[Sight, float] = {Sight.STOPPED: 1.5, Sight.GONE: 8.0}


def suspended_clock() -> float:
    """Seconds of a steady clock that also runs while the machine is suspended."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


@dataclass(eq=False)
class _Lease:
    """What one manager has granted; replaced as a whole, but for its end."""

    uri: str  # address of the manager's node
    until: float  # when it runs out
    probed_from: float  # when the manager's host is to be probed
    producers: Mapping[str, str]  # by topic of a claim, the nodelet that publishes there
    #: Nodelets, each with a topic, that were replaced while the lease had run out.
    fenced: frozenset[tuple[str, str]]


class Leases:
    """The leases of one process, one for each manager; safe from any thread.

    Args:
        owners: returns the nodelets of this process that publish on a topic.
        guard: called with a fence for each topic of a claim, and for each that may carry another
            form of its messages, whenever these change.
        clock: time that runs on while the process is stopped, in seconds.
    """

    def __init__(
        self,
        owners: Callable[[str], Iterable[str]],
        guard: Callable[[Mapping[str, Fence]], None],
        clock: Callable[[], float] = suspended_clock,
    ) -> None:
        self._owners = owners
        self._guard = guard
        self._clock = clock
        self._state_lock = state_lock("leases")
        self._leases: dict[str, _Lease] = {}
        self._topics: frozenset[str] = frozenset()

    def renew(
        self,
        manager: str,
        uri: str,
        confirmed: float,
        duration: float,
        producers: Mapping[str, str],
    ) -> float:
        """Take a renewal by a manager, the node at ``uri``; return the time of our clock.

        The lease runs out ``duration`` seconds after ``confirmed``, the result of an earlier call
        (0: none is answered yet), or when the one before it runs out, but no later than so many
        seconds from now: the manager counts from our answer. ``producers`` has the nodelet that
        publishes on each topic of a claim; without any the lease ends, and fences none.
        """
        now = self._clock()
        if now > confirmed + PROBE_AFTER:  # of a manager that has gone, perhaps, while we stood
            duration = min(duration, DURATION)
        present = {
            (name, topic)
            for topic in producers
            for each in (topic, *_forms_of(topic))
            for name in self._owners(each)
        }
        with self._state_lock:
            known = self._leases.get(manager)
            if not producers:
                self._leases.pop(manager, None)
            elif known is not None or confirmed:
                until, fenced = confirmed + duration, set()
                if known is not None:
                    # Once it has run out, replaced parts may be among those that publish.
                    fenced = {*known.fenced, *(present if known.until < now else ())}
                    until = max(until, min(known.until, now + duration))
                still = ((n, t) for n, t in fenced & present if producers.get(t, n) != n)
                probed_from = until - duration + PROBE_AFTER
                self._leases[manager] = _Lease(
                    uri, until, probed_from, dict(producers), frozenset(still)
                )
            topics = frozenset(t for each in self._leases.values() for t in each.producers)
            is_new, self._topics = topics != self._topics, topics
        while is_new:
            fences = {t: functools.partial(self.may_publish, topic=t) for t in topics}
            forms = {each: fences[t] for t in fences for each in _forms_of(t)}
            self._guard({**forms, **fences})
            with self._state_lock:  # the fences of another renewal may have come before these
                is_new, topics = topics != self._topics, self._topics
        return self._clock()

    def may_publish(self, nodelet: str, topic: str) -> bool:
        """Whether a nodelet may publish on a topic now; quick, and takes no lock."""
        for lease in tuple(self._leases.values()):
            if topic in lease.producers and (
                (lease.fenced and (nodelet, topic) in lease.fenced) or self._clock() > lease.until
            ):
                return False
        return True

    def watch(self, probe: Callable[[str], Sight]) -> None:
        """Extend leases that are about to run out, where ``probe`` sees no manager at work."""
        now = self._clock()
        for lease in tuple(self._leases.values()):
            if not lease.probed_from < now < lease.until:
                continue
            extension = EXTENSIONS.get(probe(lease.uri), 0.0)
            with self._state_lock:
                if extension and self._clock() < lease.until:
                    lease.until = max(lease.until, now + extension)
                    lease.probed_from = now + PROBE_AGAIN


def _forms_of(topic: str) -> list[str]:
    return [names.below(topic, form) for form in names.FORMS]
