# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Guards count as handed over once the master has confirmed it; until then nothing is loaded."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any, cast
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from unit.manager.hand_clock import HandClock

from dyknow.errors import HostError
from dyknow.guards import Guards
from dyknow.manager.host import LoadRequest, ManagerState
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting.guard_handover import PERIOD, GuardHandover
from dyknow.ros.hosting.host import RosHost
from dyknow.ros.master import Master
from dyknow.ros.transport.registrar import Registrar

NODELET_MANAGER = "/nodelet_manager"
KEY = "/nodelet_manager/guards/manager"


class SlowMaster:
    """A master's parameter server that answers late until the test ends that."""

    def __init__(self):
        self.parameters = {}
        self.is_late = threading.Event()
        self._woken = threading.Event()
        self._server = SimpleXMLRPCServer(("localhost", 0), logRequests=False)
        self._server.register_function(self._set, "setParam")
        self._server.register_function(self._get, "getParam")
        self._server.register_function(lambda caller, name: [-1, "unknown", 0], "lookupService")
        self.uri = f"http://localhost:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def _set(self, caller, key, value):
        if self.is_late.is_set():
            self._woken.wait(30.0)
            return [-1, "too late", 0]
        self.parameters[key] = value
        return [1, "", 0]

    def _get(self, caller, key):
        return [1, "", self.parameters[key]] if key in self.parameters else [-1, "not set", 0]

    def wake(self):
        self.is_late.clear()
        self._woken.set()

    def close(self):
        self.wake()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class OneChild:
    """A single nodelet manager, which is up."""

    def __init__(self):
        record = SimpleNamespace(
            name=NODELET_MANAGER, kind=NodeletKind.PYTHON, isolated_for="", process=None
        )
        self._child = SimpleNamespace(record=record, incarnation="1", rewirable=True)

    def all(self):
        return [self._child]

    def await_up(self, name, timeout):
        """It is."""


def host_of(master, timeout, guards):
    asked = Master("/manager", master.uri, timeout)
    return RosHost(asked, cast(Any, OneChild()), Registrar(asked), guards=guards)


@pytest.fixture
def master():
    master = SlowMaster()
    yield master
    master.close()


def test_guards_that_were_not_taken_are_handed_over_again(master):
    guards = Guards(denied_topics=("/e_stop",), read_only=True)
    host = host_of(master, 0.3, guards)
    request = LoadRequest("/nodelet", "package/Class")
    master.is_late.set()
    assert [state.name for state in host.managers()] == [NODELET_MANAGER]
    assert KEY not in master.parameters
    with pytest.raises(HostError, match="does not have the guards yet"):
        host.load(NODELET_MANAGER, request, 1.0)

    master.wake()
    deadline = time.monotonic() + 30.0
    while KEY not in master.parameters and time.monotonic() < deadline:
        host.managers()  # the next looks
    assert master.parameters[KEY]["denied_topics"] == ["/e_stop"]
    assert master.parameters[KEY]["read_only"] is True
    with pytest.raises(HostError, match="is not offered"):  # it reaches its request for a list
        host.load(NODELET_MANAGER, request, 1.0)


@pytest.mark.parametrize("change", [dict.clear, lambda found: found.update(denied_topics=[])])
def test_guards_that_are_missing_or_changed_are_handed_over_again(master, change):
    clock = HandClock()
    guards = Guards(denied_topics=("/e_stop",), allowed_topics=(("/a/*",),))
    handover = GuardHandover(Master("/manager", master.uri, 30.0), guards, clock)
    state = ManagerState(NODELET_MANAGER, NodeletKind.PYTHON, "1")
    handover.hand_over(state)
    given = dict(master.parameters[KEY])
    clock.time += PERIOD
    handover.hand_over(state)
    assert master.parameters[KEY] == given
    change(master.parameters[KEY])
    handover.hand_over(state)
    assert master.parameters[KEY] != given, "not at every look: each costs an answer of the master"
    clock.time += PERIOD
    handover.hand_over(state)
    assert master.parameters[KEY] == given
