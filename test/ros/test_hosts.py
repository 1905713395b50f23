#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers on hosts that are cut off and return: nothing else waits, nothing is lost."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path

import hosts_suite
import rospy
from graph import Heard, peer
from hosts import Host
from hosts_suite import CALL_TIMEOUT, NOTICED, ClaimOverHosts, HostsCase, Split
from manager_suite import LIBRARY, ManagerProcess, listed
from processes import DYKNOW, eventually
from stream_suite import GOAL
from stream_suite import LIBRARY as STREAMS

from dyknow.errors import Refused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.wire.master import Master


class AbsentHostsTest(HostsCase):
    def test_hosts_that_are_cut_off_hold_up_nobody(self):
        far = [self.host(), self.host()]
        for number, host in enumerate(far):
            self.nodelet_manager(host, f"far{number}")
        manager = self.started(own=True, nodelet_managers=["/far0", "/far1"])
        for name in ("far0", "far1"):
            self.hosting(manager, name)
        manager.client.spawn("counter", "/kept", {"out": "/kept/out"}, manager="/far0")
        calm = self.restart_time(manager)
        manager.becomes("/kept", State.RUNNING)
        for name in ("far0", "far1"):
            self.hosting(manager, name)
        before = self.spawn_time(manager)
        with self.network.cut(*far):
            manager.becomes("/kept", State.LOST)
            self.spawns_fast(manager, before)
            limit = calm + 2 * CALL_TIMEOUT
            eventually(lambda: self.restart_time(manager) < limit, 30.0, "a start is fast")
            self.spawns_fast(manager, before)
            self.assertIn("does not answer", manager.becomes("/kept", State.LOST).detail)
        kept = manager.becomes("/kept", State.RUNNING)
        self.assertEqual(listed("/far0"), ["/kept"])
        self.assertEqual(kept.host, far[0].address)
        self.assertEqual(manager.topics("/kept"), {"out": "/kept/out"})
        self.spawns_fast(manager, before)
        manager.client.destroy("/kept")
        self.assertEqual(listed("/far0"), [])

    def test_a_host_whose_name_nobody_can_look_up_holds_up_nobody(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        ghost = Master("/ghost")
        uri, service = "http://absent-robot:7", "rosrpc://absent-robot:9"
        ghost.ask("registerService", "/ghost/list", service, uri)
        self.addCleanup(ghost.ask, "unregisterService", "/ghost/list", service)
        manager = self.make(nodelet_managers=["/ghost"])
        resolver = self.network.desk.silent_resolver(folder.name)
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

    def test_what_cannot_be_destroyed_now_is_refused_and_destroyed_when_its_host_is_back(self):
        far = self.host()
        self.nodelet_manager(far, "far")
        manager = self.started(own=True, nodelet_managers=["/far"])
        self.hosting(manager, "far")
        for name in ("/one", "/two", "/three"):
            manager.client.spawn("counter", name, manager="/far")
        with self.network.cut(far):
            with self.assertRaisesRegex(Refused, "is not destroyed yet"):
                manager.client.destroy("/one")
            manager.kill()
            manager.start()
            for name in ("/one", "/two"):
                with self.assertRaisesRegex(Refused, "is not destroyed yet"):
                    manager.client.destroy(name)
                self.assertIn("as soon as", manager.nodelet(name).detail)
        for name in ("/one", "/two"):
            manager.is_gone(name)
        manager.becomes("/three", State.RUNNING)
        self.assertEqual(listed("/far"), ["/three"])


class SplitTest(Split):
    def test_of_two_nodelet_managers_of_one_name_the_newcomer_survives(self):
        self.newcomer_survives(lambda manager: None)


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


class ClaimTest(ClaimOverHosts):
    def test_what_a_host_that_is_cut_off_supplied_is_replaced_once(self):
        self.with_claim(0.0)
        self.loses_it(self.network.cut(self.far), 2.0)

    def test_a_host_that_is_far_away_is_not_taken_for_one_that_is_away(self):
        self.with_claim(0.0)
        self.keeps_it(self.network.far(self.far, 0.1), 2.0)


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
    hosts_suite.run("hosts")
