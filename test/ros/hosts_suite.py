# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about several hosts: the network, and nodelet managers on its hosts."""

from __future__ import annotations

import contextlib
import os
import time
import unittest
from typing import Callable, ContextManager

import rospy
import rostest
from graph import Heard
from hosts import Host, Network, missing
from manager_suite import CHILD, LIBRARY, ManagerProcess, listed
from processes import NODELET, Running, becomes, eventually
from stream_suite import GOAL, StreamCase

from dyknow.errors import Refused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.wire.master import Master

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
        for number in range(5):
            begin = time.monotonic()
            name, wiring = f"/timed{number}", {"out": f"/timed{number}/out"}
            manager.client.spawn("counter", name, wiring, manager=where)
            times.append(time.monotonic() - begin)
        for number in range(5):
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
            time.sleep(0.1)


class Split(HostsCase):
    """Two nodelet managers of one name, on hosts that could not see each other."""

    def newcomer_survives(self, meanwhile: Callable[[ManagerProcess], None]) -> None:
        """When the two meet, one goes on with its nodelets and the claims; the other ends."""
        far = self.host()
        elder = self.nodelet_manager(far, "twin")
        manager = self.tracking(own=True, nodelet_managers=["/twin"], num_nodelet_managers=0)
        self.placed(manager)
        events = self.events()
        claim = manager.client.acquire_stream(StreamRequest(GOAL))
        self.assertEqual(len(listed("/twin")), 3)
        flow = self.enter(Heard(claim.topic))
        flow.flows()
        with self.network.cut(far):
            events.mended("does not answer")
            newcomer = self.nodelet_manager(self.host(), "twin")
            self.placed(manager)
            meanwhile(manager)
            self.placed(manager)
            flow.flows()
            changes = events.changes()
        eventually(lambda: elder.has_ended, NOTICED, "the elder ends")
        self.stays(2.0, lambda: not newcomer.has_ended, lambda: newcomer.output)
        manager.becomes("/probe", State.RUNNING)
        self.assertEqual(listed("/twin"), ["/probe"])
        self.assertEqual(self.claim(manager, claim.claim_id).state, ClaimState.ACTIVE)
        self.assertEqual(events.changes(), changes)
        publishers = Master(rospy.get_name()).publishers(claim.topic)
        self.assertEqual(len(publishers), 1, publishers)
        flow.flows()

    def placed(self, manager: ManagerProcess) -> None:
        """Spawn a nodelet in /twin, after the one in an earlier process has gone."""

        def is_placed() -> bool:
            with contextlib.suppress(Refused):
                if manager.nodelet("/probe") is None:
                    manager.client.spawn("camera", "/probe", manager="/twin")
                return listed("/twin") == ["/probe"]
            return False

        eventually(is_placed, NOTICED, "/twin is used", lambda: manager.output)


class ClaimOverHosts(HostsCase):
    """A claim that is met by a nodelet on another host, to which something happens.

    The stream can be made on the desk too.
    """

    def with_claim(self, max_silence: float) -> None:
        self.far = self.host()
        self.far_process = self.nodelet_manager(self.far, "far")
        self.manager = self.tracking(own=True, nodelet_managers=["/far"])
        self.manager.client.add_transformation(LIBRARY)
        self.hosting(self.manager, "far")
        self.manager.client.spawn("camera", "/far_camera", manager="/far")
        self.heard = self.events()
        request = StreamRequest("Filtered(ball)", max_silence=max_silence)
        self.claim_id = self.manager.client.acquire_stream(request).claim_id
        self.assertIn("/far_camera", self.claim(self.manager, self.claim_id).nodelets)
        # A fault before that may be noticed in two steps, a nodelet and then its host.
        self.delivers(self.manager, self.claim_id)
        self.since = len(self.heard)
        self.fast = self.spawn_time(self.manager)

    def changes(self) -> list[str]:
        """Changes of the claim since it was met; an offer of a cheaper way does not count."""
        return self.heard.changes(self.since)

    def is_replaced(self) -> bool:
        claim = self.claim(self.manager, self.claim_id)
        model = self.manager.client.get_model()
        places = {each.manager for each in model.nodelets if each.name in claim.nodelets}
        return claim.state is ClaimState.ACTIVE and "/far" not in places

    def loses_it(self, fault: ContextManager[None], seconds: float) -> None:
        """It is replaced once, other claims stay, and the returning nodelet is removed."""

        def once() -> bool:
            return len(self.changes()) == 2

        with fault:
            eventually(self.is_replaced, NOTICED, "it is replaced")
            eventually(once, NOTICED, "it is told once", self.changes)
            self.heard.is_one_loss(self.since)
            self.spawns_fast(self.manager, self.fast)
            self.stays(seconds, once, self.changes)
            self.assertTrue(self.is_replaced())
        self.manager.becomes("/far_camera", State.RUNNING)
        alone = ["/far_camera"]
        becomes(lambda: listed("/far"), alone)
        self.stays(seconds, lambda: listed("/far") == alone, lambda: listed("/far"))
        self.assertTrue(once(), self.changes())
        self.manager.client.destroy("/far_camera")
        self.assertEqual(listed("/far"), [])
        self.settled(self.manager)

    def keeps_it(self, fault: ContextManager[None], seconds: float) -> None:
        """It does not change, neither during the fault nor after it."""

        def is_calm() -> bool:
            return not self.changes()

        with fault:
            self.stays(seconds, is_calm, self.changes)
            self.manager.client.spawn("relay", "/late", {"in": "/x"}, manager="/far")
            self.manager.client.destroy("/late")
            # On the desk: on the far host a spawn takes eight seconds at 200 ms each way.
            self.spawns_fast(self.manager, self.fast, CHILD)
        self.stays(seconds, is_calm, self.changes)
        self.assertEqual(self.claim(self.manager, self.claim_id).state, ClaimState.ACTIVE)


def run(suite: str) -> None:
    """Run the tests of the main module on a network, if there can be one."""
    if not missing():
        HostsCase.network = Network(os.environ["ROS_MASTER_URI"])
        os.environ["ROS_IP"] = HostsCase.network.desk.address
    rospy.init_node(f"{suite}_test")
    rostest.rosrun("dyknow", suite, "__main__")
