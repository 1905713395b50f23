#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers on hosts that are cut off and return: nothing else waits, nothing is lost.

In the long run (DYKNOW_TEST_SECONDS) a claim goes through every fault of a link or a process.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import Callable, ContextManager

import hosts_suite
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph import Heard, comes, peer
from hosts import Host
from hosts_suite import CALL_TIMEOUT, NOTICED, HostsCase
from manager_suite import CHILD, LIBRARY, MANAGER, ManagerProcess, listed
from processes import DYKNOW, Done, becomes, eventually, suspended
from roslib.packages import find_node
from stream_suite import GOAL
from stream_suite import LIBRARY as STREAMS
from test_host_faults import HostFaultsTest

from dyknow.errors import Refused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.wire.master import Master

__all__ = ["HostFaultsTest"]  # is run here with few faults, and with many in the long run

CPP_MANAGER = find_node("dyknow", "cpp_nodelet_manager")[0]
#: Seconds for which each fault lasts, and for which its end is watched; more in the long run.
SECONDS = float(os.environ.get("DYKNOW_TEST_SECONDS", 2.0))
IS_LONG = SECONDS > 2.0
#: Name, whether nodelets on the other host count as lost, and the fault. One without a loss leaves
#: everything as it was, for the next one.
FAULTS: tuple[tuple[str, bool, Callable[[ClaimTest], ContextManager[None]]], ...] = (
    ("100 ms each way", False, lambda case: case.network.far(case.far, 0.1)),
    ("200 ms each way", False, lambda case: case.network.far(case.far, 0.2)),
    ("the link is cut", True, lambda case: case.network.cut(case.far)),
    ("it is not heard", True, lambda case: case.network.without((case.far, case.desk))),
    ("it hears nothing", True, lambda case: case.network.without((case.desk, case.far))),
    ("its process is stopped", True, lambda case: suspended(case.far_process.pid)),
)
#: Limits (s) of the claim; with one, its parts must not be silent.
SILENCES = (0.0, 1.0)


class AbsentHostsTest(HostsCase):
    def test_hosts_that_are_cut_off_hold_up_nobody(self):
        far = [self.host(), self.host()]
        for number, host in enumerate(far):
            self.nodelet_manager(host, f"far{number}")
        manager = self.started(own=True, nodelet_managers=["/far0", "/far1"])
        for name in ("far0", "far1"):
            self.hosting(manager, name)
        manager.client.spawn("counter", "/kept", {"out": "/kept/out"}, manager="/far0")
        for name in ("/one", "/two"):
            manager.client.spawn("counter", name, manager="/far0")
        calm = self.restart_time(manager)
        manager.becomes("/kept", State.RUNNING)
        for name in ("far0", "far1"):
            self.hosting(manager, name)
        before = self.spawn_time(manager)
        with self.network.cut(*far):
            manager.becomes("/kept", State.LOST)
            self.spawns_fast(manager, before)
            self.refuses_to_destroy(manager, "/one")
            limit = calm + 2 * CALL_TIMEOUT
            eventually(lambda: self.restart_time(manager) < limit, 30.0, "a start is fast")
            self.spawns_fast(manager, before)
            self.refuses_to_destroy(manager, "/one", "/two")
            self.assertIn("does not answer", manager.becomes("/kept", State.LOST).detail)
        for name in ("/one", "/two"):
            manager.is_gone(name)
        kept = manager.becomes("/kept", State.RUNNING)
        self.assertEqual(listed("/far0"), ["/kept"])
        self.assertEqual(kept.host, far[0].address)
        self.assertEqual(manager.topics("/kept"), {"out": "/kept/out"})
        self.spawns_fast(manager, before)
        manager.client.destroy("/kept")
        self.assertEqual(listed("/far0"), [])

    def refuses_to_destroy(self, manager: ManagerProcess, *names: str) -> None:
        """Such a nodelet is destroyed as soon as its host is back."""
        for name in names:
            with self.assertRaisesRegex(Refused, "is not destroyed yet"):
                manager.client.destroy(name)
            self.assertIn("as soon as", manager.nodelet(name).detail)

    def test_a_host_whose_name_nobody_can_look_up_holds_up_nobody(self):
        ghost = Master("/ghost")
        uri, service = "http://absent-robot:7", "rosrpc://absent-robot:9"
        ghost.ask("registerService", "/ghost/list", service, uri)
        self.addCleanup(ghost.ask, "unregisterService", "/ghost/list", service)
        manager = self.make(nodelet_managers=["/ghost"])
        resolver = self.network.desk.silent_resolver(str(self.make_folder()))
        manager.command = self.network.desk.command(*manager.command, resolver=resolver)
        manager.start()
        manager.client.add_transformation(LIBRARY)
        self.spawns_fast(manager, 0.0)
        tasks = Path(f"/proc/{manager.process.pid}/task")

        def threads() -> int:
            return len(list(tasks.iterdir()))

        before = threads()
        self.stays(3.0, lambda: threads() < before + 5, threads)
        with self.assertRaisesRegex(Refused, "'/ghost' does not answer"):
            manager.client.spawn("counter", "/there", manager="/ghost")


class ClocksTest(HostsCase):
    """Hosts report their load and time, in Python and in C++; a clock that is ahead is named."""

    #: Runs a nodelet manager whose clock is two seconds ahead.
    AHEAD = """
import sys, time
from unittest import mock
real = time.time
mock.patch("time.time", lambda: real() + 2.0).start()
from dyknow.cli.nodelet import main
sys.exit(main())
"""

    def test_the_hosts_and_their_clocks(self):
        rover, scout = self.host(), self.host()
        for host, command in (
            (rover, (sys.executable, "-c", self.AHEAD, "manager", "__name:=ahead")),
            (scout, (CPP_MANAGER, "__name:=native")),
        ):
            self.addCleanup(host.run(*command).__exit__)
        manager = self.started(own=True, nodelet_managers=["/ahead", "/native"])

        def offsets() -> dict[str, float]:
            hosts = manager.client.list_hosts()
            return {each.name: round(each.offset) for each in hosts if each.error < 0.3}

        becomes(offsets, {self.network.desk.address: 0, rover.address: 2, scout.address: 0}, 20.0)
        self.assertGreater(min(each.cores for each in manager.client.list_hosts()), 0)
        clocks = [e for e in Done("doctor", "--json").json["findings"] if e["check"] == "hosts"]
        self.assertEqual([each["subject"] for each in clocks], [rover.address], clocks)
        self.assertRegex(clocks[0]["problem"], r"its clock differs by \+[12]\.\d+ s")
        name = f"{MANAGER.lstrip('/')}: host {rover.address}"
        found = comes("/diagnostics", DiagnosticArray, lambda each: named(each, name))
        self.assertIn("its clock differs by +", named(found, name).message)
        self.assertEqual(named(found, name).level, DiagnosticStatus.WARN)

    def test_a_host_that_is_away_is_shown_and_keeps_what_is_pinned(self):
        rover = self.host()
        process = self.nodelet_manager(rover, "rover")
        manager = self.started(own=True, nodelet_managers=["/rover"])
        self.hosting(manager, "rover")
        done = Done("spawn", "counter", "/kept", "--host", rover.address)
        self.assertEqual(done.code, 0, done.err)

        def state() -> bool:
            hosts = {each.name: each for each in manager.client.list_hosts()}
            return hosts[rover.address].is_away

        with self.network.cut(rover):
            becomes(state, True, NOTICED)
            manager.becomes("/kept", State.LOST)
            done = Done("spawn", "counter", "/x", "--host", rover.address)
            self.assertEqual((done.code, "does not answer" in done.err), (1, True), done.err)
            self.assertRegex(Done("list", "--hosts").out, r"away since \d\d:")
        becomes(state, False, NOTICED)
        manager.becomes("/kept", State.RUNNING)
        process.__exit__()
        manager.becomes("/kept", State.LOST)
        manager.kill()
        manager.start()
        self.nodelet_manager(rover, "rover")
        becomes(lambda: listed("/rover"), ["/kept"], 20.0)


def named(array: DiagnosticArray, name: str) -> DiagnosticStatus | None:
    return next((each for each in array.status if each.name == name), None)


class SplitTest(HostsCase):
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

    def test_the_newcomer_survives(self):
        self.newcomer_survives(lambda manager: None)


if IS_LONG:

    class RestartedSplitTest(SplitTest):
        """The manager is started again meanwhile, and so has never seen the elder."""

        def test_the_newcomer_survives(self):
            self.newcomer_survives(self.restart_time)


class TwoManagersTest(HostsCase):
    """Two DyKnow managers of one name, on hosts that could not see each other."""

    def manager_on(self, host: Host) -> ManagerProcess:
        manager = self.make()
        manager.command = host.command(*manager.command)
        manager.start()
        manager.client.add_transformation(STREAMS)
        return manager

    def test_the_elder_goes_on_with_all_it_had_and_the_other_one_leaves(self):
        robot, base = self.host(), self.host()
        elder = self.manager_on(robot)
        elder.client.spawn("camera", "/kept", {"out": "/kept/out"}, is_protected=True)
        claim = elder.client.acquire_stream(StreamRequest(GOAL))
        flow = self.enter(Heard(claim.topic))
        flow.flows()
        child = elder.child()
        with self.network.cut(robot):
            younger = self.manager_on(base)
            younger.client.spawn("camera", "/other", {"out": "/other/out"}, is_protected=True)
            younger.client.acquire_stream(StreamRequest("Raw(own)"))
        eventually(lambda: younger.process.poll() is not None, 30.0, "the younger one leaves")

        def is_whole() -> bool:
            with contextlib.suppress(Exception):
                found = elder.nodelet("/kept")
                is_met = self.claim(elder, claim.claim_id).state is ClaimState.ACTIVE
                return is_met and found.is_protected and found.state is State.RUNNING
            return False

        eventually(is_whole, 30.0, "the elder has everything", lambda: elder.output)
        flow.flows()
        self.stays(3.0, is_whole, lambda: elder.output)
        self.assertEqual(len(Master(rospy.get_name()).publishers(claim.topic)), 1)
        self.assertIsNone(elder.process.poll(), elder.output)
        self.assertIn("leaves; its state stays", younger.output)
        self.assertEqual(elder.child(), child, "its nodelets were not disturbed")


class ClaimTest(HostsCase):
    """A claim that is met by a nodelet on another host, to which something happens.

    The stream can be made on the desk too.
    """

    def with_claim(self, max_silence: float) -> None:
        self.far, self.desk = self.host(), self.network.desk
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

    def loses_it(self, fault: ContextManager[None]) -> None:
        """It is replaced once, other claims stay, and the returning nodelet is removed."""

        def once() -> bool:
            return len(self.changes()) == 2

        with fault:
            eventually(self.is_replaced, NOTICED, "it is replaced")
            eventually(once, NOTICED, "it is told once", self.changes)
            self.heard.is_one_loss(self.since)
            self.spawns_fast(self.manager, self.fast)
            self.stays(SECONDS, once, self.changes)
            self.assertTrue(self.is_replaced())
        self.manager.becomes("/far_camera", State.RUNNING)
        alone = ["/far_camera"]
        becomes(lambda: listed("/far"), alone)
        self.stays(SECONDS, lambda: listed("/far") == alone, lambda: listed("/far"))
        self.assertTrue(once(), self.changes())
        self.manager.client.destroy("/far_camera")
        self.assertEqual(listed("/far"), [])
        self.settled(self.manager)

    def keeps_it(self, fault: ContextManager[None]) -> None:
        """It does not change, neither during the fault nor after it."""

        def is_calm() -> bool:
            return not self.changes()

        with fault:
            self.stays(SECONDS, is_calm, self.changes)
            self.manager.client.spawn("relay", "/late", {"in": "/x"}, manager="/far")
            self.manager.client.destroy("/late")
            # On the desk: on the far host a spawn takes eight seconds at 200 ms each way.
            self.spawns_fast(self.manager, self.fast, CHILD)
        self.stays(SECONDS, is_calm, self.changes)
        self.assertEqual(self.claim(self.manager, self.claim_id).state, ClaimState.ACTIVE)

    if IS_LONG:  # HostFaultsTest has such faults in the quick run

        def test_faults(self):
            for max_silence in SILENCES:
                is_ready = False
                for name, is_loss, fault in FAULTS:
                    with self.subTest(name, max_silence=max_silence):
                        if not is_ready:
                            self.with_claim(max_silence)
                        is_ready = False
                        (self.loses_it if is_loss else self.keeps_it)(fault(self))
                        is_ready = not is_loss
                    if not is_ready:
                        self.doCleanups()


class LeaseTest(HostsCase):
    def test_leases_outlast_a_master_that_is_away(self):
        robot, laptop = self.host(), self.host()
        manager = self.make()
        manager.command = robot.command(*manager.command)
        manager.start()
        manager.client.add_transformation(STREAMS)
        with laptop.run(*peer("claim", "Filtered(ball)", "10")) as program, laptop.run(
            *DYKNOW, "acquire", "Position(ball)"
        ) as shell:
            program.wait_for("flows")
            shell.wait_for("held until")
            desk = self.network.desk
            ways = [(desk, host) for host in (robot, laptop)]
            with self.network.without(*ways, *[(host, desk) for desk, host in ways]):
                self.stays(
                    12.0,  # the shell's lease is 10 s
                    lambda: not shell.has_ended and not program.has_ended,
                    lambda: shell.output + program.output,
                )
            heard = "the master has heard all that was sent meanwhile"
            eventually(lambda: robot.is_heard() and laptop.is_heard(), 2 * NOTICED, heard)
            states = {each.state for each in manager.client.list_streams()}
            self.assertEqual(states, {ClaimState.ACTIVE}, shell.output + program.output)
            self.assertNotIn("EXPIRED", manager.output)


if __name__ == "__main__":
    hosts_suite.run()
