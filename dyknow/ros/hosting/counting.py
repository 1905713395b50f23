"""Asks nodelet managers, side by side, how many messages their nodelets have sent.

Who owns what: ``Counting`` owns a line to each nodelet manager; a line owns a kept connection and
a thread, which alone uses it. Whoever asks waits for a line at most ``PATIENCE``, and not at all
for one that took longer the last time: its answer is picked up by whoever asks next.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import Collection, Dict, List, Mapping, Optional, Set

from dyknow_msgs.msg import Port
from dyknow_msgs.srv import GetCounts, GetStatistics

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import Count
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Service of our nodelet managers.
SERVICE = "get_counts"
#: Seconds that whoever asks waits for all answers together.
PATIENCE = 0.5
#: Seconds for one nodelet manager's answer, which nobody waits for so long.
TIMEOUT = 2.0
#: Nodelets that are asked about by name; there is a limit to what a request may hold.
_MOST_NAMED = 500
#: Seconds without an answer after which a connection may be one to a process that is gone.
_STALE = 10.0
#: Seconds without a question after which a line is given up until the next.
_IDLE = 10.0

Counts = Dict[str, Optional[Mapping[str, Count]]]
"""By nodelet, the counts of its out-ports; None for one that is not there."""

_log = logging.getLogger("rosout.dyknow")


class Counting:
    """Lines to nodelet managers; every method is safe from any thread."""

    def __init__(self, master: Master) -> None:
        """Ask nobody yet."""
        self._master = master
        self._lock = threading.Lock()
        self._lines: Dict[str, _Line] = {}

    def counts(self, wanted: Mapping[str, Collection[str]]) -> Counts:
        """Do what ``Host.counts`` says."""
        deadline = time.monotonic() + PATIENCE
        with self._lock:
            lines = {
                manager: self._lines.setdefault(manager, _Line(self._master, manager))
                for manager in sorted(wanted)
            }
        questions = {manager: lines[manager].ask(wanted[manager]) for manager in lines}
        found: Counts = {}
        for manager, number in questions.items():
            found.update(lines[manager].answers(number, wanted[manager], deadline))
        return found

    def forget(self, manager: str) -> None:
        """Give up the line to a nodelet manager that is gone for good."""
        with self._lock:
            line = self._lines.pop(manager, None)
        if line is not None:
            line.close()

    def close(self) -> None:
        """Give up all lines; answers that are due are not waited for."""
        for manager in list(self._lines):
            self.forget(manager)


class _Line:
    """Questions to one nodelet manager, one after the other."""

    def __init__(self, master: Master, manager: str) -> None:
        self._master = master
        self._client = ServiceClient(master, names.join(manager, SERVICE), GetCounts, True)
        self._changed = threading.Condition()
        self._wanted: Set[str] = set()
        self._asked = 0
        self._answered = 0
        self._fresh: Counts = {}
        self._heard = time.monotonic()
        self._in_time = True
        self._running = False
        self._closed = False

    def ask(self, nodelets: Collection[str]) -> int:
        """Ask once the last answer is there; returns the number of the question."""
        with self._changed:
            self._wanted.update(nodelets)
            if not self._running and not self._closed:
                self._running = True
                threading.Thread(target=self._run, name="message counts", daemon=True).start()
            self._changed.notify_all()
            return self._asked + 1

    def answers(self, number: int, nodelets: Collection[str], deadline: float) -> Counts:
        """Wait for the answer to a question, unless that may take long; returns what is new."""
        with self._changed:
            if self._in_time:
                left = max(0.0, deadline - time.monotonic())
                self._in_time = self._changed.wait_for(
                    lambda: self._answered >= number or self._closed, left
                )
            return {name: self._fresh.pop(name) for name in nodelets if name in self._fresh}

    def close(self) -> None:
        """Ask no more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted or self._closed, _IDLE)
                if self._closed or not self._wanted:
                    self._running = False
                    self._client.close()
                    return
                nodelets, self._wanted = sorted(self._wanted), set()
                self._asked += 1
            began = time.monotonic()
            found = self._question(nodelets)
            with self._changed:
                self._answered = self._asked
                self._fresh.update(found)
                self._in_time = time.monotonic() - began <= PATIENCE
                self._changed.notify_all()

    def _question(self, nodelets: List[str]) -> Counts:
        try:
            asked = time.monotonic()
            try:
                named = nodelets if len(nodelets) <= _MOST_NAMED else []  # else all are told of
                answer = self._client.call(TIMEOUT, named)
            except (ServiceLost, ServiceFailed):  # it may be one that does not have the service
                return self._one_by_one(nodelets)
            answered = self._heard = time.monotonic()
        except PeerTimeout:
            if time.monotonic() - self._heard >= _STALE:
                self._client.close()
                self._heard = time.monotonic()
            return {}
        except Exception:  # the boundary of the thread: the next question may do better
            _log.exception("counting messages failed")
            return {}
        found: Counts = dict.fromkeys(nodelets)
        for each in answer.nodelets:
            if each.nodelet not in found:
                continue
            found[each.nodelet] = {
                port.port: Count(port.messages, asked, answered, port.latched)
                for port in each.ports
                if port.direction == Port.OUT
            }
        return found

    def _one_by_one(self, nodelets: List[str]) -> Counts:
        """Ask each nodelet's proxy; which of its messages are latched it does not say."""
        found: Counts = {}
        for name in nodelets:
            client = ServiceClient(self._master, names.join(name, "get_statistics"), GetStatistics)
            asked = time.monotonic()
            try:
                ports = client.call(TIMEOUT).ports
            except PeerTimeout:
                break  # each of the others would take that long
            except HostError:
                found[name] = None
                continue
            answered = time.monotonic()
            found[name] = {
                port.port: Count(port.messages, asked, answered)
                for port in ports
                if port.direction == Port.OUT
            }
        return found
