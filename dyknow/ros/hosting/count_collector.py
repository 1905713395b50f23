# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Asks nodelet managers, side by side, how many messages their nodelets have sent.

Who owns what: ``CountCollector`` owns a ``_CountClient`` for each nodelet manager. That owns a
kept connection and a thread, which alone uses it. A caller waits for all answers together at most
``PATIENCE``, and not at all for a nodelet manager that took longer the last time; a late answer is
returned by the next call.
"""

from __future__ import annotations

import math
import time
from typing import Collection, Dict, List, Mapping, Optional, Set

from dyknow_msgs.msg import Port
from dyknow_msgs.srv import GetCounts

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import Count
from dyknow.model.transformation import OUT
from dyknow.periodic import PeriodicWorker
from dyknow.ros.client import ProxyClient
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Service of our nodelet managers.
SERVICE = "get_counts"
#: Seconds that a caller waits for all answers together.
PATIENCE = 0.5
#: Seconds for one nodelet manager's answer; no caller waits that long.
TIMEOUT = 2.0
#: Nodelets that are asked about by name; there is a limit to the size of a request.
_MOST_NAMED = 500
#: Seconds without an answer after which a connection may be one to a process that is gone.
_STALE = 10.0
#: Seconds without a question after which a connection is closed until the next.
_IDLE = 10.0

Counts = Dict[str, Optional[Mapping[str, Count]]]
"""By nodelet, the counts of its out-ports; None for one that is not there."""


class CountCollector:
    """Clients of nodelet managers; every method is safe from any thread."""

    def __init__(self, master: Master) -> None:
        """Make clients when they are needed; ``master`` looks nodelet managers up."""
        self._master = master
        self._state_lock = state_lock("count collector")
        self._clients: Dict[str, _CountClient] = {}

    def counts(self, wanted: Mapping[str, Collection[str]]) -> Counts:
        """Return counts as ``Host.counts`` does."""
        deadline = time.monotonic() + PATIENCE
        clients = {manager: self._client_of(manager) for manager in sorted(wanted)}
        questions = {manager: clients[manager].ask(wanted[manager]) for manager in clients}
        found: Counts = {}
        for manager, number in questions.items():
            found.update(clients[manager].answers(number, wanted[manager], deadline))
        return found

    def keep(self, managers: Collection[str]) -> None:
        """Close the connections to all other nodelet managers: they are gone for good."""
        with self._state_lock:
            gone = [name for name in self._clients if name not in managers]
            clients = [self._clients.pop(name) for name in gone]
        for client in clients:
            client.close()

    def close(self) -> None:
        """Close all connections; answers that are due are not waited for."""
        self.keep(())

    def _client_of(self, manager: str) -> _CountClient:
        with self._state_lock:
            client = self._clients.get(manager)
            if client is None:
                client = self._clients[manager] = _CountClient(self._master, manager)
        client.start()
        return client


class _CountClient:
    """Questions to one nodelet manager, one after the other."""

    def __init__(self, master: Master, manager: str) -> None:
        self._proxies = ProxyClient(master)
        self._client = ServiceClient(master, names.join(manager, SERVICE), GetCounts, True)
        self._state_lock = state_lock("counts")
        self._wanted: Set[str] = set()
        self._fresh: Counts = {}
        self._asked = self._answered = time.monotonic()
        self._in_time = True
        self._worker = PeriodicWorker(
            f"message counts of {manager}", self._round, _IDLE, pause=0.0
        )
        self.start = self._worker.start

    def ask(self, nodelets: Collection[str]) -> int:
        """Ask once the last answer is there; returns the number of the question."""
        with self._state_lock:
            self._wanted.update(nodelets)
        return self._worker.wake()

    def answers(self, number: int, nodelets: Collection[str], deadline: float) -> Counts:
        """Wait for the answer to a question, unless that may take long; returns what is new."""
        if self._in_time:
            left = max(0.0, deadline - time.monotonic())
            self._in_time = self._worker.wait_for(number, left)
        with self._state_lock:
            return {name: self._fresh.pop(name) for name in nodelets if name in self._fresh}

    def close(self) -> None:
        """Ask no more."""
        self._worker.close()
        self._client.close()

    def _round(self) -> None:
        with self._state_lock:
            nodelets, self._wanted = sorted(self._wanted), set()
        began = time.monotonic()
        if not nodelets:
            if began - self._asked >= _IDLE:
                self._client.close()
            return
        self._asked = began
        found = self._question(nodelets)
        with self._state_lock:
            self._fresh.update(found)
        self._in_time = time.monotonic() - began <= PATIENCE

    def _question(self, nodelets: List[str]) -> Counts:
        asked = time.monotonic()
        named = nodelets if len(nodelets) <= _MOST_NAMED else []  # an empty list asks for all
        try:
            answer = self._client.call(TIMEOUT, named)
        except PeerTimeout:
            if time.monotonic() - self._answered >= _STALE:
                self._client.close()
                self._answered = time.monotonic()
            return {}
        except (ServiceLost, ServiceFailed):  # it may be one without this service
            return self._one_by_one(nodelets)
        answered = self._answered = time.monotonic()
        found: Counts = dict.fromkeys(nodelets)
        for each in answer.nodelets:
            if each.nodelet in found:
                found[each.nodelet] = {
                    port.port: Count(
                        port.messages,
                        asked,
                        answered,
                        port.latched,
                        None if math.isnan(port.age) else port.age,
                    )
                    for port in each.ports
                    if port.direction == Port.OUT
                }
        return found

    def _one_by_one(self, nodelets: List[str]) -> Counts:
        """Ask each nodelet's proxy, which does not say what is latched, or how old."""
        found: Counts = {}
        for name in nodelets:
            asked = time.monotonic()
            try:
                ports = self._proxies.get_statistics(name, TIMEOUT).ports
            except PeerTimeout:
                break  # each of the others would take that long
            except HostError:
                found[name] = None
                continue
            answered = time.monotonic()
            found[name] = {
                port.port: Count(port.messages or 0, asked, answered)
                for port in ports
                if port.direction == OUT
            }
        return found
