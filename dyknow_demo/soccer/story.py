# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The story: a robot tracks a ball, leaves to recharge, and returns; the stream goes on.

The story requests a stream, removes the robot's camera and adds it again. The manager makes,
repairs and re-wires the stream by itself; the story reads what was done from the model.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional

from geometry_msgs.msg import PointStamped

import dyknow
from dyknow import names
from dyknow.errors import DyKnowError, Refused
from dyknow.model.graph import Model
from dyknow.model.streams import StreamRequest
from dyknow.ros.client import ManagerClient
from dyknow_demo.soccer.observing import TRACKING, Observation, feeding, tracking_of
from dyknow_demo.soccer.picture import PictureContents, draw, to_dot
from dyknow_demo.soccer.track import shortcomings

TAG = "FieldPosition(ball)"
OWN_CAMERA, OTHER_CAMERA = "bottom_camera", "ceiling_camera"

_PERIOD = 1.0  # s between two reports
_LOOK = 0.05  # s
_PATIENCE = 15.0  # s for the manager's own work


class NotAsTold(DyKnowError):
    """Something that the story counts on did not happen in time."""

    def __init__(self, what: str) -> None:
        super().__init__(f"not within {_PATIENCE:g} s: {what}")


@dataclass(frozen=True)
class Script:
    """How the story is told.

    Attributes:
        seconds: for each act.
        max_silence: seconds without a position that the claim allows.
        pictures: folder for the drawings.
        tell: prints a line.
        check: raises if a process that is needed has ended.
    """

    seconds: float
    max_silence: float
    pictures: Path
    tell: Callable[[str], None]
    check: Callable[[], None]


def tell_story(client: ManagerClient, script: Script) -> bool:
    """Tell the story; True if the position was never lost and all went as told.

    Args:
        client: client of a manager that has the transformations of the soccer field.
        script: how to tell it.

    Raises:
        DyKnowError: it could not go on.
    """
    script.tell(f"asked for: {TAG}, and never without it for {script.max_silence:g} s")
    request = StreamRequest(TAG, PointStamped._type)
    script.tell(client.acquire_stream(request, dry_run=True).plan)
    with Observation(client.manager, script.tell) as observation, dyknow.acquire(
        TAG,
        PointStamped,
        max_silence=script.max_silence,
        on_event=observation.note_event,
        manager=client.manager,
    ) as stream:
        return _Story(client, script, observation, stream).run()


class _Story:
    """The acts."""

    def __init__(
        self, client: ManagerClient, script: Script, observation: Observation, stream: Any
    ) -> None:
        self._client = client
        self._script = script
        self._tell = script.tell
        self._observation = observation
        self._stream = stream
        self._topic: str = stream.topic
        self._problems: List[str] = []
        self._first: Optional[Model] = None
        self._tracking: Dict[str, str] = {}
        self._camera = ""

    def run(self) -> bool:
        self._observation.follow(self._stream)
        self._observation.say(f"the position is on {self._topic}")
        self._track_by(OWN_CAMERA, "before", "The robot tracks the ball with its own camera")
        self._leave()
        self._track_by(
            OTHER_CAMERA,
            "during",
            "The robot's own tracking works on the ceiling camera's footage",
        )
        self._return()
        self._track_by(OWN_CAMERA, "after", "The robot's camera is back")
        return self._verdict()

    def _track_by(self, camera: str, act: str, title: str) -> None:
        """Follow the ball for a while; then check which nodelets do the work, and draw them."""
        end = time.monotonic() + self._script.seconds
        while time.monotonic() < end:
            time.sleep(min(_PERIOD, max(0.0, end - time.monotonic())))
            self._script.check()
            self._observation.report()
        model = self._client.get_model()
        if self._first is None:
            self._first = model
            self._tracking = tracking_of(model)
        if feeding(model) != camera:
            self._problems.append(f"{feeding(model) or 'no camera'} is in use, not {camera}")
        if tracking_of(model) != self._tracking:
            self._problems.append(f"others do the tracking: {tracking_of(model)}")
        needed = frozenset(self._stream.nodelets)
        space = names.parent(self._client.manager)
        dot = to_dot(PictureContents(title, model, needed, self._topic, space), self._first)
        files = draw(dot, self._script.pictures, f"soccer_{act}")
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
                self._destroy(nodelet.name)
        self._wait_for_images_of(OTHER_CAMERA)

    def _return(self) -> None:
        self._tell("")
        self._tell("The robot is back, and its camera can be used again.")
        seen = self._observation
        seen.reasons.clear()
        self._client.add_transformation(self._camera)
        self._wait(
            lambda: any("cheaper" in reason for reason in seen.reasons),
            "an event tells of the cheaper way",
        )
        seen.report()
        self._tell("It is not taken by itself. The client asks for it: replan.")
        answer = self._client.replan_stream(self._stream.claim_id)
        seen.say(f"replanned: new {', '.join(answer.spawned)}, the rest re-wired")
        self._wait_for_images_of(OWN_CAMERA)

    def _verdict(self) -> bool:
        whole = self._observation.track.whole(time.monotonic())
        limit, problems = self._script.max_silence, self._problems
        if self._stream.topic != self._topic:
            problems.append(f"the topic has changed to {self._stream.topic}")
        problems.extend(shortcomings(whole, limit))
        self._tell("")
        self._tell(
            f"{whole.count} positions on {self._topic}, error {whole.median:.3f} m at the median; "
            f"longest pause {whole.pause:.2f} s of {limit:g} s that are allowed."
        )
        for problem in dict.fromkeys(problems):
            self._tell(f"Not as promised: {problem}.")
        if not problems:
            kept = ", ".join(sorted(self._tracking.values()))
            self._tell(f"The same nodelets tracked the ball all the time: {kept}.")
        return not problems

    # Inside

    def _destroy(self, name: str) -> None:
        """Destroy a nodelet, unless the manager has already destroyed it."""
        try:
            self._client.destroy(name)
        except Refused:
            if self._client.get_model().nodelet(name) is not None:
                raise

    def _wait_for_images_of(self, camera: str) -> None:
        self._wait(
            lambda: feeding(self._observation.model) == camera, f"the images are of {camera}"
        )

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + _PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise NotAsTold(what)
            self._script.check()
            time.sleep(_LOOK)


def wait_for(client: ManagerClient, check: Callable[[], None], patience: float) -> None:
    """Wait until a manager answers and has the transformations of the story.

    Raises:
        DyKnowError: it does not in time.
    """
    end = time.monotonic() + patience
    while True:
        check()
        try:
            labels = {each.label for each in client.get_model(_PERIOD).transformations}
        except DyKnowError:
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
