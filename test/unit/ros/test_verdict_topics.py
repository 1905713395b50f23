# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts that the manager hears."""

from __future__ import annotations

import time
from io import BytesIO
from typing import Any, Dict

import pytest
import rospy
from clocks import eventually
from dyknow_msgs.msg import Verdict

from dyknow.ros.hosting.listening import VerdictTopics


def received(md5sum=Verdict._md5sum, stamp=0.0):
    body = BytesIO()
    verdict = Verdict(value=Verdict.TRUE, why="it is charged")
    verdict.header.stamp = rospy.Time.from_sec(stamp)
    verdict.serialize(body)
    message = rospy.AnyMsg().deserialize(body.getvalue())
    message._connection_header = {"md5sum": md5sum}
    return message


@pytest.fixture
def subscribed(monkeypatch):
    """Callbacks by topic, of subscribers that take the class of any other one there."""
    found: Dict[str, Any] = {}

    def subscribe(topic, kind, callback):
        assert kind is rospy.AnyMsg
        found[topic] = callback

    monkeypatch.setattr(rospy, "Subscriber", subscribe)
    monkeypatch.setattr(rospy, "get_time", lambda: 100.0)
    return found


def test_a_topic_whose_messages_are_counted_too_is_heard(subscribed):
    """Rospy gives all subscribers of a topic the message class of the first."""
    verdicts = VerdictTopics(lambda: None)
    verdicts.follow(["/holds"])
    eventually(lambda: subscribed)
    subscribed["/holds"](received("of another type"))
    assert verdicts.follow(["/holds"]) == {}
    subscribed["/holds"](received())
    assert verdicts.follow(["/holds"])["/holds"].is_true
    verdicts.close()


def test_verdicts_tell_the_time_of_the_last_state(subscribed):
    """In steady time, which the clocks of messages and of the master do not share."""
    changes = []
    verdicts = VerdictTopics(lambda: changes.append("change"))
    verdicts.follow(["/holds"])
    eventually(lambda: subscribed)
    states = []
    for stamp in (0.0, 60.0, 1000.0):
        subscribed["/holds"](received(stamp=stamp))
        states.append(verdicts.follow(["/holds"])["/holds"].state)
    verdicts.close()
    begin, one_minute, future = states
    assert one_minute - begin >= 60.0
    assert future - one_minute >= 40.0, "no state is in the future"
    assert future <= time.monotonic()
    assert len(changes) == 1
