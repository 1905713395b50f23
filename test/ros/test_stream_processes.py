#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims through the death of clients, of the manager, and of the roscore."""

from __future__ import annotations

import re
import signal
import time

from graph import Heard, peer
from manager_suite import MasterCase, answers
from processes import DYKNOW, Running, eventually, finished, run
from stream_suite import GOAL, LIBRARY, StreamCase

from dyknow.errors import Refused
from dyknow.model.streams import ClaimState, StreamRequest


class ProcessesTest(StreamCase):
    def test_clients_that_end_and_die_and_a_manager_that_ends(self):
        manager = self.tracking()
        for number, state in ((signal.SIGINT, "RELEASED"), (signal.SIGKILL, "EXPIRED")):
            with Running(*peer("claim", GOAL)) as client:
                client.wait_for("ACTIVE")
                (claim,) = manager.claims()
                self.settled(manager)
                client.stop(number)
                client.exit_code(20.0)
            self.become(manager, claim.claim_id, ClaimState[state])
            self.is_cleared(manager)
        self.assertIn("bond", manager.output)
        with Running(*peer("claim", GOAL)) as client:
            client.wait_for("ACTIVE")
            manager.stop()
            client.wait_for("the manager was stopped")
            manager.start()
            self.assertEqual(manager.claims(), [])
            self.assertEqual(manager.client.get_model().nodelets, ())

    def test_kill_9_of_the_manager(self):
        manager = self.tracking()
        found = manager.client.find_bindings("Raw(?camera)", "std_msgs/Header")
        self.assertEqual(found, ("?camera=ceiling", "?camera=own"))
        with self.assertRaisesRegex(Refused, "expected Functor"):
            manager.client.find_bindings("Raw(")
        with Running(*peer("claim", GOAL)) as client, Running(*DYKNOW, "acquire", GOAL) as shell:
            client.wait_for("ACTIVE")
            shell.wait_for("held until Ctrl-C")
            request = StreamRequest("Filtered(ball)", lease=600.0)
            leased = manager.client.acquire_stream(request).claim_id
            before = {each.claim_id: each for each in manager.claims()}
            (own,) = (key for key, each in before.items() if "peer" in each.client_id)
            (held,) = before.keys() - {own, leased}
            self.assertIn(before[held].topic, shell.output)
            flow = self.enter(Heard(before[own].topic))

            def goes_on():
                for claim_id, claim in before.items():
                    self.become(manager, claim_id, ClaimState.ACTIVE)
                    after = self.claim(manager, claim_id)
                    self.assertEqual((after.topic, after.tag), (claim.topic, claim.tag))
                flow.flows()
                self.settled(manager)

            nodelets = before[own].nodelets
            goes_on()
            manager.kill()
            shell.wait_for("waiting for it")
            flow.flows()  # messages flow without the manager
            manager.start()
            shell.wait_for("the manager is back")
            goes_on()
            self.assertEqual(self.claim(manager, own).nodelets, nodelets)
            # Parts that die while the manager is dead are replaced after its restart.
            manager.kill()
            manager.child().signal(signal.SIGKILL)
            manager.start()
            goes_on()
            time.sleep(11.0)  # longer than a lease, and than bonds wait for a client
            goes_on()
            # A client that dies while the manager is dead is missed too.
            manager.kill()
            client.stop(signal.SIGKILL)
            manager.start()
            self.become(manager, own, ClaimState.EXPIRED)
            manager.client.destroy(self.nodelet_of(manager, "tracker"))
            shell.wait_for("active: mended")
            code, output = finished([*DYKNOW, "streams"])
            self.assertEqual(code, 0, output)
            self.assertIn(held, output)
            shell.stop()
            self.assertEqual(shell.exit_code(20.0), 0)
            self.assertIn(f"released {held}", shell.output)
        manager.client.release_stream(leased)
        self.is_cleared(manager)


class RoscoreTest(MasterCase):
    def flows_on(self, listener):
        """Wait until its stream flows; it has always been active."""

        def said():
            return re.findall(r"^([A-Z]+) \S* (flows|still)", listener.output, re.MULTILINE)

        eventually(lambda: said()[-1][1] == "flows", 5.0, "it flows", lambda: listener.output)
        self.assertEqual({state for state, _ in said()}, {"ACTIVE"}, said())

    def start(self):
        manager = self.manager()
        eventually(lambda: answers(self.client), 20.0, "it is up", lambda: manager.output)
        return manager

    def test_the_roscore_goes_and_comes_back(self):
        core = self.roscore()
        manager = self.start()
        self.client.add_transformation(LIBRARY)
        kept = self.client.acquire_stream(StreamRequest("Filtered(ball)"))
        listener = self.run_process(*peer("claim", GOAL, "10"))
        listener.wait_for("flows")

        self.mirrored()
        # Without a master, streams flow on, and their claims are still renewed.
        self.kill(core)
        time.sleep(13.0)  # longer than the lease
        self.flows_on(listener)
        self.assertNotIn("EXPIRED", manager.output)
        self.assertFalse(answers(self.client))  # nothing can be looked up or requested

        # A new master gets all registrations back: requests are answered, no claim has noticed.
        self.roscore()
        eventually(lambda: answers(self.client), 5.0, "it is registered", lambda: manager.output)
        self.flows_on(listener)
        states = {each.claim_id: each.state for each in self.client.list_streams()}
        self.assertEqual(set(states.values()), {ClaimState.ACTIVE}, states)
        self.assertIn(kept.claim_id, states)
        self.run_process(*peer("claim", GOAL)).wait_for("flows")

        # A manager that is killed takes over what it left at the new master.
        self.kill(manager)
        self.start()
        self.flows_on(listener)
        (claim,) = [c for c in self.client.list_streams() if c.claim_id == kept.claim_id]
        self.assertEqual((claim.state, claim.topic), (ClaimState.ACTIVE, kept.topic))


if __name__ == "__main__":
    run()
