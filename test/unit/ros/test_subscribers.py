# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How long an in-port that is connected elsewhere waits for its new publishers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from std_msgs.msg import Header

from dyknow.errors import PeerTimeout
from dyknow.ros.transport import topics
from dyknow.ros.transport.topics import RospySubscriber

ONE, TWO = "http://one", "http://two"
PATIENCE = 0.5


class Graph:
    """Two publishers of a topic, a subscriber of it, and time that is moved by hand.

    Attributes:
        served_at: when each publisher has the subscriber among its connections.
        first_at: when the first message arrives.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.served_at = {ONE: 0.1, TWO: 0.2}
        self.first_at = 3600.0
        implementation = SimpleNamespace(
            connections=[
                SimpleNamespace(
                    local_endpoint=("here", port), endpoint_id=uri, callerid_pub="/talker"
                )
                for port, uri in enumerate(self.served_at)
            ]
        )
        rospy: Any = SimpleNamespace(
            Subscriber=lambda *arguments, **options: SimpleNamespace(impl=implementation),
            get_name=lambda: "/listener",
            resolve_name=lambda topic: topic,
        )
        monkeypatch.setattr(topics, "rospy", rospy)
        monkeypatch.setattr(topics, "time", SimpleNamespace(monotonic=lambda: self.now))
        monkeypatch.setattr(topics, "Master", lambda name: self)

    def connections(self, uri: str, topic: str, timeout: float) -> set[int]:
        if uri not in self.served_at:
            raise PeerTimeout(uri, timeout)
        return {list(self.served_at).index(uri)} if self.now >= self.served_at[uri] else set()

    def arrived(self, seconds: float) -> bool:
        self.now += seconds
        return self.now >= self.first_at

    def wait(self) -> float:
        """Return the seconds that the subscriber waits."""
        registrar: Any = SimpleNamespace(publishers=lambda topic: frozenset((ONE, TWO)))
        made = RospySubscriber(registrar, "/t", Header, lambda *message: None, {})
        made.wait(self.arrived, PATIENCE)
        return self.now


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Graph:
    return Graph(monkeypatch)


def test_publishers_that_are_connected_and_silent_are_not_waited_for(graph: Graph) -> None:
    assert graph.wait() == pytest.approx(graph.served_at[TWO], abs=0.01)


def test_a_first_message_ends_the_wait(graph: Graph) -> None:
    graph.first_at = 0.05
    assert graph.wait() == pytest.approx(graph.first_at, abs=0.01)


def test_a_publisher_that_does_not_answer_is_waited_for_in_vain(graph: Graph) -> None:
    del graph.served_at[TWO]
    assert graph.wait() == pytest.approx(PATIENCE, abs=0.01)
