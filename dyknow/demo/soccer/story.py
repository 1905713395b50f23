"""What is shown: a robot tracks a ball, leaves to recharge, and returns; the stream goes on.

The story asks for a kind of stream and does to the world what a battery does. How the stream is
made, kept and re-wired is the manager's business; what it did is read off the model.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional

import rospy
from dyknow_msgs.msg import Model
from geometry_msgs.msg import PointStamped

import dyknow
from dyknow import names
from dyknow.demo.soccer.narration import changes
from dyknow.demo.soccer.picture import Moment, draw, to_dot
from dyknow.demo.soccer.track import Track
from dyknow.demo.soccer.world import World
from dyknow.errors import DyKnowError, PeerTimeout, Refused
from dyknow.manager.claim import StreamRequest
from dyknow.ros.client import ManagerClient
from dyknow.ros.stream_views import StreamEventView
from dyknow.ros.views import ModelView, NodeletView, model_view

TAG = "FieldPosition(ball)"
OWN_CAMERA, OTHER_CAMERA = "bottom_camera", "ceiling_camera"
#: The robot's own tracking: the labels of what is to be kept, and re-wired.
TRACKING = ("image_subsampler(nao)", "ball_detector(nao)", "localization(nao, ball)")

#: Metres: several times what is measured, so that a stream of wrong positions is no success.
LARGE_ERROR = 0.3

_PERIOD = 1.0  # s between two lines
_LOOK = 0.05  # s
_PATIENCE = 15.0  # s for what the manager does by itself


class NotAsTold(DyKnowError):
    """Something that the story counts on did not happen in time."""

    def __init__(self, what: str) -> None:
        super().__init__(f"not within {_PATIENCE:g} s: {what}")


@dataclass(frozen=True)
class Script:
    """How it is told.

    Attributes:
        seconds: for each act.
        max_silence: seconds without a position that the claim allows.
        pictures: folder for the drawings.
        tell: prints a line.
        check: raises when a process has ended that is needed.
    """

    seconds: float
    max_silence: float
    pictures: Path
    tell: Callable[[str], None]
    check: Callable[[], None]


@dataclass
class _Seen:
    """What came from the manager, on threads of rospy."""

    model: Optional[ModelView] = None
    reasons: List[str] = field(default_factory=list)


class Story:
    """Tells it once."""

    def __init__(self, client: ManagerClient, script: Script) -> None:
        """Prepare; nothing is asked for yet.

        Args:
            client: of a manager that knows the transformations of the soccer field.
            script: how to tell it.
        """
        self._client = client
        self._script = script
        self._tell = script.tell
        self._space = names.parent(client.manager)
        self._seen = _Seen()
        self._world = World()
        self._began = time.monotonic()
        self._problems: List[str] = []
        self._first: Optional[ModelView] = None
        self._tracking: Dict[str, str] = {}

    def run(self) -> bool:
        """Tell the story; True if the position was never lost, and all went as told.

        Raises:
            DyKnowError: it could not go on.
        """
        request = StreamRequest(TAG, PointStamped._type)
        self._tell(f"asked for: {TAG}, and never without it for {self._script.max_silence:g} s")
        self._tell(self._client.acquire_stream(request, dry_run=True).plan)
        listening = rospy.Subscriber(
            names.join(self._client.manager, "model"), Model, self._on_model
        )
        self._began = time.monotonic()
        try:
            with dyknow.acquire(
                TAG,
                PointStamped,
                max_silence=self._script.max_silence,
                on_event=self._on_event,
                manager=self._client.manager,
            ) as stream:
                return self._tell_of(stream)
        finally:
            listening.unregister()

    def _tell_of(self, stream: Any) -> bool:
        self._stream, self._topic = stream, stream.topic
        self._track = Track(time.monotonic(), self._world.ball_on_field)
        self._tell_now(f"the position is on {stream.topic}")
        listening = rospy.Subscriber(stream.topic, PointStamped, self._on_position)
        try:
            self._track_by(
                OWN_CAMERA, "soccer_before", "The robot tracks the ball with its own camera"
            )
            self._leave()
            self._track_by(
                OTHER_CAMERA,
                "soccer_during",
                "The robot's own tracking works on the ceiling camera's footage",
            )
            self._return()
            self._track_by(OWN_CAMERA, "soccer_after", "The robot's camera is back")
            return self._verdict()
        finally:
            listening.unregister()

    # Acts

    def _track_by(self, camera: str, name: str, title: str) -> None:
        """Follow the ball for a while; then look at who does the work, and draw it."""
        end = time.monotonic() + self._script.seconds
        while time.monotonic() < end:
            time.sleep(min(_PERIOD, max(0.0, end - time.monotonic())))
            self._script.check()
            self._report()
        model = self._client.get_model()
        if self._first is None:
            self._first = model
            self._tracking = _names_of(model)
        if self._feeding(model) != camera:
            self._problem(f"{self._feeding(model)} is in use, not {camera}")
        if _names_of(model) != self._tracking:
            self._problem(f"the tracking is not the same: {_names_of(model)}")
        needed = frozenset(self._stream.nodelets)
        moment = Moment(title, model, needed, self._topic, self._space)
        files = draw(to_dot(moment, self._first), self._script.pictures, name)
        self._tell("drawn: " + ", ".join(str(file) for file in files))

    def _leave(self) -> None:
        self._tell("")
        self._tell("The battery runs low: the robot leaves to recharge, and its camera goes.")
        model = self._client.get_model()
        gone = next(each for each in model.transformations if each.label == OWN_CAMERA)
        self._camera = gone.to_xml()
        self._client.remove_transformation(OWN_CAMERA)
        for nodelet in model.nodelets:
            if nodelet.transformation == OWN_CAMERA:
                self._destroy(nodelet)
        self._wait(lambda: self._fed_by(OTHER_CAMERA), f"{OTHER_CAMERA} takes its place")

    def _return(self) -> None:
        self._tell("")
        self._tell("The robot is back, and its camera can be used again.")
        self._seen.reasons.clear()
        self._client.add_transformation(self._camera)
        self._wait(
            lambda: any("cheaper" in reason for reason in self._seen.reasons),
            "an event tells of the cheaper way",
        )
        self._report()
        self._tell("It is not taken by itself. The client asks for it: replan.")
        answer = self._client.replan_stream(self._stream.claim_id)
        self._tell_now(f"replanned: new {', '.join(answer.spawned)}, the rest re-wired")
        self._wait(lambda: self._fed_by(OWN_CAMERA), f"{OWN_CAMERA} is in use again")

    def _verdict(self) -> bool:
        whole = self._track.whole(time.monotonic())
        limit = self._script.max_silence
        if self._stream.topic != self._topic:
            self._problem(f"the topic has changed to {self._stream.topic}")
        if not whole.median < LARGE_ERROR:
            self._problem(f"the positions are wrong by {whole.median:.2f} m")
        if whole.pause > limit:
            self._problem(f"the position was lost for {whole.pause:.2f} s, allowed are {limit:g}")
        self._tell("")
        self._tell(
            f"{whole.count} positions on {self._topic}, error {whole.median:.3f} m at the median; "
            f"longest pause {whole.pause:.2f} s of {limit:g} s that are allowed."
        )
        for problem in self._problems:
            self._tell(f"Not as promised: {problem}.")
        if not self._problems:
            kept = ", ".join(sorted(self._tracking.values()))
            self._tell(f"The same nodelets tracked the ball all the time: {kept}.")
        return not self._problems

    # What there is to see

    def _report(self) -> None:
        """Print how the tracking goes at this moment."""
        now = time.monotonic()
        latest = self._track.stretch(now - _PERIOD, now)
        model = self._seen.model
        camera = self._feeding(model) if model is not None else ""
        self._tell_now(
            f"{self._stream.state.name:10} {latest.rate:5.1f} Hz  "
            f"error {latest.median:.3f} m (at most {latest.worst:.3f})  "
            f"pause {latest.pause:.2f} s  {camera}"
        )

    def _tell_now(self, text: str) -> None:
        self._tell(f"{time.monotonic() - self._began:6.2f} s  {text}")

    def _on_position(self, position: Any) -> None:
        self._track.note(
            time.monotonic(),
            position.header.stamp.to_sec(),
            position.point.x,
            position.point.y,
        )

    def _on_model(self, message: Any) -> None:
        model = model_view(message)
        before, self._seen.model = self._seen.model, model
        if before is not None:
            for line in changes(before, model, self._space):
                self._tell_now(line)

    def _on_event(self, event: StreamEventView) -> None:
        self._seen.reasons.append(event.reason)
        self._tell_now(f"{event.after.state.name}: {event.reason}")

    def _feeding(self, model: ModelView) -> str:
        """Label of the camera whose images the robot's tracking takes; empty for none."""
        topics = [
            port.topic
            for each in model.nodelets
            if each.transformation == TRACKING[0]
            for port in each.ports
            if port.name == "yuv" and port.topic
        ]
        return next(
            (
                each.transformation
                for each in model.nodelets
                for port in each.ports
                if port.direction == "out" and port.topic in topics
            ),
            "",
        )

    def _fed_by(self, camera: str) -> bool:
        return self._seen.model is not None and self._feeding(self._seen.model) == camera

    # Inside

    def _destroy(self, nodelet: NodeletView) -> None:
        """Destroy a nodelet, unless the manager was quicker."""
        try:
            self._client.destroy(nodelet.name)
        except Refused:
            if self._client.get_model().nodelet(nodelet.name) is not None:
                raise

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + _PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise NotAsTold(what)
            self._script.check()
            time.sleep(_LOOK)

    def _problem(self, what: str) -> None:
        self._problems.append(what)


def _names_of(model: ModelView) -> Dict[str, str]:
    """Names of the nodelets of the robot's tracking, by label."""
    return {
        each.transformation: each.name
        for each in model.nodelets
        if each.transformation in TRACKING
    }


def wait_for(client: ManagerClient, check: Callable[[], None], patience: float) -> None:
    """Wait until a manager answers and knows the transformations of the story.

    Raises:
        DyKnowError: it does not, in time.
    """
    end = time.monotonic() + patience
    while True:
        check()
        try:
            labels = {each.label for each in client.get_model(_PERIOD).transformations}
        except (DyKnowError, PeerTimeout):
            labels = set()
        missing = sorted({OWN_CAMERA, OTHER_CAMERA, *TRACKING} - labels)
        if not missing:
            return
        if time.monotonic() > end:
            raise DyKnowError(
                f"{client.manager} does not know {', '.join(missing)}: it needs "
                "examples/transformations/soccer.xml and examples/ontologies/soccer.ttl"
            )
        time.sleep(_LOOK)
