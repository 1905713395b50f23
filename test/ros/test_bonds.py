#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`Bonds` against python3-bondpy in other processes.

`test_nodelet_command` has nodelet_core's clients and managers.
"""

from __future__ import annotations

import dataclasses
import itertools
import queue
import signal
import threading

import rospy
from bond.msg import Constants, Status
from graph import Heard, nodes_on, peer
from processes import BUSY, TellingCase, becomes, eventually, run

from dyknow.ros.bonding.bonds import STOCK_TIMINGS, Bonds, BondsClosed

#: A bond that breaks within this time (s) does so because its sister said so.
LONG = 20.0 * BUSY
PATIENT = dataclasses.replace(STOCK_TIMINGS, connect_timeout=LONG, heartbeat_timeout=LONG)
#: One that breaks because its sister is silent, and not because she took long to start.
WATCHFUL = dataclasses.replace(PATIENT, heartbeat_timeout=STOCK_TIMINGS.heartbeat_timeout)


def bond_threads():
    return [thread for thread in threading.enumerate() if thread.name == "bonds"]


class BondsTest(TellingCase):
    topics = (f"/bonds_test_{number}/bond" for number in itertools.count())

    def setUp(self):
        self.topic = next(self.topics)
        self.broken = queue.Queue()
        self.bonds = self.make(PATIENT)

    def make(self, timings):
        bonds = Bonds(self.topic, timings)
        self.addCleanup(bonds.close, 0.0)
        return bonds

    def add(self, *bond_ids, bonds=None):
        for bond_id in bond_ids:
            (bonds or self.bonds).add(bond_id, lambda b=bond_id: self.broken.put(b))

    def start_sisters(self, *bond_ids):
        return self.run_process(*peer("bond", self.topic, *bond_ids))

    def sisters(self, *bond_ids):
        """Start sisters in another process, and let the bonds form."""
        process = self.start_sisters(*bond_ids)
        self.let_form(process, *bond_ids)
        return process

    def let_form(self, process, *bond_ids):
        """Wait until each end has heard the other: the bonds hear all that this process hears."""

        def note(status):
            is_other = status._connection_header["callerid"] != rospy.get_name()
            return status.id if status.active and is_other else ""

        with Heard(self.topic, Status, note) as heard:
            for bond_id in bond_ids:
                process.wait_for(f"formed {bond_id}\n")
            eventually(lambda: {*bond_ids} <= {*heard}, 5.0, f"{bond_ids} are heard")

    def breaks(self, *bond_ids):
        broken = {self.broken.get(timeout=LONG / 2) for _ in bond_ids}
        self.assertEqual(broken, {*bond_ids})

    def test_a_suspended_sister_learns_that_she_was_given_up(self):
        self.add("one", bonds=self.make(WATCHFUL))
        process = self.sisters("one")
        process.stop(signal.SIGSTOP)
        self.breaks("one")
        process.stop(signal.SIGCONT)
        process.wait_for("broken one")

    def test_forty_bonds_cost_no_more_threads_than_one(self):
        first, *others = bond_ids = [f"bond{number}" for number in range(40)]
        process = self.start_sisters(*bond_ids)
        bonds = self.make(WATCHFUL)
        self.add(first, bonds=bonds)
        self.let_form(process, first)
        threads_of_one = threading.active_count()
        self.add(*others, bonds=bonds)
        self.let_form(process, *others)
        self.assertEqual(len(bond_threads()), 1)
        eventually(
            lambda: threading.active_count() <= threads_of_one,
            5.0,
            "40 bonds have no more threads than one",
            threading.enumerate,
        )
        process.stop(signal.SIGKILL)
        self.breaks(*bond_ids)

    def test_without_bonds_nothing_is_left(self):
        self.assertFalse(any(nodes_on(self.topic)))
        self.add("one")
        process = self.sisters("one")
        process.stop()
        self.breaks("one")
        process.exit_code(20.0)
        becomes(bond_threads, [])
        becomes(lambda: nodes_on(self.topic), (set(), set()))
        self.add("two")
        self.sisters("two")

    def test_silence_can_be_declared_harmless(self):
        rospy.set_param(Constants.DISABLE_HEARTBEAT_TIMEOUT_PARAM, True)
        self.addCleanup(rospy.set_param, Constants.DISABLE_HEARTBEAT_TIMEOUT_PARAM, False)
        hasty = dataclasses.replace(PATIENT, heartbeat_timeout=2.5)
        self.add("one", bonds=self.make(hasty))
        self.sisters("one").stop(signal.SIGKILL)
        with self.assertRaises(queue.Empty):
            self.broken.get(timeout=4.0)
        rospy.set_param(Constants.DISABLE_HEARTBEAT_TIMEOUT_PARAM, False)
        self.breaks("one")

    def test_closing_tells_all_sisters(self):
        self.add("one", "two")
        process = self.sisters("one", "two")
        self.bonds.close(LONG)
        process.wait_for("broken one")
        process.wait_for("broken two")
        self.assertTrue(self.broken.empty())
        with self.assertRaises(BondsClosed):
            self.add("three")


if __name__ == "__main__":
    run()
