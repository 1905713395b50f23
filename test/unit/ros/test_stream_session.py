# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sessions of a process with its managers: opened once for each, independently of the others."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, Callable, Dict, List

import pytest
import rospy

from dyknow.ros import stream_session
from dyknow.ros.stream_session import StreamSession

PATIENCE = 10.0


class Surroundings:
    """Managers whose topic of events connects when a test lets it.

    Attributes:
        connects: by manager, called when its session waits for the connection.
        open: what is subscribed to or bonded with at present.
    """

    def __init__(self) -> None:
        self.connects: Dict[str, Callable[[], None]] = {}
        self.open: List[str] = []

    def subscribe(self, topic: str, *unused: Any) -> Any:
        self.open.append(topic)
        manager = topic.rsplit("/", 1)[0]

        def connections() -> int:
            self.connects.get(manager, lambda: None)()
            return 1

        return SimpleNamespace(
            get_num_connections=connections, unregister=lambda: self.open.remove(topic)
        )

    def bond(self, manager: str) -> Any:
        self.open.append(manager)
        return SimpleNamespace(bond_id=manager, close=lambda: self.open.remove(manager))


@pytest.fixture
def around(monkeypatch: pytest.MonkeyPatch) -> Surroundings:
    around = Surroundings()
    monkeypatch.setattr(rospy, "Subscriber", around.subscribe)
    monkeypatch.setattr(stream_session, "ClientBond", around.bond)
    return around


def open_session(manager: str) -> StreamSession:
    client: Any = SimpleNamespace(manager=manager, list_streams=lambda: ())
    return StreamSession.open(client)


def test_a_manager_that_is_slow_to_connect_holds_up_no_other(around: Surroundings) -> None:
    waiting, connected = threading.Event(), threading.Event()

    def connect() -> None:
        waiting.set()
        assert connected.wait(PATIENCE)

    around.connects["/slow"] = connect
    sessions: List[StreamSession] = []
    threads = [
        threading.Thread(target=lambda: sessions.append(open_session("/slow"))) for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    assert waiting.wait(PATIENCE)
    open_session("/other").close()
    assert sessions == []
    connected.set()
    for thread in threads:
        thread.join(PATIENCE)
    assert len(sessions) == 2
    assert sessions[0] is sessions[1]
    assert sorted(around.open) == ["/slow", "/slow/stream_events"]
    sessions[0].close()
    assert around.open
    sessions[1].close()
    assert around.open == []


def test_a_session_that_cannot_be_opened_leaves_nothing(
    around: Surroundings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*unused: Any) -> Any:
        raise rospy.ROSException("the master is away")

    with monkeypatch.context() as patch:
        patch.setattr(rospy, "Subscriber", refuse)
        with pytest.raises(rospy.ROSException):
            open_session("/manager")
    assert around.open == []
    assert StreamSession._sessions == {}
    open_session("/manager").close()
