# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sets up and re-wires a pair of nodelets whose connection is switched."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import rospy
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from std_msgs.msg import Empty, Float64MultiArray

from dyknow.locks import state_condition
from dyknow_benchmark.managers import RunningManager
from dyknow_benchmark.session import START_PATIENCE, MeasurementFailed, wait_until

_CONTROL = "/benchmark/switch"
#: Ends that can be switched, with the nodelet, its port and the two topics.
_ENDS = {
    "in": ("sink", "in", (f"{_CONTROL}/even", f"{_CONTROL}/odd")),
    "out": ("source", "out", (f"{_CONTROL}/left", f"{_CONTROL}/right")),
}
ENDS: Sequence[str] = tuple(_ENDS)


@dataclass(frozen=True)
class Seen:
    """What came through a port that was switched.

    Attributes:
        lost: messages that should have come and did not.
        doubled: messages that came again, or too late.
        changes: when (s since the epoch) the first message of each new topic came.
    """

    lost: int
    doubled: int
    changes: Tuple[float, ...]


class Switching:
    """The two nodelets, loaded into a manager; all four topics are live."""

    def __init__(self, manager: RunningManager, rate: float) -> None:
        """Load the nodelets and connect them.

        Args:
            manager: where they run.
            rate: messages per second and topic.

        Raises:
            MeasurementFailed: they do not come up.
        """
        self._reports: Dict[int, List[float]] = {}
        self._changed = state_condition("switches")
        self._collect = rospy.Publisher(_CONTROL + "/collect", Empty, queue_size=10)
        self._side = dict.fromkeys(ENDS, 0)
        first = {end: _ENDS[end][2][0] for end in ENDS}
        keep = {f"{_CONTROL}/{side}": f"{_CONTROL}/{side}" for side in ("left", "right")}
        manager.load(
            f"{_CONTROL}/sink",
            "dyknow_benchmark/SwitchSink",
            {**keep, f"{_CONTROL}/in": first["in"]},
            {"control": _CONTROL},
        )
        manager.load(
            f"{_CONTROL}/source",
            "dyknow_benchmark/SwitchSource",
            {
                f"{_CONTROL}/even": f"{_CONTROL}/even",
                f"{_CONTROL}/odd": f"{_CONTROL}/odd",
                f"{_CONTROL}/out": first["out"],
            },
            {"rate": rate},
        )
        rospy.Subscriber(_CONTROL + "/report", Float64MultiArray, self._on_report)
        self._set_config = {}
        for end in ENDS:
            service = f"{_CONTROL}/{_ENDS[end][0]}/set_config"
            self._set_config[end] = rospy.ServiceProxy(service, SetConfig, persistent=True)
            self._set_config[end].wait_for_service(START_PATIENCE)
        wait_until(self._answers, "the nodelets that are switched to report")

    def switch(self, end: str) -> float:
        """Connect a port to its other topic; returns when (s since the epoch) that was asked for.

        Raises:
            MeasurementFailed: the proxy refused.
        """
        _, port, topics = _ENDS[end]
        self._side[end] = 1 - self._side[end]
        config = [PortConfig(port, topics[self._side[end]])]
        asked = time.time()
        answer = self._set_config[end](config)
        if not answer.success:
            raise MeasurementFailed(f"set_config refused: {answer.message}")
        return asked

    def collect(self, end: str) -> Seen:
        """Ask what came through the port."""
        hop = ENDS.index(end)
        with self._changed:
            self._reports.clear()
            self._collect.publish(Empty())
            if not self._changed.wait_for(lambda: hop in self._reports, START_PATIENCE):
                raise MeasurementFailed("the nodelets that are switched do not report")
            lost, doubled, *changes = self._reports[hop]
        return Seen(int(lost), int(doubled), tuple(changes))

    def _answers(self) -> bool:
        self._collect.publish(Empty())
        with self._changed:
            return self._changed.wait_for(lambda: len(self._reports) == len(ENDS), 0.1)

    def _on_report(self, report: Float64MultiArray) -> None:
        with self._changed:
            self._reports[report.layout.data_offset] = list(report.data)
            self._changed.notify_all()
