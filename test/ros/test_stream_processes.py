#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims through the death of clients, of the manager, and of the roscore."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import rospy
import rostest
from manager_suite import eventually
from processes import Running
from stream_suite import GOAL, StreamCase

from dyknow.model.streams import ClaimState, StreamRequest

CLIENT = [sys.executable, str(Path(__file__).resolve().parent / "stream_client.py")]


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
            client.stop(signal.SIGKILL)
        self.become(manager, before.claim_id, ClaimState.EXPIRED)

    def test_the_client_died_while_the_manager_was_away(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (claim,) = manager.claims()
            manager.kill()
            client.stop(signal.SIGKILL)
            manager.start()
        self.become(manager, claim.claim_id, ClaimState.EXPIRED, 15.0)
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


if __name__ == "__main__":
    rospy.init_node("stream_processes_test")
    rostest.rosrun("dyknow", "stream_processes", "__main__")
