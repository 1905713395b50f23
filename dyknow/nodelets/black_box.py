# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow/BlackBox: the last seconds of streams, as a bag when something went wrong."""

from __future__ import annotations

import os
import time
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import rospkg
import rospy
from dyknow_msgs.msg import Model, Nodelet, StreamEvent, StreamStatus, Verdict
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse

import dyknow
from dyknow.errors import BadParameter, DyKnowError, PeerTimeout
from dyknow.locks import turn_lock
from dyknow.nodelets.recording import KeptMessage, Recording, remove_all_but, write_bag
from dyknow.periodic import in_background
from dyknow.ros.parameters import get_positive
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.message_classes import message_class

_LOOK = 1.0  # seconds between two looks for topics, and at a model that has not been read yet
#: A model is read when this many times the processor's time for that has passed: it may be large.
_REST = 50.0
_LOST = (Nodelet.LOST, Nodelet.FAILED)
_TROUBLED = (StreamStatus.DEGRADED, StreamStatus.RECOVERING, StreamStatus.FAILED)
_MADE = (StreamStatus.ACTIVE, *_TROUBLED)
CAUSE = "/dyknow/black_box/cause"  # topic of a bag with the cause of it


class BlackBox(dyknow.Nodelet):
    """Keeps the last seconds of topics in memory, and writes them as a bag when there is a cause.

    Causes are a verdict that becomes FALSE, a claim that is repaired, degraded or fails or that
    loses its stream, a nodelet that is lost or failed, and the service. Events of streams,
    verdicts and the model are always kept.

    Parameters:
        ~topics (yaml, []): topics to keep; a name or a pattern such as ``/camera/*``.
        ~seconds (double, 30): age from which on a message is dropped.
        ~memory (double, 200): MB of messages at most.
        ~after (double, 2): seconds for which it waits after a cause, if it is not unloaded.
        ~pause (double, 30): seconds between two bags that it writes by itself; at most half of
            ~seconds, so that a bag has its causes.
        ~folder (string): of the bags; black_box in ROS_HOME by default.
        ~bags (int, 20): bags of this nodelet that stay, the newest ones.
        ~manager (string, dyknow_manager): the manager whose events and model it keeps.

    Services:
        ~write_bag (std_srvs/Trigger): writes a bag now; the message is its path.
    """

    def on_init(self) -> None:
        """Subscribe, and look for topics."""
        nh = self.nh = self.node_handle
        self.patterns = [nh.resolve_name(each) for each in _texts(nh, "~topics")]
        seconds = get_positive(nh, "~seconds", 30.0, "s")
        self.recording = Recording(seconds, 1e6 * get_positive(nh, "~memory", 200.0, "MB"))
        self.after = get_positive(nh, "~after", 2.0, "s")
        self.pause = min(get_positive(nh, "~pause", 30.0, "s"), seconds / 2)
        self.bags = max(1, int(get_positive(nh, "~bags", 20, "bags")))
        default = os.path.join(rospkg.get_ros_home(), "black_box")
        self.folder = os.path.expanduser(nh.get_param("~folder", "") or default)
        self.prefix = self.name.strip("/").replace("/", "-") + "_"
        self.manager = nh.resolve_name(nh.get_param("~manager", "dyknow_manager"))
        self.master = Master(rospy.get_name())
        self.turn = turn_lock("black box")
        self.subscribers: dict[str, Any] = {}
        self.values: dict[str, int] = {}
        self.states: dict[str, int] = {}
        self.model: Any = None
        self.readable = 0.0
        self.causes: list[str] = []  # causes of a bag that waits for the messages after them
        self.written = -self.pause
        self.paths: list[str] = []  # bags that it has written, the last ones
        self.keep(f"{self.manager}/stream_events", StreamEvent)
        self.keep(f"{self.manager}/model", rospy.AnyMsg)
        self.look()
        beside = self.mt_node_handle  # messages are kept while the disk or the master takes long
        self.service = beside.Service("~write_bag", Trigger, self.on_request)
        self.timer = beside.Timer(nh.Duration(_LOOK), lambda event: self.look())
        self.reader = nh.Timer(nh.Duration(_LOOK), lambda event: self.read_model())

    def on_shutdown(self) -> None:
        """Write the bag of causes that wait, or wait for one that is being written."""
        causes, self.causes = self.causes, []
        if causes:
            self.write(causes, self.recording.taken())
        with self.turn:
            pass

    def published(self) -> dict[str, str]:
        """Return the types of all topics; none while the ROS master is away."""
        try:
            return dict(self.master.ask("getTopicTypes"))
        except (PeerTimeout, LookupError):
            return {}

    def look(self) -> None:
        """Subscribe to topics that have come."""
        for topic, datatype in sorted(self.published().items()):
            is_named = any(fnmatchcase(topic, pattern) for pattern in self.patterns)
            is_wanted = is_named or datatype == Verdict._type
            if is_wanted and topic not in self.subscribers and datatype != "*":
                try:
                    self.keep(topic, message_class(datatype) or rospy.AnyMsg)
                except DyKnowError as error:  # a denied topic, say: other topics are kept
                    self.subscribers[topic] = None
                    self.nh.logwarn("%s: %s is not kept: %s", self.name, topic, error)

    def read_model(self) -> None:
        """Compare the states of nodelets with those before, if there is a new model."""
        if self.model is None or time.monotonic() < self.readable:
            return
        began = time.thread_time()
        model, self.model = self.model, None
        if isinstance(model, rospy.AnyMsg):
            model = Model().deserialize(model._buff)
        for each in model.nodelets:
            if each.state in _LOST and self.states.get(each.name) not in _LOST:
                what = "lost" if each.state == Nodelet.LOST else "failed"
                self.on_cause(f"nodelet {each.name} is {what}: {each.detail}")
        self.states = {each.name: each.state for each in model.nodelets}
        self.readable = time.monotonic() + _REST * (time.thread_time() - began)

    def keep(self, topic: str, kind: Any) -> None:
        """Keep the messages of a topic."""
        receive = partial(self.on_message, topic)
        self.subscribers[topic] = self.nh.Subscriber(topic, kind, receive, queue_size=100)

    def on_message(self, topic: str, message: Any) -> None:
        """Keep a message, which may be a cause."""
        is_model = topic == f"{self.manager}/model"
        is_verdict = isinstance(message, Verdict)
        self.recording.add(topic, message, self.nh.get_time(), is_model or is_verdict)
        if is_model:
            self.model = message
            self.read_model()
        elif is_verdict:
            known = self.values.get(topic)
            self.values[topic] = message.value
            if message.value == Verdict.FALSE != known:
                self.on_cause(f"the formula of {topic} is violated: {message.why}")
        elif isinstance(message, StreamEvent):
            before, after = message.before, message.after
            is_lost = after.state == StreamStatus.PENDING and before.state in _MADE
            if is_lost or (after.state in _TROUBLED and after.state != before.state):
                self.on_cause(f"stream {after.tag} of claim {after.claim_id}: {message.reason}")

    def on_cause(self, cause: str) -> None:
        """Write a bag soon, unless one was written just now."""
        now = self.nh.get_time()
        self.recording.add(CAUSE, String(cause), now)
        self.causes.append(cause)
        if len(self.causes) == 1:
            since = max(0.0, now - self.written)  # simulated time may have been set back
            wait = max(self.after, self.pause - since)
            self.due = self.nh.Timer(self.nh.Duration(wait), self.on_due, oneshot=True)

    def on_due(self, event: Any) -> None:
        """Write a bag that includes the messages since the cause."""
        causes, self.causes = self.causes, []
        self.written = self.nh.get_time()
        kept = self.recording.taken()
        in_background("writing a bag", partial(self.write, causes, kept))

    def on_request(self, request: Any) -> TriggerResponse:
        return self.write([], self.recording.taken())

    def write(self, causes: list[str], kept: list[KeptMessage]) -> TriggerResponse:
        """Write messages as a bag; the response has its path, or the error."""
        with self.turn:
            try:
                os.makedirs(self.folder, exist_ok=True)
                path = self.free_path()
                left_out = write_bag(path, kept)
                self.paths = [*self.paths, path][-self.bags :]
                remove_all_but(self.folder, self.prefix, self.bags, self.paths)
            except OSError as error:
                self.nh.logerr("%s: no bag is written: %s", self.name, error)
                return TriggerResponse(False, str(error))
        for cause in causes:
            self.nh.logwarn("%s: %s", self.name, cause)
        self.nh.loginfo("%s: wrote %d messages to %s", self.name, len(kept) - left_out, path)
        if left_out:
            self.nh.logwarn("%s: %d messages cannot be serialised", self.name, left_out)
        return TriggerResponse(True, path)

    def free_path(self) -> str:
        """Return the path of a new bag: its time and, within a second, a number."""
        stem = os.path.join(self.folder, self.prefix + time.strftime("%Y-%m-%d-%H-%M-%S"))
        number = 1
        path = f"{stem}.bag"
        while os.path.exists(path):
            number += 1
            path = f"{stem}_{number}.bag"
        return path


def _texts(nh: Any, name: str) -> list[str]:
    value = nh.get_param(name, [])
    if not isinstance(value, list) or not all(isinstance(each, str) and each for each in value):
        expected = "a list of topics or patterns, such as [/camera/*, /odom]"
        raise BadParameter(nh.resolve_name(name), value, expected)
    return value
