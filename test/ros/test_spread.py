#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Busy nodelets move to another process of their host: each message is received once, in order."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal

import rospy
from dyknow_msgs.srv import HandOver, HandOverRequest
from graph import Heard, Manager
from manager_suite import CHILD, ManagerCase, gaps, library, listed, specification
from processes import TellingCase, becomes, eventually, run
from std_msgs.msg import Header

from dyknow.errors import HostError
from dyknow.model.graph import State
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

SECOND = f"{CHILD}_2"
RATE = 50.0
#: Seconds of processor time for each message: a nodelet takes a quarter of a core.
WORK = 0.005
#: Moves of one nodelet back and forth.
MOVES = int(os.environ.get("DYKNOW_TEST_MOVES", "10"))
SPREAD = {"spread": "auto", "spread_load": 0.2}
BUSY = library(
    specification("busy", "dyknow_manager_test/Busy", ">in out>", work=WORK),
    specification("slow", "dyknow_manager_test/Busy", ">in out>", work=WORK, start=3.0),
    specification("counter", "dyknow_manager_test/Counter", "out>", rate=RATE),
    specification("relay", "dyknow_manager_test/Relay", ">in out>"),
)


def parts(message):
    number, process = message.frame_id.split()
    return int(number), process


class SpreadTest(ManagerCase):
    def spread(self, label="busy", count=2, **parameters):
        """Start busy nodelets on one stream, which cannot move, in one nodelet manager."""
        manager = self.running(own=True, **SPREAD, **parameters)
        client = manager.client
        client.add_transformation(BUSY)
        client.spawn("counter", "/counter", config={"out": "/numbers"}, is_protected=True)
        self.heard = {}
        for number in range(count):
            name = f"/busy_{number}"
            config = {"in": "/numbers", "out": f"{name}/out"}
            client.spawn(label, name, config=config, manager=CHILD)
            self.heard[name] = self.enter(Heard(f"{name}/out", Header, parts))
        return manager

    def moved(self, manager):
        """Wait until a nodelet sends from the other process; returns its name."""

        def found():
            return [n for n, heard in self.heard.items() if heard and heard[-1][1] == SECOND]

        eventually(found, 60.0, "one has moved", lambda: manager.output[-3000:])
        return found()[0]

    def is_whole(self, name):
        numbers = [number for number, _ in self.heard[name]]
        self.assertEqual(gaps(numbers), [])

    def test_a_busy_nodelet_moves_and_misses_nothing(self):
        manager = self.spread()
        client = manager.client
        config = {"in": "/busy_0/out", "out": "/passed"}
        client.spawn("relay", "/relay", config=config, is_protected=True)
        passed = self.enter(Heard("/passed", Header, parts))
        name = self.moved(manager)
        self.assertEqual(manager.becomes(name, State.RUNNING).manager, SECOND)
        for heard in (*self.heard.values(), passed):
            heard.flows(100)
        for each in self.heard:
            self.is_whole(each)
        self.assertEqual(gaps([number for number, _ in passed]), [])
        self.assertIn(f"{name} is moved from {CHILD} to {SECOND}", manager.output)
        self.assertEqual({*listed(CHILD), *listed(SECOND)}, {"/counter", "/relay", *self.heard})

    def test_a_target_that_is_killed_in_the_middle_leaves_the_nodelet_once(self):
        manager = self.spread("slow", num_nodelet_managers=2)
        moving = f"it is being moved to {SECOND}"

        def found():
            nodelets = (manager.nodelet(name) for name in self.heard)
            return [each.name for each in nodelets if each.detail.startswith(moving)]

        eventually(found, 60.0, "one is being moved", lambda: manager.output[-3000:])
        (name,) = found()
        manager.kill_child(SECOND, signal.SIGKILL)
        manager.becomes(name, State.RUNNING)
        self.heard[name].flows(100)
        numbers = [number for number, _ in self.heard[name]]
        self.assertEqual(numbers, sorted({*numbers}))
        everywhere = ["/busy_0", "/busy_1", "/counter"]
        becomes(lambda: sorted([*listed(CHILD), *listed(SECOND)]), everywhere)


class HandOverTest(TellingCase):
    """A nodelet between two nodelet managers, from one to the other and back."""

    def setUp(self):
        super().setUp()
        self.places = [self.enter(Manager(name)) for name in ("/left", "/right")]

    def step(self, place, step, topics=()):
        service, beside = f"{place.name}/hand_over", f"{place.name}/list"
        client = ServiceClient(Master(rospy.get_name()), service, HandOver, beside=beside)
        return client.call(10.0, "/moving", step, topics).topics

    def load(self, place, work=0.001):
        wiring = {"/in": "/numbers", "/out": "/out"}
        place.load("dyknow_manager_test/Busy", "/moving", wiring, work=work)

    def noted(self, place):
        """Have it noted what the nodelet is given, as soon as it is not far behind."""
        found = []

        def is_noted():
            with contextlib.suppress(HostError):
                found[:] = self.step(place, HandOverRequest.NOTE)
            return found

        eventually(is_noted, 20.0, "it is noted")
        return found

    def move(self, source, target):
        topics = self.noted(source)
        self.step(target, HandOverRequest.PARK, topics)
        given = self.step(source, HandOverRequest.GIVE)
        self.step(target, HandOverRequest.TAKE, given)
        self.load(target)
        self.step(target, HandOverRequest.END)

    def test_nothing_is_lost_or_doubled_however_often_it_moves(self):
        numbers = itertools.count()
        publisher = self.publisher("/numbers", Header, queue_size=1000)
        talk = lambda _: publisher.publish(Header(frame_id=str(next(numbers))))  # noqa: E731
        heard = self.enter(Heard("/out", Header, parts))
        self.load(self.places[0])
        eventually(lambda: publisher.get_num_connections(), 10.0, "it listens")
        timer = rospy.Timer(rospy.Duration(0.01), talk)
        self.addCleanup(timer.join)
        self.addCleanup(timer.shutdown)
        source, target = self.places
        for _ in range(MOVES):
            heard.flows(20)
            self.move(source, target)
            source, target = target, source
        heard.flows(100)
        self.assertEqual(gaps([number for number, _ in heard]), [])
        self.assertEqual({process for _, process in heard}, {"/left", "/right"})

    def test_a_nodelet_stays_where_the_other_process_refuses_it(self):
        self.load(self.places[0])
        topics = self.step(self.places[0], HandOverRequest.NOTE)
        with self.assertRaises(HostError) as refused:
            topics[0].datatype = "nothing/Nothing"
            self.step(self.places[1], HandOverRequest.PARK, topics)
        self.assertIn("unknown there", str(refused.exception))
        self.assertEqual(self.places[0].list(), ["/moving"])


if __name__ == "__main__":
    run()
