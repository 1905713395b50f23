# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A simulated manager as the window sees it, with a soccer robot's graph, or a tree of any size.

For tests of the window, and for its pictures.
"""

from __future__ import annotations

import contextlib
from typing import AbstractSet, Callable, Collection, Iterable

from dyknow.errors import HostError, PeerTimeout
from dyknow.formulas import Truth, Verdict
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import Model, NodeletKind, State
from dyknow.model.transformation import IN, OUT, Parameter, Port, Transformation, as_specification
from dyknow.periodic import PeriodicWorker
from dyknow.simulated import SimulatedManagerClient
from dyknow_rqt.graph.samples import Sample
from dyknow_rqt.graph.snapshot import Side, Transports
from dyknow_rqt.monitoring.remote import Remote

#: Seconds.
_COUNTS_PERIOD = 0.3


class SimulatedRemote(Remote):
    """A simulated manager, with ordinary nodes beside it.

    Attributes:
        address: that of the manager at the master; empty if the master does not know it.
        publishers: nodes that publish, by topic.
        subscribers: nodes that subscribe, by topic.
        connected: transports of connections to other processes.
        followed: nodes and topics whose verdicts are heard.
        listeners: those that the user looks at, by topic.
    """

    def __init__(self) -> None:
        """Start empty, with a master and a manager that are up."""
        super().__init__("http://localhost:11311")
        self.has_master = True
        self.address = "rosrpc://localhost:40001"
        self.client: SimulatedManagerClient = SimulatedManagerClient()
        self.publishers: dict[str, list[str]] = {}
        self.subscribers: dict[str, list[str]] = {}
        self.connected: Transports = {}
        self.followed: AbstractSet[tuple[str, str]] = frozenset()
        self.listeners: dict[str, list[Callable[[Sample], None]]] = {}
        self._samples: dict[str, Sample] = {}
        self._verdicts: dict[str, Verdict] = {}
        self._counting = PeriodicWorker("simulated counts", self._count, _COUNTS_PERIOD)

    def start(self) -> None:
        self.client.on_model, self.client.on_event = self.on_model, self.on_event
        self._counting.start()

    def follow_verdicts(self, sources: AbstractSet[tuple[str, str]]) -> None:
        self.followed = sources
        self._hand_on(self._verdicts)

    def decide(self, topic: str, truth: Truth, since: int = 0, why: str = "") -> None:
        """Let a verdict come, from ``since`` on; as from a nodelet, the last one is latched."""
        self._verdicts[topic] = Verdict(since, truth, since, why)
        self._hand_on([topic])

    def follow(
        self, topic: str, datatype: str, node: str, on_sample: Callable[[Sample], None]
    ) -> Callable[[], None]:
        listeners = self.listeners.setdefault(topic, [])
        listeners.append(on_sample)
        if topic in self._samples:
            on_sample(self._samples[topic])

        def end() -> None:
            if on_sample in listeners:
                listeners.remove(on_sample)

        return end

    def send(self, topic: str, sample: Sample) -> None:
        """Let a message come; the last one is latched."""
        self._samples[topic] = sample
        for listener in list(self.listeners.get(topic, ())):
            listener(sample)

    def close(self) -> None:
        self.client.on_model = lambda model: None
        self.client.on_event = lambda event: None
        self._counting.close()

    def graph(self) -> Model:
        return self.client.get_graph()

    def system_state(self) -> tuple[Side, Side]:
        """Return the ordinary nodes only."""
        self._ask_master()
        return sorted(self.publishers.items()), sorted(self.subscribers.items())

    def find_manager(self) -> str:
        self._ask_master()
        return self.address

    def transports(self, nodes: Collection[str]) -> Transports:
        return {key: names for key, names in self.connected.items() if key[0] in nodes}

    def _count(self) -> None:
        with contextlib.suppress(HostError):
            self.on_counts(self.client.counts())

    def _hand_on(self, topics: Iterable[str]) -> None:
        followed = {topic for _, topic in self.followed}
        for topic in followed.intersection(topics):
            self.on_verdict(topic, self._verdicts[topic])

    def _ask_master(self) -> None:
        if not self.has_master:
            raise PeerTimeout(f"the ROS master at {self.master}", 3.0)


#: Label, source, ports (`>name` for in, `name>` for out) with their types and tags.
_LIBRARY = """
camera(nao1, bottom); soccer/Camera; yuv> sensor_msgs/Image RawYUV(nao1, bottom)
camera(nao1, top); soccer/Camera; yuv> sensor_msgs/Image RawYUV(nao1, top)
ceiling_camera; soccer/CeilingCamera; \
field_position> geometry_msgs/PointStamped FieldPosition(ball)
subsampler; soccer/Subsampler; >yuv sensor_msgs/Image RawYUV(?robot, ?camera); \
bgr> sensor_msgs/Image BGR(?robot, ?camera); hsv> sensor_msgs/Image HSV(?robot, ?camera); \
channels> sensor_msgs/Image SubsampledYUV(?robot, ?camera)
ball_detector; soccer/BallDetector; >channels sensor_msgs/Image SubsampledYUV(?robot, ?camera); \
>joint_states sensor_msgs/JointState; ball> geometry_msgs/PointStamped BallObject(?robot)
line_detector; soccer/LineDetector; >hsv sensor_msgs/Image HSV(?robot, ?camera); \
lines> sensor_msgs/PointCloud2 Lines(?robot)
localization; soccer/Localization; >objects geometry_msgs/PointStamped BallObject(?robot); \
>lines sensor_msgs/PointCloud2 Lines(?robot); \
field_position> geometry_msgs/PointStamped FieldPosition(ball)
tracker; soccer/Tracker; >position geometry_msgs/PointStamped FieldPosition(ball); \
track> nav_msgs/Path Track(ball)
resize; image_proc/resize; >image sensor_msgs/Image; resized> sensor_msgs/Image
recorder; dyknow/Sink; >in sensor_msgs/Image
"""
_PARAMETERS = {
    "ball_detector": (
        Parameter("mount", "string", "${?robot}_bottom_camera"),
        Parameter("colour", "string", "orange"),
    )
}
_GIVEN = {"/nao1/ball_detector": (Parameter("?robot", "", "nao1"),)}
#: Name, label, topics of ports.
_NODELETS = """
/nao1/bottom_camera; camera(nao1, bottom); yuv=/nao1/bottom_camera/yuv
/nao1/top_camera; camera(nao1, top); yuv=/nao1/top_camera/yuv
/nao1/subsampler; subsampler; yuv=/nao1/bottom_camera/yuv hsv=/nao1/subsampler/hsv \
channels=/nao1/subsampler/channels
/nao1/ball_detector; ball_detector; channels=/nao1/subsampler/channels \
joint_states=/nao1/joint_states ball=/nao1/ball_detector/ball
/nao1/line_detector; line_detector; hsv=/nao1/subsampler/hsv lines=/nao1/line_detector/lines
/nao1/localization; localization; objects=/nao1/ball_detector/ball \
lines=/nao1/line_detector/lines field_position=/field/ball
/field/ceiling_camera; ceiling_camera;
/field/tracker; tracker; position=/field/ball track=/field/tracker/track
/nao1/resize; resize; image=/nao1/top_camera/yuv resized=/nao1/preview
/nao1/recorder; recorder; in=/nao1/preview
"""


def soccer() -> SimulatedRemote:
    """A robot on a soccer field: from its cameras to the track of the ball."""
    remote = SimulatedRemote()
    client = remote.client
    client.add_transformation(as_specification([_transformation(row) for row in _rows(_LIBRARY)]))
    for name, label, ports in _rows(_NODELETS):
        topics = dict(port.split("=") for port in ports.split())
        client.spawn(label, name, topics, parameters=_GIVEN.get(name, ()))
    client.set_protection("/nao1/bottom_camera", True)
    client.alter("/nao1/resize", kind=NodeletKind.CPP, manager="/dyknow_cpp_nodelet_manager")
    client.alter("/nao1/recorder", state=State.LOST, detail="its process is gone")
    client.alter("/field/ceiling_camera", state=State.FAILED, detail="no device /dev/video4")
    for nodelet, port, rate, lost in (
        ("/nao1/bottom_camera", "yuv", 30.0, 0.0),
        ("/nao1/top_camera", "yuv", 15.0, 0.0),
        ("/nao1/subsampler", "hsv", 30.0, 0.0),
        ("/nao1/subsampler", "channels", 29.9, 0.0),
        ("/nao1/ball_detector", "ball", 21.4, 0.0),
        ("/nao1/ball_detector", "channels", 21.4, 8.5),
        ("/nao1/ball_detector", "joint_states", 50.0, 0.0),
        ("/nao1/line_detector", "lines", 29.8, 0.0),
        ("/nao1/localization", "field_position", 21.4, 0.0),
        ("/field/tracker", "track", 10.0, 0.0),
        ("/nao1/resize", "resized", 15.0, 0.0),
    ):
        client.rates[nodelet, port] = (rate, lost)
    remote.publishers = {"/nao1/joint_states": ["/nao1/driver"]}
    remote.subscribers = {"/field/tracker/track": ["/team_view"]}
    return remote


def _rows(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in row.split(";")] for row in table.strip().splitlines()]


def _transformation(row: list[str]) -> Transformation:
    label, source, *ports = row
    parameters = _PARAMETERS.get(label, ())
    return Transformation(label, source, parameters=parameters, ports=tuple(map(_port, ports)))


def _port(text: str) -> Port:
    name, datatype, *tag = text.split(" ", 2)
    return Port(name.strip(">"), IN if name.startswith(">") else OUT, datatype, tuple(tag))


def tree(count: int) -> SimulatedRemote:
    """A simulated manager with so many nodelets."""
    remote = SimulatedRemote()
    relay = Transformation("relay", "dyknow/Relay", ports=(Port("in", IN), Port("out", OUT)))
    remote.client.add_transformation(as_specification([relay]))
    for number in range(count):
        spawn_relay(remote.client, number)
    return remote


def spawn_relay(client: BaseManagerClient, number: int) -> None:
    """Spawn the next relay of a tree.

    There are ten in a namespace, where each leads to two of them; a namespace leads to five.
    """
    group, place = divmod(number, 10)
    topics = {"out": f"/part{group}/stream{place}"}
    if number:
        source = (group, (place - 1) // 2) if place else ((group - 1) // 5, 9)
        topics["in"] = "/part{}/stream{}".format(*source)
    client.spawn("relay", f"/part{group}/nodelet{place}", topics)
