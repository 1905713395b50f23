# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams that a process acquires: one session for each manager, and no outdated status."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Callable, Dict, List
from unittest import mock

import pytest
import rospy
from clocks import in_thread, join, wait_for

from dyknow.errors import Refused
from dyknow.model.streams import ClaimState, StreamEvent, StreamStatus
from dyknow.ros import stream_session
from dyknow.ros.acquiring import AcquiredStream
from dyknow.ros.stream_session import StreamSession


class Surroundings:
    """Managers whose topic of events connects when a test lets it.

    Attributes:
        connects: by manager, called when its session waits for the connection.
        open: the topics subscribed to and the managers bonded with at present.
    """

    def __init__(self):
        self.connects: Dict[str, Callable[[], None]] = {}
        self.open: List[str] = []

    def subscribe(self, topic, *unused):
        self.open.append(topic)
        manager = topic.rsplit("/", 1)[0]

        def connections():
            self.connects.get(manager, lambda: None)()
            return 1

        return SimpleNamespace(
            get_num_connections=connections, unregister=lambda: self.open.remove(topic)
        )

    def bond(self, manager):
        self.open.append(manager)
        return SimpleNamespace(bond_id=manager, close=lambda: self.open.remove(manager))


@pytest.fixture
def around(monkeypatch):
    around = Surroundings()
    monkeypatch.setattr(rospy, "Subscriber", around.subscribe)
    monkeypatch.setattr(stream_session, "ClientBond", around.bond)
    return around


def open_session(manager, close=lambda: None):
    client: Any = SimpleNamespace(manager=manager, list_streams=lambda: (), close=close)
    return StreamSession.open(client)


def test_a_manager_that_is_slow_to_connect_holds_up_no_other(around):
    waiting, connected = threading.Event(), threading.Event()

    def connect():
        waiting.set()
        wait_for(connected)

    around.connects["/slow"] = connect
    sessions: List[StreamSession] = []
    threads = [in_thread(lambda: sessions.append(open_session("/slow"))) for _ in range(2)]
    wait_for(waiting)
    open_session("/other").close()
    assert sessions == []
    connected.set()
    join(*threads)
    assert len(sessions) == 2
    assert sessions[0] is sessions[1]
    assert sorted(around.open) == ["/slow", "/slow/stream_events"]
    sessions[0].close()
    assert around.open
    sessions[1].close()
    assert around.open == []


def test_the_connections_for_renewals_end_with_the_session(around):
    close = mock.Mock()
    sessions = [open_session("/manager", close) for _ in range(2)]
    sessions[0].close()
    close.assert_not_called()
    sessions[1].close()
    close.assert_called_once_with()


def test_a_stream_that_is_released_where_it_is_lost_opens_no_connection(around):
    """The round that has found its claim ended goes on after the session's end."""
    session = open_session("/manager")
    client: Any = session._client
    client.renew_stream = mock.Mock(side_effect=Refused("unknown"))
    client.list_streams = mock.Mock(return_value=())
    stream: Any = mock.Mock(claim_id="c", lease=30.0, events=0)
    stream.on_lost.side_effect = lambda why: session.close()
    session._streams["c"], session._due["c"] = stream, 0.0
    session._keep()
    assert client.list_streams.call_count == 1


def test_a_session_that_cannot_be_opened_leaves_nothing(around, monkeypatch):
    def refuse(*unused):
        raise rospy.ROSException("the master is away")

    with monkeypatch.context() as patch:
        patch.setattr(rospy, "Subscriber", refuse)
        with pytest.raises(rospy.ROSException):
            open_session("/manager")
    assert around.open == []
    assert StreamSession._sessions == {}
    open_session("/manager").close()


# Outdated statuses and events do not replace newer ones


ACTIVE = StreamStatus("c", "me", "A", "/a", "std_msgs/Header", ClaimState.ACTIVE, "", (), 0.0)
DEGRADED = replace(ACTIVE, state=ClaimState.DEGRADED, detail="a part is in doubt")


@pytest.fixture
def events():
    return []


@pytest.fixture
def stream(events, monkeypatch):
    monkeypatch.setattr("rospy.get_time", lambda: 0.0)
    return AcquiredStream(mock.Mock(), mock.Mock(), ACTIVE, 30.0, events.append)


def event(status):
    return StreamEvent(0.0, ACTIVE, status, "because")


def test_a_snapshot_from_before_an_event_does_not_win(stream):
    asked_at = stream.events
    stream.on_event(event(DEGRADED))
    stream.on_status(ACTIVE, asked_at)
    assert stream.state is ClaimState.DEGRADED
    stream.on_status(ACTIVE, stream.events)
    assert stream.state is ClaimState.ACTIVE


def test_a_callback_may_release_and_late_events_revive_nothing(stream, events):
    def release(news):
        events.append(news)
        stream.release()

    stream._notifications.listener = release
    stream.on_event(event(DEGRADED))
    stream.on_event(event(DEGRADED))
    stream.on_status(DEGRADED, stream.events)
    stream.on_lost("unknown")
    assert stream.state is ClaimState.RELEASED
    assert [each.after.state for each in events] == [ClaimState.DEGRADED, ClaimState.RELEASED]


def test_an_error_in_a_callback_does_not_come_out_of_the_block(stream):
    stream._notifications.listener = mock.Mock(side_effect=KeyError("a mistake of the user"))
    with stream:
        pass
    assert stream.state is ClaimState.RELEASED
    stream._notifications.listener.assert_called_once()
