# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The story: a robot tracks a ball, its battery runs low, and it charges; the stream goes on.

The story requests a stream, and plays the robot's battery: a topic. The camera of the robot
requires the verdict that the battery is charged. The manager makes, repairs and re-wires the
stream by itself; the story reads the changes from the model. A ROS master or manager that runs is
used; otherwise one is started, and ended with the story.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from pathlib import Path
from typing import Any, Callable, Iterator

import rospkg
import rospy
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.msg import Verdict
from geometry_msgs.msg import PointStamped

import dyknow
from dyknow import names
from dyknow.errors import DyKnowError, HostError, PeerTimeout
from dyknow.model.graph import Model
from dyknow.model.streams import StreamEvent, StreamRequest
from dyknow.ros.client import ManagerClient
from dyknow.ros.process.owned import Processes
from dyknow.ros.wire.messages import model_from
from dyknow_demo.processes import MANAGER, Battery, own_processes, running_manager, tell
from dyknow_demo.soccer.world import SoccerWorld
from dyknow_demo.telling import Timeline, Track, changes, draw, to_dot

TAG = "FieldPosition(ball)"
CHARGED = "Holds(charged, nao)"
BATTERY = "/nao/battery"
#: Levels of the battery: at the beginning, before it runs low, while the robot is away, and after.
FULL, LOW, EMPTY, CHARGING = 0.5, 0.22, 0.1, 0.4
OWN_CAMERA, OTHER_CAMERA = "bottom_camera", "ceiling_camera"
#: Labels of the robot's own tracking nodelets, which are kept and re-wired.
TRACKING = ("image_subsampler", "ball_detector", "localization")

_PERIOD = 1.0  # s between two reports
_LOOK = 0.05  # s
_PATIENCE = 15.0  # s for the manager's own work
_DRAINING = 1.0  # s in which the battery falls below what is enough, or is charged above it
_ORPHAN_TIMEOUT = 3.0  # s that nodelets may go on if the manager is killed


def play(options: argparse.Namespace) -> bool:
    """Tell the story; True if the position was never lost and all went as told.

    Args:
        options: ``manager``, a running one that knows the field, or empty to start one;
            ``seconds`` for each act; ``max_silence``, seconds without a position that the claim
            allows; ``pictures``, the folder for the drawings.

    Raises:
        DyKnowError: something failed.
    """
    with own_processes() as processes, _manager(processes, options.manager) as client:
        rospy.init_node("dyknow_demo", anonymous=True, disable_signals=True)
        try:
            tell(f"asked for: {TAG}, and never without it for {options.max_silence:g} s")
            request = StreamRequest(TAG, PointStamped._type)
            tell(client.acquire_stream(request, dry_run=True).plan)
            return _Story(client, options, processes.check).run()
        finally:
            rospy.signal_shutdown("the demonstration is over")


@contextlib.contextmanager
def _manager(processes: Processes, name: str) -> Iterator[ManagerClient]:
    """Use a manager, or start one; it has the transformations of the story."""
    client = ManagerClient(name or MANAGER)
    if name:
        tell(f"manager: {client.manager}")
        _wait(processes.check, lambda: _is_ready(client), f"{client.manager} knows soccer.xml")
        yield client
        return
    examples = Path(rospkg.RosPack().get_path("dyknow")) / "examples"
    with running_manager(
        processes,
        lambda: _is_ready(client),
        state_dir=processes.folder,
        ontologies=examples / "ontologies" / "soccer.ttl",
        transformations=examples / "transformations" / "soccer.xml",
        orphan_timeout=_ORPHAN_TIMEOUT,
    ):
        yield client


def _is_ready(client: ManagerClient) -> bool:
    """Whether a manager answers, and has the transformations of the story."""
    try:
        labels = {each.label for each in client.get_model(_PERIOD).transformations}
    except (HostError, PeerTimeout):
        return False
    return {OWN_CAMERA, OTHER_CAMERA, *TRACKING} <= labels


def _wait(check: Callable[[], None], condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + _PATIENCE
    while not condition():
        check()
        if time.monotonic() > end:
            raise DyKnowError(f"not within {_PATIENCE:g} s: {what}")
        time.sleep(_LOOK)


class _Story:
    """The acts, and the stream as it is observed from outside: graph, events, positions."""

    def __init__(
        self, client: ManagerClient, options: argparse.Namespace, check: Callable[[], None]
    ) -> None:
        self._client, self._options, self._check = client, options, check
        self._space = names.parent(client.manager)
        self._began = time.monotonic()
        self._model: Model | None = None
        self._reasons: list[str] = []
        self._problems: list[str] = []
        self._first: Model | None = None
        self._tracking: dict[str, str] = {}
        self._battery = Battery(BATTERY, FULL)

    def run(self) -> bool:
        manager = self._client.manager
        topic = names.join(manager, "model")
        model = rospy.Subscriber(topic, ModelMessage, self._on_model)
        with contextlib.closing(self._battery), dyknow.acquire(
            TAG,
            PointStamped,
            max_silence=self._options.max_silence,
            on_event=self._on_event,
            manager=manager,
        ) as self._stream, dyknow.acquire(CHARGED, Verdict, manager=manager) as charged:
            self._reported = time.monotonic()
            self._track = Track(self._reported, SoccerWorld().ball_on_field)
            self._timeline = Timeline(self._reported, self._track)
            self._topic: str = self._stream.topic
            positions = rospy.Subscriber(self._topic, PointStamped, self._on_position)
            verdicts = rospy.Subscriber(charged.topic, Verdict, self._on_verdict)
            try:
                self._say(f"the position is on {self._topic}")
                self._battery.head_for(LOW, self._options.seconds)
                self._act(OWN_CAMERA, "before", "The robot tracks the ball with its own camera")
                self._leave()
                title = "The robot's own tracking works on the ceiling camera's footage"
                self._act(OTHER_CAMERA, "during", title)
                self._return()
                self._act(OWN_CAMERA, "after", "The robot's camera is back")
                return self._outcome()
            finally:
                for each in (model, positions, verdicts):
                    each.unregister()

    def _act(self, camera: str, act: str, title: str) -> None:
        """Follow the ball for a while; then check which nodelets do the work, and draw them."""
        end = time.monotonic() + self._options.seconds
        while time.monotonic() < end:
            time.sleep(min(_PERIOD, max(0.0, end - time.monotonic())))
            self._check()
            self._report()
        model = self._client.get_model()
        if self._first is None:
            self._first, self._tracking = model, _tracking_of(model)
        if _feeding(model) != camera:
            self._problems.append(f"{_feeding(model) or 'no camera'} is in use, not {camera}")
        if _tracking_of(model) != self._tracking:
            self._problems.append(f"others do the tracking: {_tracking_of(model)}")
        needed = frozenset(self._stream.nodelets)
        dot = to_dot(title, model, self._first, needed, self._topic, self._space)
        files = draw(dot, self._options.pictures.absolute(), f"soccer_{act}")
        tell("drawn: " + ", ".join(str(file) for file in files))

    def _leave(self) -> None:
        tell("\nThe battery runs low: the robot leaves to recharge.")
        self._battery.head_for(EMPTY, _DRAINING)
        self._wait_for_images_of(OTHER_CAMERA)

    def _return(self) -> None:
        tell("\nThe battery is being charged.")
        self._reasons.clear()
        self._battery.head_for(CHARGING, _DRAINING)
        _wait(self._check, self._is_cheaper, "an event about the cheaper way")
        self._report()
        tell("It is not taken by itself. The client asks for it: replan.")
        answer = self._client.replan_stream(self._stream.claim_id)
        self._say(f"replanned: new {', '.join(answer.spawned)}, the rest re-wired")
        self._wait_for_images_of(OWN_CAMERA)

    def _outcome(self) -> bool:
        whole, limit = self._track.stretch(time.monotonic()), self._options.max_silence
        if self._stream.topic != self._topic:
            self._problems.append(f"the topic has changed to {self._stream.topic}")
        problems = dict.fromkeys([*self._problems, *whole.shortcomings(limit)])
        if self._timeline.values != ["TRUE", "FALSE", "TRUE"]:
            problems[f"the verdicts were {', '.join(self._timeline.values)}"] = None
        files = self._timeline.draw(self._options.pictures.absolute(), "soccer_timeline")
        tell("drawn: " + ", ".join(str(file) for file in files))
        tell(
            f"\n{whole.count} positions on {self._topic}, error {whole.median:.3f} m at the "
            f"median; longest pause {whole.pause:.2f} s of {limit:g} s that are allowed."
        )
        for problem in problems:
            tell(f"Not as promised: {problem}.")
        if not problems:
            kept = ", ".join(sorted(self._tracking.values()))
            tell(f"The same nodelets tracked the ball all the time: {kept}.")
        return not problems

    # Inside

    def _say(self, text: str) -> None:
        tell(f"{time.monotonic() - self._began:6.2f} s  {text}")

    def _report(self) -> None:
        """Print how well the tracking went since the last report."""
        now = time.monotonic()
        latest = self._track.stretch(now, self._reported)
        self._reported = now
        self._say(
            f"{self._stream.state.name:10} {latest.rate:5.1f} Hz  "
            f"error {latest.median:.3f} m (at most {latest.worst:.3f})  "
            f"pause {latest.pause:.2f} s  battery {self._battery.level:.0%}  "
            f"{_feeding(self._model)}"
        )

    def _is_cheaper(self) -> bool:
        return any("cheaper" in reason for reason in self._reasons)

    def _on_event(self, event: StreamEvent) -> None:
        self._reasons.append(event.reason)
        self._say(f"{event.after.state.name}: {event.reason}")

    def _on_model(self, message: Any) -> None:
        before, self._model = self._model, model_from(message)
        for line in changes(before, self._model, self._space) if before is not None else ():
            self._say(line)

    def _on_position(self, position: Any) -> None:
        stamp, point = position.header.stamp.to_sec(), position.point
        self._track.note(time.monotonic(), stamp, point.x, point.y)

    def _on_verdict(self, verdict: Any) -> None:
        names_of_values = {Verdict.TRUE: "TRUE", Verdict.FALSE: "FALSE"}
        value = names_of_values.get(verdict.value, "UNKNOWN")
        if self._timeline.note(time.monotonic(), value, self._battery.level):
            self._say(f"{CHARGED} is {value}: {verdict.why}")

    def _wait_for_images_of(self, camera: str) -> None:
        what = f"the images are of {camera}"
        _wait(self._check, lambda: _feeding(self._model) == camera, what)


def _feeding(model: Model | None) -> str:
    """Label of the camera that feeds the robot's tracking; empty for none."""
    ports = [
        (each.transformation, port)
        for each in (model.nodelets if model is not None else ())
        for port in each.ports
        if port.topic
    ]
    topics = {port.topic for label, port in ports if (label, port.name) == (TRACKING[0], "yuv")}
    feeders = (label for label, port in ports if port.direction == "out" and port.topic in topics)
    return next(feeders, "")


def _tracking_of(model: Model) -> dict[str, str]:
    """Names of the nodelets of the robot's tracking, by label."""
    nodelets = model.nodelets
    return {each.transformation: each.name for each in nodelets if each.transformation in TRACKING}
