# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Observes the stream from outside: the graph, the claim's events, the positions."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any, Callable, Dict, List, Optional, Type

import rospy
from dyknow_msgs.msg import Model as ModelMessage
from geometry_msgs.msg import PointStamped

from dyknow import names
from dyknow.model.graph import Model
from dyknow.model.streams import StreamEvent
from dyknow.ros.messages import model_from
from dyknow_demo.soccer.narration import changes
from dyknow_demo.soccer.track import Track
from dyknow_demo.soccer.world import World

#: Labels of the robot's own tracking nodelets, which are kept and re-wired.
TRACKING = ("image_subsampler", "ball_detector", "localization")


class Observation:
    """Listens while it is open, and prints changes as they happen.

    Attributes:
        model: the graph, as last published by the manager.
        reasons: of the events of the claim, in order.
        track: the positions that arrived; begins with ``follow``.
    """

    def __init__(self, manager: str, tell: Callable[[str], None]) -> None:
        """Subscribe to the manager's topics.

        Args:
            manager: global name of the manager.
            tell: prints a line.
        """
        self.model: Optional[Model] = None
        self.reasons: List[str] = []
        self._tell = tell
        self._space = names.parent(manager)
        self._began = time.monotonic()
        self._stream: Any = None
        self._listening: List[Any] = [
            rospy.Subscriber(names.join(manager, "model"), ModelMessage, self._on_model)
        ]

    def __enter__(self) -> Observation:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        for each in self._listening:
            each.unregister()

    def follow(self, stream: Any) -> None:
        """Record the positions of an acquired stream from now on."""
        self._stream = stream
        self._reported = time.monotonic()
        self.track = Track(self._reported, World().ball_on_field)
        subscriber = rospy.Subscriber(stream.topic, PointStamped, self._on_position)
        self._listening.append(subscriber)

    def say(self, text: str) -> None:
        """Print a line with its time."""
        self._tell(f"{time.monotonic() - self._began:6.2f} s  {text}")

    def report(self) -> None:
        """Print how well the tracking went since the last report."""
        now = time.monotonic()
        latest = self.track.stretch(self._reported, now)
        self._reported = now
        self.say(
            f"{self._stream.state.name:10} {latest.rate:5.1f} Hz  "
            f"error {latest.median:.3f} m (at most {latest.worst:.3f})  "
            f"pause {latest.pause:.2f} s  {feeding(self.model)}"
        )

    def note_event(self, event: StreamEvent) -> None:
        """Record and print an event of the claim."""
        self.reasons.append(event.reason)
        self.say(f"{event.after.state.name}: {event.reason}")

    def _on_model(self, message: Any) -> None:
        before, self.model = self.model, model_from(message)
        if before is not None:
            for line in changes(before, self.model, self._space):
                self.say(line)

    def _on_position(self, position: Any) -> None:
        stamp, point = position.header.stamp.to_sec(), position.point
        self.track.note(time.monotonic(), stamp, point.x, point.y)


def feeding(model: Optional[Model]) -> str:
    """Label of the camera that feeds the robot's tracking; empty for none."""
    nodelets = model.nodelets if model is not None else ()
    topics = {
        port.topic
        for each in nodelets
        if each.transformation == TRACKING[0]
        for port in each.ports
        if port.name == "yuv" and port.topic
    }
    feeders = [
        each.transformation
        for each in nodelets
        for port in each.ports
        if port.direction == "out" and port.topic in topics
    ]
    return feeders[0] if feeders else ""


def tracking_of(model: Model) -> Dict[str, str]:
    """Names of the nodelets of the robot's tracking, by label."""
    nodelets = model.nodelets
    return {each.transformation: each.name for each in nodelets if each.transformation in TRACKING}
