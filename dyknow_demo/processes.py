# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What the story runs beside: a ROS master where there is none, a manager, and a battery."""

from __future__ import annotations

import contextlib
import sys
from typing import Any, Callable, Iterator

import rosgraph
import rospy
from sensor_msgs.msg import BatteryState

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.ros.process.owned import Processes
from dyknow.ros.wire.master import Master

#: Names of the nodes that the demonstration starts.
NAMESPACE = "/dyknow_demo"
MANAGER = f"{NAMESPACE}/manager"
_PERIOD = 0.1  # seconds between two messages of the battery


def tell(text: str) -> None:
    """Print a line, whole also where several threads print."""
    print(f"{text}\n", end="", flush=True)


@contextlib.contextmanager
def own_processes() -> Iterator[Processes]:
    """Own a ROS master if none answers, else nothing; raises DyKnowError if time is simulated."""
    is_there = rosgraph.is_master_online()
    with Processes("dyknow_demo") as processes:
        uri = Master(NAMESPACE).uri if is_there else processes.start_master()
        tell(f"ROS master: {f'the one at {uri}' if is_there else f'our own, at {uri}'}")
        master, name = Master(NAMESPACE), "/use_sim_time"
        if master.ask("hasParam", name) and master.ask("getParam", name):
            raise DyKnowError(f"{name} is set, but the demonstration measures in real time")
        yield processes
    with contextlib.suppress(LookupError, PeerTimeout):  # ours has ended
        Master(NAMESPACE).ask("deleteParam", NAMESPACE)


@contextlib.contextmanager
def running_manager(
    processes: Processes, is_up: Callable[[], bool], **parameters: object
) -> Iterator[None]:
    """Start ``MANAGER``; raises DyKnowError if it is there already, or does not come up."""
    if is_up():
        raise DyKnowError(
            f"{MANAGER} is registered at this master already: another demonstration runs there, "
            "or was killed ('rosnode cleanup' forgets it)"
        )
    words = [f"_{key}:={value}" for key, value in parameters.items()]
    name = MANAGER[len(NAMESPACE) + 1 :]
    command = [sys.executable, "-m", "dyknow.cli.manager", *words, f"__name:={name}"]
    try:
        process = processes.start("the manager", command, {"ROS_NAMESPACE": NAMESPACE}, is_up)
        tell(f"manager: {MANAGER}, process {process.pid}\n")
        yield
    except DyKnowError:
        processes.check(patience=0.5)  # a process that ended is the better explanation
        raise


class Battery:
    """Publishes the state of a battery until it is closed; its ``level`` is from 0 to 1."""

    def __init__(self, topic: str, level: float) -> None:
        """Publish on a topic, from a level that stays until ``head_for`` is called."""
        self.level = self._goal = level
        self._step = 0.0
        self._publisher = rospy.Publisher(topic, BatteryState, queue_size=10)
        self._timer = rospy.Timer(rospy.Duration(_PERIOD), self._publish)

    def head_for(self, level: float, seconds: float) -> None:
        """Drain, or charge, to a level within some time."""
        self._goal, self._step = level, abs(level - self.level) * _PERIOD / seconds

    def close(self) -> None:
        self._timer.shutdown()
        self._timer.join(1.0)  # it may be publishing; with simulated time it may sleep for ever
        self._publisher.unregister()

    def _publish(self, event: Any) -> None:
        left = self._goal - self.level
        self.level += max(-self._step, min(self._step, left))
        message = BatteryState(percentage=self.level)
        message.header.stamp = rospy.Time.now()
        self._publisher.publish(message)
