# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads go on after any exception in them."""

from __future__ import annotations

from contextlib import closing
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest
import rospy
from clocks import eventually, in_thread, join
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
        self.is_due = True
        self.done = []

    def __call__(self, *arguments, **kwds):
        if self.is_due:
            self.is_due = False
            raise RuntimeError("injected")
        self.done.append(arguments)
        return self._work(*arguments, **kwds)


@pytest.fixture(autouse=True)
def topic(monkeypatch):
    """Stands for publishers and subscribers; its first publish raises an unexpected error."""
    topic = mock.Mock(publish=Fault(), get_num_connections=lambda: 1)
    monkeypatch.setattr(rospy, "Publisher", lambda *arguments, **options: topic)
    monkeypatch.setattr(rospy, "Subscriber", lambda *arguments, **options: topic)
    monkeypatch.setattr(rospy.Time, "now", classmethod(lambda cls: rospy.Time()))
    monkeypatch.setattr(periodic, "RETRY", 0.01)
    monkeypatch.setattr(bonds, "RETRY", 0.01)
    return topic


@pytest.mark.parametrize("where", ["take", "before", "publish"])
def test_the_model_is_published_although_something_failed(topic, where):
    model = Model(1, 1, ())
    take, before = Fault(lambda: model), Fault()
    take.is_due, before.is_due = where == "take", where == "before"
    topic.publish.is_due = where == "publish"
    messages: Any = SimpleNamespace(topic=lambda model: model)
    models = ModelTopic(take, messages, before)
    with pytest.raises(RuntimeError, match="injected"):
        models.publish()
    for _ in range(2):
        models.publish()
    assert topic.publish.done == [(model,)]


def test_a_change_is_announced_although_it_failed_at_first(topic):
    with closing(Announcer(lambda name: NodeletPorts(name, True, [], "", ""))) as announcer:
        announcer.start()
        announcer.announce("/a")
        eventually(lambda: topic.publish.done)
    assert "/a" in str(topic.publish.done[0][0])


def test_heartbeats_of_a_client_go_on(topic, monkeypatch):
    monkeypatch.setattr(stream_session.Constants, "DEFAULT_HEARTBEAT_PERIOD", 0.01)
    with closing(stream_session.ClientBond("/manager")):
        eventually(lambda: len(topic.publish.done) >= 2)


def test_leases_are_renewed_although_one_of_them_raises(monkeypatch):
    monkeypatch.setattr(stream_session, "ClientBond", lambda manager: SimpleNamespace(close=int))
    monkeypatch.setattr(stream_session, "_RETRY", 0.01)
    renew = Fault()
    client: Any = mock.Mock(manager="/manager", renew_stream=renew, list_streams=lambda: ())
    with closing(stream_session.StreamSession.open(client)) as session:
        for name in ("first", "second"):
            session.add(mock.Mock(claim_id=name, lease=0.03))
        eventually(lambda: len(renew.done) >= 4)
    assert {arguments[0] for arguments in renew.done} == {"first", "second"}


def test_bonds_are_served_on(topic, monkeypatch):
    topic.publish.is_due = False
    made = bonds.Bonds("/bond")
    tick = Fault(made._table.tick)
    monkeypatch.setattr(made._table, "tick", tick)
    made.add("b", lambda: None)
    eventually(lambda: tick.done)
    join(in_thread(lambda: made.close(0.01)))
