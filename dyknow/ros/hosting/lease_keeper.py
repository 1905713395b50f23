# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Renews the leases of nodelet managers that publish on topics of claims.

What a lease is: ``dyknow.nodelet.leases``. This is the manager's side: while a nodelet manager may
hold a lease it is not taken for lost, although it does not answer. So nothing that it supplies is
replaced before it has certainly stopped publishing. The time is that for which this process has
run itself: a manager that was stopped asks again before it judges.

Who owns what: ``LeaseKeeper`` owns a ``_Renewer`` for each nodelet manager that has published for
a claim. That owns a kept connection and the thread that alone uses it.
"""

from __future__ import annotations

import logging
import time
from functools import partial
from typing import Callable, Collection, Dict, Iterable, Mapping

from dyknow_msgs.srv import RenewLease

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.locks import state_lock
from dyknow.periodic import PeriodicWorker
from dyknow.ros.master import Master
from dyknow.ros.nodelets.lease_service import SERVICE
from dyknow.ros.service_client import ServiceClient, ServiceLost

#: Seconds that a lease holds.
DURATION = 2.0
#: Seconds between the beginnings of two renewals; on a slow link one begins when the last ended.
PERIOD = 0.25
#: The same for a process that has not answered yet, or knows no leases.
_UNCONFIRMED_PERIOD = 1.0
#: Seconds for an answer.
TIMEOUT = 1.0

_log = logging.getLogger("rosout.dyknow")


class LeaseKeeper:
    """The leases that one DyKnow manager grants; every method is safe from any thread."""

    def __init__(
        self,
        master: Master,
        uri: str,
        answers: Callable[[str], bool],
        clock: Callable[[], float],
        on_end: Callable[[], object],
    ) -> None:
        """Grant none yet.

        Args:
            master: where nodelet managers are looked up.
            uri: address of this node.
            answers: whether a nodelet manager answers otherwise: if not it gets no renewal.
            clock: time for which this process has run, in seconds.
            on_end: called when a lease has run out.
        """
        self._master = master
        self._uri = uri
        self._answers = answers
        self._clock = clock
        self._on_end = on_end
        self._state_lock = state_lock("leases that are kept")
        self._producers: Mapping[str, str] = {}
        self._renewers: Dict[str, _Renewer] = {}
        self._began = clock()
        self._is_closed = False

    def grant(self, producers: Mapping[str, str], managers: Iterable[str]) -> None:
        """Let nodelets publish on topics of claims, and no others from the next renewal on.

        Args:
            producers: by topic, the nodelet that publishes there.
            managers: nodelet managers that run these nodelets. They keep a lease from now on.
        """
        made = {each: self._renewer(each) for each in managers if each not in self._renewers}
        with self._state_lock:
            if self._is_closed:
                return
            is_new, self._producers = self._producers != producers, producers
            for manager in made:
                self._renewers.setdefault(manager, made[manager])
            renewers = list(self._renewers.values())
        for renewer in renewers if is_new or made else ():
            renewer.wake()

    def may_publish(self, manager: str) -> bool:
        """Whether a nodelet manager may still hold a lease: it must not be taken for lost."""
        renewer = self._renewers.get(manager)
        if renewer is None:  # an earlier life of this manager may have granted one
            return self._clock() - self._began < DURATION
        return renewer.may_publish()

    def keep(self, managers: Collection[str]) -> None:
        """Grant leases to these nodelet managers alone: all others are gone for good."""
        with self._state_lock:
            gone = [name for name in self._renewers if name not in managers]
            renewers = [self._renewers.pop(name) for name in gone]
        for renewer in renewers:
            renewer.close()

    def release(self) -> None:
        """Take the leases back, so that all may go on: this manager ends on purpose."""
        with self._state_lock:
            self._producers = {}
            renewers = list(self._renewers.values())
        for renewer in renewers:
            renewer.release()

    def close(self) -> None:
        """Renew no more."""
        with self._state_lock:
            self._is_closed = True
        self.keep(())

    def _renewer(self, manager: str) -> _Renewer:
        return _Renewer(
            self._master,
            manager,
            self._request,
            partial(self._answers, manager),
            self._clock,
            self._on_end,
        )

    def _request(self, confirmed: float) -> Dict[str, object]:
        producers = self._producers
        topics = sorted(producers)
        return {
            "uri": self._uri,
            "confirmed": confirmed,
            "duration": DURATION,
            "topics": topics,
            "nodelets": [producers[topic] for topic in topics],
        }


class _Renewer:
    """The lease of one nodelet manager."""

    def __init__(
        self,
        master: Master,
        manager: str,
        request: Callable[[float], Dict[str, object]],
        answers: Callable[[], bool],
        clock: Callable[[], float],
        on_end: Callable[[], object],
    ) -> None:
        self._master = master
        self._manager = manager
        self._request = request
        self._answers = answers
        self._clock = clock
        self._on_end = on_end
        #: When the last answer came. An earlier life may have granted a lease just before ours.
        self._answered = clock()
        self._is_out = False
        #: Asks one process; another one that has the name later has another clock.
        self._client = self._new_client()
        self._confirmed = 0.0
        self._began = time.monotonic()
        self._worker = PeriodicWorker(f"lease of {manager}", self._renew, self._pause, pause=0.0)

    def wake(self) -> None:
        """Renew now; the first time the thread is started."""
        self._worker.start()
        self._worker.wake()

    def may_publish(self) -> bool:
        return self._clock() - self._answered < DURATION

    def release(self) -> None:
        self._worker.close()
        if not self._answers():
            return
        try:
            self._client.call(TIMEOUT, **self._request(0.0))
        except (HostError, PeerTimeout) as error:
            _log.debug("the lease of %s is not taken back: %s", self._manager, error)

    def close(self) -> None:
        self._worker.close()
        self._client.close()

    def _pause(self) -> float:
        period = PERIOD if self._confirmed else _UNCONFIRMED_PERIOD
        return max(0.0, self._began + period - time.monotonic())

    def _renew(self) -> None:
        self._began = time.monotonic()
        try:
            if self._answers():
                is_first = not self._confirmed
                self._call()
                if is_first:  # it only asked for the clock
                    self._call()
        except ServiceLost:
            self._client.close()
            self._client, self._confirmed = self._new_client(), 0.0
        except (HostError, PeerTimeout) as error:
            _log.debug("the lease of %s is not renewed: %s", self._manager, error)
        was_out, self._is_out = self._is_out, not self.may_publish()
        if self._is_out and not was_out:
            self._on_end()

    def _call(self) -> None:
        answer = self._client.call(TIMEOUT, **self._request(self._confirmed))
        self._answered, self._confirmed = self._clock(), answer.clock

    def _new_client(self) -> ServiceClient:
        service = names.join(self._manager, SERVICE)
        return ServiceClient(self._master, service, RenewLease, True, reconnects=False)
