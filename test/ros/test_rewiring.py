#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports that are re-wired, and nodelets that move to another process, while messages flow."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import re
import signal
import socket
import threading
import time
from unittest import mock

import graph  # first: it makes the test package known
import rospy
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import HandOver, HandOverRequest, SetConfig
from graph import (
    Heard,
    Manager,
    NodeletManagerCase,
    call,
    get_statistics,
    is_linked,
    peer,
    port_statistics,
    set_config,
)
from manager_suite import CHILD, ManagerCase, gaps, library, listed, specification
from processes import HELD_UP, TellingCase, becomes, eventually, run
from std_msgs.msg import Header

from dyknow.errors import HostError
from dyknow.model.graph import State
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

#: Seconds that a set_config waits for peers outside.
PATIENCE = 0.5
#: Steps of a topic that comes and goes at random; many in the long run.
STEPS = int(os.environ.get("DYKNOW_TEST_STEPS", 0))
SECOND = f"{CHILD}_2"
RATE = 50.0
#: Seconds of processor time for each message: a nodelet takes a quarter of a core.
WORK = 0.005
#: Moves of one nodelet back and forth.
MOVES = 6
#: Share of messages that are sent late.
HELD_BACK = 0.02
SPREAD = {"spread": "auto", "spread_load": 0.2}
BUSY = library(
    specification("busy", "dyknow_manager_test/Busy", ">in out>", work=WORK),
    specification("slow", "dyknow_manager_test/Busy", ">in out>", work=WORK, start=3.0),
    specification("relay", "dyknow_manager_test/Relay", ">in out>"),
)


def missing(numbers):
    """The missing numbers between the first and the last."""
    return set(range(min(numbers), max(numbers) + 1)) - set(numbers)


def heard(listener, topic="/[ab]"):
    """The numbers that a peer has heard on a topic."""
    return [int(number) for number in re.findall(rf"^{topic} (\d+)$", listener.output, re.M)]


class RewiringTest(NodeletManagerCase):
    def peer(self, *words):
        return self.run_process(*peer(*words))

    def move(self, **ports):
        """Connect ports of /n; returns how long (s) that took."""
        begin = time.monotonic()
        answer = set_config("/n", **ports)
        took = time.monotonic() - begin
        self.assertTrue(answer.success, answer.message)
        self.assertLess(took, HELD_UP)
        return took

    def goes_on(self, count=lambda: call("/n", "count")):
        """Wait for further messages, of /n or as a function counts them."""
        before = count()
        eventually(lambda: count() > before + 20, 10.0, "messages flow")

    def sent(self):
        return port_statistics("/n", "out").messages


class InPortTest(RewiringTest):
    def test_between_outside_publishers_it_loses_nothing(self):
        """Except by switches to a publisher that does not connect in time.

        Publishers may also greet a subscriber long before they send to it.
        """
        for words, switches in ((["talk"], 10), (["hesitate", "0.2"], 2)):
            with self.subTest(words):
                # The same number on both topics: a port connected to either one gets all.
                talker = self.peer(*words, "200", "/a", "/b")
                self.manager.load("Listener", "/n", {"/in": "/a"})
                self.goes_on()
                lost, in_time = set(), 0
                topics = itertools.cycle((("/a", "/b"), ("/b", "/a")))
                while in_time < 1 or switches > 0:
                    old, new = next(topics)
                    took = self.move(**{"in": new})
                    # The old one is gone when the call returns.
                    self.assertEqual(graph.nodes_on(old)[1], set())
                    self.goes_on()
                    lost, before = missing(call("/n", "received")), lost
                    if took < PATIENCE:
                        in_time += 1
                        self.assertEqual(lost - before, set(), f"by a switch of {took:.3f} s")
                    switches -= 1
                # A number may come on both topics, but on neither of them twice.
                story = call("/n", "story")
                for is_number, of_topic in itertools.groupby(
                    story, lambda event: isinstance(event, int)
                ):
                    numbers = list(of_topic)
                    if is_number:
                        self.assertEqual(numbers, sorted(set(numbers)))
                self.assertEqual(port_statistics("/n", "in").dropped, 0)
                self.manager.unload_all()
                talker.stop()
                talker.exit_code(20.0)

    def test_a_stopped_publisher_holds_up_set_config_for_half_a_second_at_most(self):
        self.manager.load("Listener", "/n", {"/in": "/b"})
        talker = self.peer("talk", "100", "/a")
        eventually(lambda: graph.nodes_on("/a")[0], 10.0, "it is registered")
        talker.stop(signal.SIGSTOP)
        self.move(**{"in": "/a"})
        talker.stop(signal.SIGCONT)
        self.goes_on()

    def test_a_publisher_that_is_killed_while_it_moves(self):
        self.peer("talk", "100", "/steady")
        self.manager.load("Listener", "/n")
        for _ in range(2):
            talker = self.peer("talk", "100", "/shaky")
            self.move(**{"in": "/shaky"})
            self.goes_on(lambda: call("/n", "senders").get("/shaky", 0))
            talker.stop(signal.SIGKILL)
            self.move(**{"in": "/steady"})
            self.move(**{"in": "/shaky"})
        self.move(**{"in": "/steady"})
        self.goes_on(lambda: call("/n", "senders").get("/steady", 0))

    def test_many_switches_under_load_with_an_outside_listener(self):
        for source in ("/a", "/b"):
            self.manager.load("Talker", f"/talker{source}", {"/talker/out": source})
        self.manager.load("Listener", "/n", {"/in": "/a"})
        listener = self.peer("listen", "/a")
        eventually(lambda: is_linked("/a", 2), 10.0, "one inside, one outside")
        for name in ("/talker/a", "/talker/b"):
            call(name, "start", 500.0)
        change = rospy.ServiceProxy("/n/set_config", SetConfig, persistent=True)
        for number in range(100):
            self.assertTrue(change([PortConfig("in", ("/b", "/a")[number % 2])]).success)
        change.close()
        call("/talker/b", "stop")
        listener.wait_for(f"/a {call('/talker/a', 'stop') - 1}\n")
        numbers = heard(listener)
        self.assertEqual(len(numbers), len(set(numbers)), "doubled outside")

        def switches():
            return sum(isinstance(event, list) for event in call("/n", "story"))

        becomes(switches, 100)
        self.assertGreater(len(call("/n", "story")), 100, "messages came between")
        statistics = get_statistics("/n")
        self.assertEqual((statistics.reconfigurations, statistics.callback_errors), (100, 0))
        self.assertEqual(port_statistics("/n", "in").dropped, 0)


class OutPortTest(RewiringTest):
    def talk(self, *listeners):
        """Let /n talk to peers that listen to /a and /b."""
        self.manager.load("Talker", "/n", {"/out": "/a"}, queue_size=10000)
        eventually(lambda: len(graph.nodes_on("/b")[1]) == len(listeners), 10.0, "they listen")
        eventually(lambda: is_linked("/a", len(listeners)), 10.0, "they are connected")
        call("/n", "start", 500.0)
        self.goes_on(self.sent)

    def all_is_heard(self, *listeners):
        """Stop; everything came once, and in order on each topic, which has a thread."""
        everything = list(range(call("/n", "stop")))
        for each in listeners:
            becomes(lambda each=each: sorted(heard(each)), everything)
            for topic in ("/a", "/b"):
                numbers = heard(each, topic)
                self.assertEqual(numbers, sorted(numbers))

    def test_between_topics_with_outside_listeners_it_loses_nothing(self):
        listeners = [self.peer("listen", "/a", "/b") for _ in range(2)]
        self.talk(*listeners)
        for topic in ("/b", "/a") * 5:
            self.move(out=topic)
            self.goes_on(self.sent)
        self.all_is_heard(*listeners)

    def test_a_subscriber_that_connects_late_misses_nothing(self):
        listener = self.peer("listen", "/a", "/b")
        self.talk(listener)
        listener.stop(signal.SIGSTOP)
        self.move(out="/b")
        self.goes_on(self.sent)
        self.assertNotIn("/b ", listener.output)
        listener.stop(signal.SIGCONT)
        listener.wait_for("/b ")
        self.all_is_heard(listener)
        # A subscriber that connects to a topic that is gone never connects again, so the old
        # one stays as long as a subscriber may still be connecting to it.
        becomes(lambda: graph.nodes_on("/a")[0], set(), 15.0)

    def watched(self):
        """A peer that is connected to images of /n on /a."""
        watcher = self.peer("watch", "/a")
        self.manager.load("ImageTalker", "/n", {"/out": "/a"})
        eventually(lambda: is_linked("/a"), 10.0, "connected")
        return watcher

    def test_large_messages_are_sent_before_the_old_topic_goes(self):
        watcher = self.watched()
        call("/n", "publish", 30, 4_000_000)
        self.move(out="/b")
        for number in range(30):
            watcher.wait_for(f"/a {number} 4000000\n")
        becomes(lambda: graph.nodes_on("/a")[0], set())

    def test_a_stopped_subscriber_holds_up_set_config_for_half_a_second_at_most(self):
        watcher = self.watched()
        watcher.stop(signal.SIGSTOP)
        call("/n", "publish", 20, 1_000_000)
        for topic in ("/b", "/a", ""):
            self.move(out=topic)


class ReadvertisedTest(RewiringTest):
    """A topic that is withdrawn and advertised again by one process reaches its subscribers.

    rospy's subscribers do not connect to an address to which they have a connection, and they do
    not connect again when that connection turns out to be closed.
    """

    def load(self):
        self.manager.load("Talker", "/n", {"/out": "/t"})

    def is_heard_by(self, peers):
        """Publish until each peer has heard something new."""
        first = next(self.numbers)

        def all_heard():
            call("/n", "publish", next(self.numbers), 1)
            return all(heard(each, "/t")[-1:] > [first] for each in peers)

        eventually(all_heard, 20.0, f"{first}", lambda: [each.output[-60:] for each in peers])

    def test_whatever_withdrew_it(self):
        self.numbers = itertools.count(1)
        seed = random.randrange(1000)
        print(f"seed {seed}")
        dice = random.Random(seed)
        # Peers sleep after each message, and notice no lost connection meanwhile.
        peers = [self.peer("doze", seconds, "/t") for seconds in ("0", "0.1", "0.7", "1.5")]
        self.load()
        self.is_heard_by(peers)
        for number in range(max(STEPS, 2)):
            for _ in range(3 if STEPS else 1):
                is_moved = dice.random() < 0.5 if STEPS else number == 0
                pause = dice.choice((0.0, 0.0, 0.05, 0.3, 1.0)) if STEPS else 0.0
                if is_moved:
                    self.move(out="")
                    time.sleep(pause)  # not a wait: intervals of any length
                    self.move(out="/t")
                else:
                    self.manager.unload("/n")
                    time.sleep(pause)
                    self.load()
            self.is_heard_by(peers)


def parts(message):
    number, process = message.frame_id.split()
    return int(number), process


class Paced:
    """Publishes headers, numbered from 1, and hardly any while few come back.

    However little processor time their receivers get, no queue overflows.
    """

    #: How many may be under way.
    MOST = 100

    def __init__(self, topic, heard, rate):
        self._publisher = rospy.Publisher(topic, Header, queue_size=10 * self.MOST)
        self._heard = heard
        self._number = 0
        self._period = 1.0 / rate
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *unused):
        self._ended.set()
        self._thread.join()
        self._publisher.unregister()

    def _run(self):
        while not self._ended.wait(self._period if self._is_followed() else 0.5):
            self._number += 1
            self._publisher.publish(Header(frame_id=str(self._number)))

    def _is_followed(self):
        slowest = min(each[-1][0] if each else -self.MOST for each in self._heard)
        return self._number - slowest < self.MOST


def everywhere():
    """The nodelets of both nodelet managers; none of one that is not up."""
    return sorted(name for each in (CHILD, SECOND) for name in listed(each) or ())


class SpreadTest(ManagerCase):
    def spread(self, label="busy", count=2, **parameters):
        """Start busy nodelets on one stream, which cannot move, in one nodelet manager."""
        manager = self.running(own=True, **SPREAD, **parameters)
        client = manager.client
        client.add_transformation(BUSY)
        config = {"in": "/paced", "out": "/numbers"}
        client.spawn("relay", "/counter", config=config, is_protected=True)
        self.heard = {}
        for number in range(count):
            name = f"/busy_{number}"
            config = {"in": "/numbers", "out": f"{name}/out"}
            client.spawn(label, name, config=config, manager=CHILD)
            self.heard[name] = self.enter(Heard(f"{name}/out", Header, parts))
        self.enter(Paced("/paced", [*self.heard.values()], RATE))
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
            heard.flows(50)
        for each in self.heard:
            self.is_whole(each)
        self.assertEqual(gaps([number for number, _ in passed]), [])
        self.assertIn(f"{name} is moved from {CHILD} to {SECOND}", manager.output)
        becomes(everywhere, sorted(["/counter", "/relay", *self.heard]))

    def moving(self):
        """Have a nodelet moved that takes long to load; returns its manager and its name."""
        manager = self.spread("slow", num_nodelet_managers=2)
        moving = f"it is being moved to {SECOND}"

        def found():
            nodelets = (manager.nodelet(name) for name in self.heard)
            return [each.name for each in nodelets if each.detail.startswith(moving)]

        eventually(found, 60.0, "one is being moved", lambda: manager.output[-3000:])
        (name,) = found()
        return manager, name

    def runs_once(self, manager, name):
        manager.becomes(name, State.RUNNING)
        self.heard[name].flows(50)
        numbers = [number for number, _ in self.heard[name]]
        self.assertEqual(numbers, sorted({*numbers}))
        becomes(everywhere, ["/busy_0", "/busy_1", "/counter"])

    def test_a_target_that_is_killed_in_the_middle_leaves_the_nodelet_once(self):
        manager, name = self.moving()
        manager.kill_child(SECOND, signal.SIGKILL)
        self.runs_once(manager, name)

    def test_a_manager_that_is_killed_in_the_middle_leaves_the_nodelet_once(self):
        manager, name = self.moving()
        manager.kill()
        manager.start()
        self.runs_once(manager, name)


class HandOverTest(TellingCase):
    """A nodelet between two nodelet managers, from one to the other and back."""

    @classmethod
    def setUpClass(cls):
        cls.places = [Manager(name) for name in ("/left", "/right")]
        for each in cls.places:
            cls.addClassCleanup(each.__exit__)

    def tearDown(self):
        for each in self.places:
            each.unload_all()

    def step(self, place, step, topics=()):
        service, beside = f"{place.name}/hand_over", f"{place.name}/list"
        client = ServiceClient(Master(rospy.get_name()), service, HandOver, beside=beside)
        return client.call(10.0, "/moving", step, topics).topics

    def load(self, place, work=0.001):
        wiring = {"/in": "/numbers", "/out": "/out"}
        place.load("dyknow_manager_test/Busy", "/moving", wiring, work=work)

    def noted(self, place):
        """Have the nodelet's messages noted, as soon as it is not far behind."""
        found = []

        def is_noted():
            with contextlib.suppress(HostError):
                found[:] = self.step(place, HandOverRequest.NOTE)
            return found

        eventually(is_noted, 20.0, "it is noted")
        return found

    def move(self, source, target):
        topics = self.noted(source)
        parked = self.step(target, HandOverRequest.PARK, topics)
        given = self.step(source, HandOverRequest.GIVE, parked)
        self.step(target, HandOverRequest.TAKE, given)
        self.load(target)
        self.step(target, HandOverRequest.END)

    def test_nothing_is_lost_or_doubled_however_often_it_moves(self):
        """Also of a publisher whose threads get no processor time now and then."""
        send = socket.socket.sendall

        def sendall(to, *what):
            if random.random() < HELD_BACK:
                time.sleep(random.uniform(0.0, 0.9))
            send(to, *what)

        self.enter(mock.patch.object(socket.socket, "sendall", sendall))
        heard = self.enter(Heard("/out", Header, parts))
        self.load(self.places[0])
        self.enter(Paced("/numbers", [heard], 100.0))
        source, target = self.places
        for _ in range(MOVES):
            heard.flows(20)
            self.move(source, target)
            source, target = target, source
        heard.flows(50)
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
    run(ReadvertisedTest if STEPS else "__main__")
