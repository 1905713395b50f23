#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`Bonds` against stock sisters in other processes: python3-bondpy, and nodelet_core's client."""

from __future__ import annotations

import dataclasses
import itertools
import queue
import signal
import threading
import time
import unittest

import graph
import rosgraph
import rospy
import rostest
from bond.msg import Constants, Status
from nodelet.srv import NodeletLoad, NodeletLoadResponse, NodeletUnload, NodeletUnloadResponse
from processes import BUSY, STOCK_NODELET, Running, eventually

from dyknow.ros.bonding.bond_table import DuplicateBond
from dyknow.ros.bonding.bonds import STOCK_TIMINGS, Bonds, BondsClosed

SISTERS = [*graph.PEER, "bond"]
#: A bond that breaks within a minute does so because its sister said so.
PATIENT = dataclasses.replace(STOCK_TIMINGS, connect_timeout=60.0, heartbeat_timeout=60.0)
#: One that breaks because its sister is silent, and not because she took long to start.
WATCHFUL = dataclasses.replace(PATIENT, heartbeat_timeout=STOCK_TIMINGS.heartbeat_timeout)
HASTY = dataclasses.replace(PATIENT, heartbeat_timeout=2.5)


def bond_threads():
    return [thread for thread in threading.enumerate() if thread.name == "bonds"]


class BondsTest(unittest.TestCase):
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

    def sisters(self, *bond_ids):
        """Start sisters in another process, and let the bonds form."""
        process = Running(*SISTERS, self.topic, *bond_ids)
        self.addCleanup(process.__exit__)
        self.let_form(process, *bond_ids)
        return process

    def let_form(self, process, *bond_ids):
        """Wait until each end has heard the other."""
        for bond_id in bond_ids:
            process.wait_for(f"formed {bond_id}\n")
        heard = set()  # by this process, so by its bonds as well

        def note(status):
            if status.active and status._connection_header["callerid"] != rospy.get_name():
                heard.add(status.id)

        watch = rospy.Subscriber(self.topic, Status, note)
        eventually(lambda: heard.issuperset(bond_ids), 5.0, f"{bond_ids} are heard", lambda: heard)
        watch.unregister()

    def assert_broken(self, bond_id, within):
        """It breaks in the time (s) of a quiet machine."""
        try:
            self.assertEqual(self.broken.get(timeout=within * BUSY), bond_id)
        except queue.Empty:
            self.fail(f"{bond_id} is not broken within {within * BUSY} s")

    def test_a_sister_that_parts(self):
        self.add("one", "two")
        process = self.sisters("one")
        other = self.sisters("two")
        process.stop()
        self.assert_broken("one", within=3)
        self.assertEqual(process.exit_code(20.0), 0)
        self.bonds.remove("two")
        other.wait_for("broken two", 1.0)
        self.assertTrue(self.broken.empty())

    def test_a_sister_that_is_killed(self):
        self.add("one", bonds=self.make(WATCHFUL))
        process = self.sisters("one")
        process.stop(signal.SIGKILL)
        start = time.monotonic()
        self.assert_broken("one", within=5.5)
        self.assertGreater(time.monotonic() - start, 2.5)

    def test_a_suspended_sister_learns_that_she_was_given_up(self):
        self.add("one", bonds=self.make(HASTY))
        process = self.sisters("one")
        process.stop(signal.SIGSTOP)
        self.assert_broken("one", within=7.5)
        process.stop(signal.SIGCONT)
        process.wait_for("broken one", 1.0)

    def test_removing_before_the_sister_is_there_tells_her_when_she_comes(self):
        late = self.make(dataclasses.replace(STOCK_TIMINGS, disconnect_timeout=20.0))
        self.add("one", bonds=late)
        late.remove("one")
        process = Running(*SISTERS, self.topic, "one")
        self.addCleanup(process.__exit__)
        process.wait_for("broken one", 5.0)
        self.assertTrue(self.broken.empty())

    def test_an_id_once_alive_and_used_again(self):
        self.add("one")
        first = self.sisters("one")
        with self.assertRaises(DuplicateBond):
            self.add("one")
        self.bonds.remove("one")
        self.add("one")
        first.wait_for("broken one", 1.0)
        second = self.sisters("one")
        self.assertTrue(self.broken.empty())
        second.stop()
        self.assert_broken("one", within=3)

    def test_forty_bonds_cost_no_more_threads_than_one(self):
        first, *others = bond_ids = [f"bond{number}" for number in range(40)]
        process = Running(*SISTERS, self.topic, *bond_ids)
        self.addCleanup(process.__exit__)
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
        self.assertEqual({self.broken.get(timeout=5.0 * BUSY) for _ in bond_ids}, set(bond_ids))

    def test_without_bonds_nothing_is_left(self):
        def registered():
            state = rosgraph.Master(rospy.get_name()).getSystemState()
            return any(topic == self.topic for kind in state[:2] for topic, _ in kind)

        self.assertFalse(registered())
        self.add("one")
        process = self.sisters("one")
        process.stop()
        self.assert_broken("one", within=3)
        process.exit_code(20.0)
        eventually(lambda: not bond_threads(), 5.0, "the thread ends")
        eventually(lambda: not registered(), 5.0, "the topic is gone")
        self.add("two")
        self.sisters("two")

    def test_silence_can_be_declared_harmless(self):
        rospy.set_param(Constants.DISABLE_HEARTBEAT_TIMEOUT_PARAM, True)
        self.addCleanup(rospy.set_param, Constants.DISABLE_HEARTBEAT_TIMEOUT_PARAM, False)
        self.add("one", bonds=self.make(HASTY))
        process = self.sisters("one")
        process.stop(signal.SIGKILL)
        with self.assertRaises(queue.Empty):
            self.broken.get(timeout=4.0)
        rospy.set_param(Constants.DISABLE_HEARTBEAT_TIMEOUT_PARAM, False)
        self.assert_broken("one", within=7.5)

    def test_closing_tells_all_sisters(self):
        self.add("one", "two")
        process = self.sisters("one", "two")
        start = time.monotonic()
        self.bonds.close(5.0)
        self.assertLess(time.monotonic() - start, 3)
        process.wait_for("broken one", 1.0)
        process.wait_for("broken two", 1.0)
        self.assertTrue(self.broken.empty())
        with self.assertRaises(BondsClosed):
            self.add("three")


class StockClientTest(unittest.TestCase):
    """This node acts as the manager; nodelet_core's client loads a nodelet into it."""

    def setUp(self):
        self.events = queue.Queue()
        self.bonds = Bonds("~bond")
        self.addCleanup(self.bonds.close)
        load = rospy.Service("~load_nodelet", NodeletLoad, self.on_load)
        self.addCleanup(load.shutdown)
        unload = rospy.Service("~unload_nodelet", NodeletUnload, self.on_unload)
        self.addCleanup(unload.shutdown)
        self.client = Running(*STOCK_NODELET, "load", "some/Class", rospy.get_name())
        self.addCleanup(self.client.__exit__)
        self.bond_id = self.event("loaded")

    def event(self, expected, timeout=10.0):
        """Return the value of the next event; the timeout (s) is for a quiet machine."""
        event, value = self.events.get(timeout=timeout * BUSY)
        self.assertEqual(event, expected)
        return value

    def on_load(self, request):
        self.bonds.add(request.bond_id, lambda: self.events.put(("broken", request.bond_id)))
        self.events.put(("loaded", request.bond_id))
        return NodeletLoadResponse(success=True)

    def on_unload(self, request):
        self.bonds.remove(self.bond_id)
        self.events.put(("unloaded", request.name))
        return NodeletUnloadResponse(success=True)

    def test_the_client_lives_on_and_unloads_when_it_is_stopped(self):
        with self.assertRaises(queue.Empty):
            self.events.get(timeout=12.0)
        self.client.stop()
        self.assertEqual(self.event("unloaded", 1.0), "/some_Class")
        self.assertEqual(self.client.exit_code(20.0), 0)
        self.assertTrue(self.events.empty())

    def test_the_client_is_killed(self):
        graph.let_the_bond_form("~bond")
        self.client.stop(signal.SIGKILL)
        self.assertEqual(self.event("broken", 4.5), self.bond_id)

    def test_the_nodelet_is_unloaded_by_others(self):
        graph.let_the_bond_form("~bond")
        self.bonds.remove(self.bond_id)
        self.client.wait_for("Bond broken, exiting", 2.5)
        self.assertEqual(self.client.exit_code(20.0), 0)
        self.assertTrue(self.events.empty())


if __name__ == "__main__":
    rospy.init_node("bonds_test")
    rostest.rosrun("dyknow", "bonds", "__main__")
