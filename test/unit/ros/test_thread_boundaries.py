# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads go on after any exception in them."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest
import rospy
from clocks import PATIENCE, in_thread, join
from dyknow_msgs.msg import NodeletPorts

from dyknow import periodic
from dyknow.model.graph import Model
from dyknow.ros import stream_session
from dyknow.ros.bonding import bonds
from dyknow.ros.manager.services import ModelTopic
from dyknow.ros.nodelets.announcements import Announcer


class Fault:
    """Raises the first time, and then does its work."""

    def __init__(self, work=lambda *arguments, **kwds: None):
        self._work = work
        self.calls = 0
        self.done = []
        self._condition = threading.Condition()

    def __call__(self, *arguments, **kwds):
        self.calls += 1
        if self.calls == 1:
            raise RuntimeError("injected")
        answer = self._work(*arguments, **kwds)
        with self._condition:
            self.done.append(arguments)
            self._condition.notify_all()
        return answer

    def is_done(self, times=1):
        with self._condition:
            return self._condition.wait_for(lambda: len(self.done) >= times, PATIENCE)


class FakeTopic:
    """Stands for publisher and subscriber; the first publish raises an unexpected error."""

    made = []

    def __init__(self, *arguments, **kwds):
        self.publish = Fault()
        self.made.append(self)

    def unregister(self):
        pass

    def get_num_connections(self):
        return 1


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    monkeypatch.setattr(FakeTopic, "made", [])
    monkeypatch.setattr(rospy, "Publisher", FakeTopic)
    monkeypatch.setattr(rospy, "Subscriber", FakeTopic)
    monkeypatch.setattr(rospy.Time, "now", classmethod(lambda cls: rospy.Time()))
    monkeypatch.setattr(periodic, "RETRY", 0.01)
    monkeypatch.setattr(bonds, "RETRY", 0.01)


@pytest.fixture
def closing():
    things = []
    yield things
    for thing in things:
        thing.close()


@pytest.mark.parametrize("where", ["take", "before", "publish"])
def test_the_model_is_published_although_something_failed(where):
    model = Model(1, 1, ())
    take, before = Fault(lambda: model), Fault()
    messages: Any = SimpleNamespace(topic=lambda model: model)
    topic = ModelTopic(
        take if where == "take" else lambda: model,
        messages,
        before if where == "before" else lambda: None,
    )
    publish = FakeTopic.made[0].publish
    publish.calls = 0 if where == "publish" else 1
    with pytest.raises(RuntimeError, match="injected"):
        topic.publish()
    for _ in range(2):
        topic.publish()
    assert publish.done == [(model,)]


def test_a_change_is_announced_although_it_failed_at_first(closing):
    announcer = Announcer(lambda name: NodeletPorts(name, True, [], "", ""))
    closing.append(announcer)
    announcer.start()
    announcer.announce("/a")
    publish = FakeTopic.made[0].publish
    assert publish.is_done()
    assert "/a" in str(publish.done[0][0])


def test_heartbeats_of_a_client_go_on(monkeypatch, closing):
    monkeypatch.setattr(stream_session.Constants, "DEFAULT_HEARTBEAT_PERIOD", 0.01)
    bond = stream_session.ClientBond("/manager")
    closing.append(bond)
    assert FakeTopic.made[0].publish.is_done(2)


def test_leases_are_renewed_although_one_of_them_raises(monkeypatch, closing):
    monkeypatch.setattr(stream_session, "ClientBond", lambda manager: SimpleNamespace(close=int))
    monkeypatch.setattr(stream_session, "_RETRY", 0.01)
    renew = Fault()
    client: Any = SimpleNamespace(
        manager="/manager", renew_stream=renew, list_streams=lambda: (), close=lambda: None
    )
    session = stream_session.StreamSession.open(client)
    closing.append(session)
    for name in ("first", "second"):
        stream: Any = SimpleNamespace(claim_id=name, lease=0.03)
        session.add(stream)
    assert renew.is_done(4)
    assert {arguments[0] for arguments in renew.done} == {"first", "second"}


def test_bonds_are_served_on(monkeypatch, closing):
    quiet = SimpleNamespace(publish=lambda status: None, unregister=lambda: None)
    monkeypatch.setattr(rospy, "Publisher", lambda *arguments, **kwds: quiet)
    made = bonds.Bonds("/bond")
    tick = Fault(made._table.tick)
    monkeypatch.setattr(made._table, "tick", tick)
    made.add("b", lambda: None)
    assert tick.is_done()
    join(in_thread(lambda: made.close(0.01)))
