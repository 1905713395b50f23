# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about several hosts: the network, and nodelet managers on its hosts."""

from __future__ import annotations

import os
import time
import unittest
from typing import Callable

import processes
from hosts import Host, Network, missing
from manager_suite import ManagerProcess, listed
from processes import NODELET, Running, eventually
from stream_suite import StreamCase

#: The manager notices within this many seconds that a host is unreachable, or back.
NOTICED = 5.0
#: Time limit (s) of a remote call: a step that waits for none is faster than this.
CALL_TIMEOUT = 1.0


class HostsCase(StreamCase):
    """Each test makes its own hosts on the suite's network, and runs on the desk."""

    network: Network

    def setUp(self) -> None:
        lacking = missing()
        if lacking:
            print(f"skipped: {lacking}")  # rostest's results do not contain it
            raise unittest.SkipTest(lacking)

    def host(self) -> Host:
        """Make a host that stays after the test, to refuse connections to its ended processes.

        The master has three threads to notify nodes of changes, and each waits for two minutes for
        a host that does not answer.
        """
        return self.network.host()

    def nodelet_manager(self, host: Host, name: str) -> Running:
        """Start a nodelet manager on a host and wait until it is up."""
        process = host.run(*NODELET, "manager", f"__name:={name}")
        self.addCleanup(process.__exit__)
        process.wait_for("Initializing nodelet")
        eventually(lambda: listed(f"/{name}") is not None, 10.0, f"{name} is up")
        return process

    def hosting(self, manager: ManagerProcess, name: str) -> None:
        """Wait until the manager can spawn in an external nodelet manager."""
        self.spawned(manager, f"/{name}_probe", f"/{name}")
        manager.client.destroy(f"/{name}_probe")

    def spawn_time(self, manager: ManagerProcess, where: str = "") -> float:
        """Time (s) of the fastest of some spawns: it shows any wait for a remote time limit.

        Args:
            manager: the manager that spawns.
            where: nodelet manager to use; empty for the manager's choice.
        """
        times = []
        for number in range(3):
            begin = time.monotonic()
            name, wiring = f"/timed{number}", {"out": f"/timed{number}/out"}
            manager.client.spawn("counter", name, wiring, manager=where)
            times.append(time.monotonic() - begin)
        for number in range(3):
            manager.client.destroy(f"/timed{number}")
        return min(times)

    def spawns_fast(self, manager: ManagerProcess, than: float, where: str = "") -> None:
        """Wait for spawns none of which waits for a remote time limit.

        One that a busy machine holds up is repeated: one that waits does so each time.
        """
        limit = than + CALL_TIMEOUT
        eventually(lambda: self.spawn_time(manager, where) < limit, 20.0, "spawns are fast")

    def restart_time(self, manager: ManagerProcess) -> float:
        """Kill the manager and start it again; returns how long (s) the start took."""
        manager.kill()
        begin = time.monotonic()
        manager.start()
        return time.monotonic() - begin

    def stays(self, seconds: float, holds: Callable[[], bool], what: Callable[[], object]) -> None:
        """Check that something holds for a while; ``what`` is the message if it does not."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            assert holds(), what()
            time.sleep(0.25)


def run() -> None:
    """Run the tests of the main module on a network, if there can be one."""
    if not missing():
        HostsCase.network = Network(os.environ["ROS_MASTER_URI"])
        os.environ["ROS_IP"] = HostsCase.network.desk.address
    processes.run()
