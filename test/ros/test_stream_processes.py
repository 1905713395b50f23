#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims through the death of clients, of the manager, and of the roscore."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from unittest import mock

import rospy
import rostest
from graph import PEER
from manager_suite import MANAGER, eventually
from processes import Running, free_port
from roslib.packages import find_node
from stream_suite import GOAL, LIBRARY, StreamCase

from dyknow.errors import DyKnowError
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.client import ManagerClient
from dyknow.ros.wire.master import Master

CLIENT = [*PEER, "claim"]


class ProcessesTest(StreamCase):
    def test_its_client_dies(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (claim,) = manager.claims()
            self.settled(manager)
            client.stop(signal.SIGKILL)
        took = self.become(manager, claim.claim_id, ClaimState.EXPIRED)
        print(f"a dead client is missed after {took:.1f} s")
        self.assertIn("bond", manager.output)
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")

    def test_its_client_ends(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (claim,) = manager.claims()
            client.stop()
            self.assertEqual(client.exit_code(20.0), 0)
        self.assertIs(self.claim(manager, claim.claim_id).state, ClaimState.RELEASED)

    def test_kill_9_of_the_manager(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (before,) = manager.claims()
            leased = manager.client.acquire_stream(StreamRequest("Filtered(ball)", lease=600.0))
            flow = self.flow(before.topic)
            flow.wait()
            for pause in (0.0, 6.0):
                manager.kill()
                time.sleep(pause)
                flow.wait()  # messages flow without the manager
                manager.start()
                flow.wait()
                self.become(manager, before.claim_id, ClaimState.ACTIVE)
                after = self.claim(manager, before.claim_id)
                self.assertEqual(
                    (after.topic, after.nodelets, after.tag),
                    (before.topic, before.nodelets, before.tag),
                )
                self.assertIs(self.claim(manager, leased.claim_id).state, ClaimState.ACTIVE)
                self.settled(manager)
            # Parts that die while the manager is dead are replaced after its restart.
            manager.kill()
            manager.child().signal(signal.SIGKILL)
            manager.start()
            flow.wait(20.0)
            self.become(manager, before.claim_id, ClaimState.ACTIVE)
            time.sleep(11.0)  # longer than bonds wait for a client that does not come
            self.assertIs(self.claim(manager, before.claim_id).state, ClaimState.ACTIVE)
            self.settled(manager)
            # A client that dies while the manager is dead is missed too.
            manager.kill()
            client.stop(signal.SIGKILL)
            manager.start()
        self.become(manager, before.claim_id, ClaimState.EXPIRED, 15.0)
        manager.client.release_stream(leased.claim_id)
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")

    def test_an_end_on_purpose_ends_claims(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            manager.stop()
            client.wait_for("the manager was stopped", 2.0)
            manager.start()
            self.assertEqual(manager.claims(), [])
            self.assertEqual(manager.client.get_model().nodelets, ())


class RoscoreTest(StreamCase):
    """All processes of this test have a separate master, which can be killed."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.state = folder.name
        self.port = free_port()
        environment = {"ROS_MASTER_URI": f"http://localhost:{self.port}"}
        patch = mock.patch.dict(os.environ, environment)
        patch.start()
        self.addCleanup(patch.stop)
        self.client = ManagerClient(MANAGER, rospy.get_name())
        self.addCleanup(self.end_processes)
        self.processes = []

    def end_processes(self):
        for process in reversed(self.processes):
            if not process.has_ended:
                process.stop()
                try:
                    process.exit_code(20.0)
                except AssertionError:
                    process.__exit__()

    def run_it(self, *command):
        process = Running(*command)
        self.processes.append(process)
        return process

    def roscore(self):
        core = self.run_it("rosmaster", "--core", "-p", self.port)
        eventually(is_online, 10.0, "a master")
        return core

    def manager(self):
        manager = self.run_it(find_node("dyknow", "manager")[0], f"_state_dir:={self.state}")
        eventually(self.answers, 20.0, "the manager is up")
        return manager

    def answers(self):
        try:
            self.client.get_model(1.0)
        except DyKnowError:
            return False
        return True

    def flows_on(self, listener):
        """Wait until its stream flows; it has always been active."""

        def said():
            return [line for line in listener.output.splitlines() if line[0] != "["]

        eventually(lambda: said()[-1].split()[2] == "flows", 5.0, "it flows")
        self.assertEqual({line.split()[0] for line in said()}, {"ACTIVE"}, said())

    def test_the_roscore_goes_and_comes_back(self):
        core = self.roscore()
        manager = self.manager()
        self.client.add_transformation(LIBRARY)
        kept = self.client.acquire_stream(StreamRequest("Filtered(ball)"))
        listener = self.run_it(*CLIENT, GOAL)
        listener.wait_for("flows")

        # Without a master, streams flow on, and their claims are still renewed.
        core.stop(9)
        core.exit_code(5.0)
        time.sleep(35.0)
        self.flows_on(listener)
        self.assertNotIn("EXPIRED", manager.output)
        self.assertFalse(self.answers())  # nothing can be looked up or requested

        # A new master has no registrations: streams flow on, but there are no new requests.
        self.roscore()
        time.sleep(3.0)
        self.assertFalse(self.answers())
        self.flows_on(listener)

        # A restarted manager makes the streams again, behind the same topics.
        manager.stop(9)
        manager.exit_code(5.0)
        manager = self.manager()

        def is_back():
            (claim,) = [c for c in self.client.list_streams() if c.claim_id == kept.claim_id]
            return claim.state is ClaimState.ACTIVE and claim.topic == kept.topic

        eventually(is_back, 40.0, "the stream is back", lambda: manager.output)
        again = self.run_it(*CLIENT, GOAL)
        again.wait_for("flows")
        # Clients that are not registered at the new master are no longer heard: their claims end.
        listener.wait_for("EXPIRED", 40.0)


def is_online():
    try:
        Master("/test").ask("getPid")
    except DyKnowError:
        return False
    return True


if __name__ == "__main__":
    rospy.init_node("stream_processes_test")
    rostest.rosrun("dyknow", "stream_processes", "__main__")
