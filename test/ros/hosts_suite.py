# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about several hosts: the network, and nodelet managers on its hosts."""

from __future__ import annotations

import contextlib
import os
import signal
import time
import unittest
from typing import Callable, ContextManager, Iterator, Sequence

import rospy
import rostest
from hosts import Host, Network, missing
from manager_suite import CHILD, LIBRARY, ManagerProcess, eventually, listed
from processes import NODELET, Running
from stream_suite import GOAL, StreamCase

from dyknow.errors import Refused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamEvent, StreamRequest
from dyknow.ros.wire.master import Master

#: The manager notices within this many seconds that a host is unreachable, or back.
NOTICED = 5.0
#: Time limit (s) of a remote call: a step that waits for none is faster than this.
CALL_TIMEOUT = 1.0


def changes_of_state(events: Sequence[StreamEvent]) -> list[str]:
    """Reasons of the changes of claims' states; changes of the detail alone are left out."""
    return [
        f"{each.after.state.name}: {each.reason}"
        for each in events
        if each.before is None or each.before.state is not each.after.state
    ]


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

        def spawned() -> bool:
            try:
                manager.client.spawn("counter", f"/{name}_probe", manager=f"/{name}")
            except Refused as error:
                assert f"nodelet manager '/{name}'" in str(error), error
                return False
            return True

        eventually(spawned, NOTICED, f"/{name} is used")
        manager.client.destroy(f"/{name}_probe")

    def state_of(self, manager: ManagerProcess, name: str) -> State | None:
        found = manager.nodelet(name)
        return None if found is None else found.state

    def becomes(self, manager: ManagerProcess, name: str, state: State | None) -> None:
        what = f"{name} is {state.name if state is not None else 'gone'}"
        eventually(lambda: self.state_of(manager, name) is state, NOTICED, what)

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
        eventually(lambda: self.placed(manager, "/twin"), NOTICED, "/twin is used")
        events = self.events()
        claim = manager.client.acquire_stream(StreamRequest(GOAL))
        self.assertEqual(len(listed("/twin")), 3)
        flow = self.flow(claim.topic)
        flow.wait()
        with self.network.cut(far):
            events.mended("does not answer")
            newcomer = self.nodelet_manager(self.host(), "twin")
            eventually(lambda: self.placed(manager, "/twin"), NOTICED, "the newcomer is used")
            meanwhile(manager)
            eventually(lambda: self.placed(manager, "/twin"), NOTICED, "the newcomer is used")
            flow.wait()
            told = len(changes_of_state(events.all))
        eventually(lambda: elder.has_ended, NOTICED, "the elder ends")
        self.stays(2.0, lambda: not newcomer.has_ended, lambda: newcomer.output)
        self.assertEqual(self.state_of(manager, "/probe"), State.RUNNING)
        self.assertEqual(listed("/twin"), ["/probe"])
        self.assertEqual(self.claim(manager, claim.claim_id).state, ClaimState.ACTIVE)
        changes = changes_of_state(events.all)
        self.assertEqual(len(changes), told, changes)
        publishers = Master(rospy.get_name()).publishers(claim.topic)
        self.assertEqual(len(publishers), 1, publishers)
        flow.wait()

    def placed(self, manager: ManagerProcess, name: str) -> bool:
        """Spawn a nodelet in it, after the one in an earlier process has gone."""
        try:
            if manager.nodelet("/probe") is None:
                manager.client.spawn("camera", "/probe", manager=name)
            return listed(name) == ["/probe"]
        except Refused:
            return False


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
        eventually(
            lambda: not self.claim(self.manager, self.claim_id).detail,
            20.0,
            "its message has come",
        )
        self.heard_before = len(self.heard.all)
        self.fast = self.spawn_time(self.manager)

    def reasons(self) -> list[str]:
        """Why the claim changed since it was met; an offer of a cheaper way does not count."""
        return changes_of_state(self.heard.all[self.heard_before :])

    def mended(self) -> int:
        return sum(each.startswith("ACTIVE: mended") for each in self.reasons())

    def on_far(self) -> list[str]:
        """Nodelets of the claim that run on the other host."""
        claim = self.claim(self.manager, self.claim_id)
        model = self.manager.client.get_model()
        places = {each.name: each.manager for each in model.nodelets}
        return [name for name in claim.nodelets if places.get(name) == "/far"]

    def is_met(self) -> bool:
        return self.claim(self.manager, self.claim_id).state is ClaimState.ACTIVE

    def loses_it(self, fault: ContextManager[None], seconds: float) -> None:
        """It is replaced once, other claims stay, and the returning nodelet is removed."""
        with fault:
            eventually(lambda: self.is_met() and not self.on_far(), NOTICED, "it is replaced")
            eventually(lambda: self.mended() == 1, NOTICED, "it is told once", self.reasons)
            states = [each.partition(":")[0] for each in self.reasons()]
            self.assertEqual(states, ["RECOVERING", "ACTIVE"], self.reasons())
            changes = len(states)
            self.assertLess(self.spawn_time(self.manager), self.fast + CALL_TIMEOUT)
            self.stays(seconds, lambda: len(self.reasons()) == changes, self.reasons)
            self.assertTrue(self.is_met(), self.reasons())
        self.becomes(self.manager, "/far_camera", State.RUNNING)
        alone = ["/far_camera"]
        eventually(lambda: listed("/far") == alone, 3 * NOTICED, "/far is cleared up")
        self.stays(seconds, lambda: listed("/far") == alone, lambda: listed("/far"))
        self.assertEqual(len(self.reasons()), changes, self.reasons())
        self.manager.client.destroy("/far_camera")
        self.assertEqual(listed("/far"), [])
        self.settled(self.manager)

    def keeps_it(self, fault: ContextManager[None], seconds: float) -> None:
        """It does not change, neither during the fault nor after it."""
        with fault:
            self.stays(seconds, lambda: not self.reasons(), self.reasons)
            self.manager.client.spawn("relay", "/late", {"in": "/x"}, manager="/far")
            self.manager.client.destroy("/late")
            # On the desk: on the far host a spawn takes eight seconds at 200 ms each way.
            self.assertLess(self.spawn_time(self.manager, CHILD), self.fast + CALL_TIMEOUT)
        self.stays(seconds, lambda: not self.reasons(), self.reasons)
        self.assertEqual(self.claim(self.manager, self.claim_id).state, ClaimState.ACTIVE)

    @contextlib.contextmanager
    def stopped(self) -> Iterator[None]:
        """Stop the process of the other host."""
        self.far_process.stop(signal.SIGSTOP)
        try:
            yield
        finally:
            self.far_process.stop(signal.SIGCONT)


def run(suite: str) -> None:
    """Run the tests of the main module on a network, if there can be one."""
    if not missing():
        HostsCase.network = Network(os.environ["ROS_MASTER_URI"])
        os.environ["ROS_IP"] = HostsCase.network.desk.address
    rospy.init_node(f"{suite}_test")
    rostest.rosrun("dyknow", suite, "__main__")
