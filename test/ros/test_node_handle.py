#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""rospy's API, through the NodeHandles of nodelets in a real manager."""

from __future__ import annotations

import statistics
import threading

import graph  # first: it makes the test package known
import rospy
import rostest
from dyknow_test.puppet import Echo
from graph import NodeletManagerCase, call
from processes import BUSY, eventually
from rosgraph_msgs.msg import Log
from std_msgs.msg import Header


class HandleTest(NodeletManagerCase):
    def speak(self, topic):
        """A publisher that is connected to the manager."""
        publisher = rospy.Publisher(topic, Header, queue_size=1000)
        self.addCleanup(publisher.unregister)
        eventually(lambda: publisher.get_num_connections() == 1, 5.0, f"connected to {topic}")
        return publisher


class ParameterTest(HandleTest):
    def setUp(self):
        self.manager.load("Features", "/robot/n", answer=42)

    def test_private_ones_are_the_nodelets(self):
        self.assertEqual(call("/robot/n", "get_param", "~answer"), 42)
        call("/robot/n", "set_param", "~own", [1, 2])
        self.assertEqual(rospy.get_param("/robot/n/own"), [1, 2])
        call("/robot/n", "set_param", "shared", "x")
        self.assertEqual(rospy.get_param("/robot/shared"), "x")
        call("/robot/n", "set_param", "/top", 1.5)
        self.assertEqual(rospy.get_param("/top"), 1.5)
        self.assertTrue(call("/robot/n", "has_param", "~own"))
        call("/robot/n", "delete_param", "~own")
        self.assertFalse(call("/robot/n", "has_param", "~own"))
        self.assertFalse(rospy.has_param("/manager/own"))

    def test_arguments_by_keyword(self):
        answer = call("/robot/n", "params_by_keyword", "~own")
        self.assertEqual(answer, ["none", 3, True, "/robot/n/own", False])

    def test_names_of_any_characters(self):
        """Such as the paper's `config-path`; rospy takes them, so they are in use."""
        for name, key in (
            ("~config-path", "/robot/n/config-path"),
            ("a b/c.d", "/robot/a b/c.d"),
            ("/1st/x/", "/1st/x"),
            ("~über", "/robot/n/über"),
        ):
            with self.subTest(name):
                rospy.set_param(key, "set outside")
                self.assertEqual(call("/robot/n", "get_param", name), "set outside")
                call("/robot/n", "set_param", name, "set inside")
                self.assertEqual(rospy.get_param(key), "set inside")
                self.assertTrue(call("/robot/n", "has_param", name))
                found = call("/robot/n", "search_param", name.strip("~/"))
                self.assertEqual(found, rospy.resolve_name(key))
                call("/robot/n", "delete_param", name)
                self.assertFalse(rospy.has_param(key))

    def test_missing_ones(self):
        self.assertEqual(call("/robot/n", "get_param", "~missing", "default"), "default")
        self.assertIn("KeyError", call("/robot/n", "missing_param", "~missing"))

    def test_search_goes_upwards_from_the_nodelet(self):
        rospy.set_param("/level", "top")
        self.assertEqual(call("/robot/n", "search_param", "level"), "/level")
        rospy.set_param("/robot/level", "robot")
        self.assertEqual(call("/robot/n", "search_param", "level"), "/robot/level")
        rospy.set_param("/robot/n/level", "own")
        self.assertEqual(call("/robot/n", "search_param", "level"), "/robot/n/level")
        self.assertIsNone(call("/robot/n", "search_param", "nowhere"))

    def test_parameters_outlive_the_nodelet(self):
        call("/robot/n", "set_param", "~own", 1)
        self.manager.unload("/robot/n")
        self.assertEqual(rospy.get_param("/robot/n/answer"), 42)
        self.assertEqual(rospy.get_param("/robot/n/own"), 1)
        rospy.delete_param("/robot/n")


class MessageTest(HandleTest):
    def setUp(self):
        self.manager.load("Features", "/n", {"/in": "/wired"})

    def wait_and_publish(self, method, name, topic):
        publisher = rospy.Publisher(topic, Header, queue_size=10, latch=True)
        self.addCleanup(publisher.unregister)
        publisher.publish(Header(seq=31))
        self.assertEqual(call("/n", method, name, 5.0), 31)
        self.assertEqual(graph.nodes_on(topic)[1], set())

    def test_wait_for_message_at_a_port(self):
        self.wait_and_publish("wait_for_message", "in", "/wired")

    def test_wait_for_message_on_a_topic(self):
        self.wait_and_publish("wait_for_message_on_topic", "topic", "/topic")

    def test_wait_for_message_in_vain(self):
        answer = call("/n", "wait_for_message", "in", 0.2)
        self.assertIn("ROSException", answer)
        self.assertIn("0.2 s", answer)

    def test_an_unload_ends_the_wait(self):
        answers = []
        thread = threading.Thread(
            target=lambda: answers.append(call("/n", "wait_for_message", "in", 60.0))
        )
        thread.start()
        eventually(lambda: graph.nodes_on("/wired")[1], 5.0, "it waits")
        self.manager.unload("/n")
        thread.join(5.0 * BUSY)
        self.assertFalse(thread.is_alive())
        self.assertIn("unloaded", str(answers))


class ServiceTest(HandleTest):
    def test_one_nodelets_proxy_asks_the_others_service(self):
        self.manager.load("Features", "/n")
        self.manager.load("Strand", "/robot/server")
        self.assertEqual(call("/n", "echo_by_proxy", "robot/server/service", 5), 5)
        self.assertIn("timeout", call("/n", "missing_service", "/nowhere"))

    def test_an_unload_ends_the_wait_for_a_service(self):
        self.manager.load("Features", "/n")
        answers = []
        thread = threading.Thread(
            target=lambda: answers.append(call("/n", "wait_for_service", "/nowhere"))
        )
        thread.start()
        eventually(lambda: "/n waits for /nowhere" in self.manager.output, 5.0, "it waits")
        self.manager.unload("/n")
        thread.join(5.0 * BUSY)
        self.assertEqual(answers, ["service '/nowhere': nodelet /n was unloaded"])

    def test_a_service_ends_with_its_nodelet(self):
        self.manager.load("Strand", "/server")
        self.assertIn("/server/service", graph.services_of("/manager"))
        self.manager.unload("/server")
        self.assertNotIn("/server/service", graph.services_of("/manager"))


class StrandTest(HandleTest):
    def stir(self, calls=25):
        """Have both subscribers, the timer and the service called, many at a time."""
        for publisher in (self.speak("/a"), self.speak("/b")):
            for number in range(200):
                publisher.publish(Header(seq=number))
        call("/n", "start_timer", 0.002)
        self.callers = [threading.Thread(target=self.ask, args=(calls,)) for _ in range(3)]
        for caller in self.callers:
            caller.start()

    @staticmethod
    def ask(calls):
        service = rospy.ServiceProxy("/n/service", Echo)
        for number in range(calls):
            service(Header(seq=number))

    def wait_for_all(self):
        for caller in self.callers:
            caller.join(20.0 * BUSY)
            self.assertFalse(caller.is_alive())
        eventually(
            lambda: {**call("/n", "counts"), "timer": 0}
            == {"a": 200, "b": 200, "service": 75, "timer": 0}
            and call("/n", "counts")["timer"] > 20,
            10.0,
            "everything was called",
        )
        call("/n", "stop_timer")
        self.assertEqual(call("/n", "numbers", "a"), list(range(200)))
        self.assertEqual(call("/n", "numbers", "b"), list(range(200)))

    def test_callbacks_of_a_nodelet_never_overlap(self):
        self.manager.load("Strand", "/n")
        call("/n", "hold")
        self.stir()
        eventually(lambda: call("/n", "now_inside") == 1, 5.0, "one is held inside")
        call("/n", "let_go")
        for number in range(20):
            graph.set_config("/n", **{"in": f"/somewhere{number % 2}"})
        self.wait_for_all()
        self.assertEqual(call("/n", "most_inside"), 1)

    def test_those_of_a_concurrent_handle_do_and_each_topic_keeps_its_order(self):
        self.manager.load("Strand", "/n", concurrent=True)
        call("/n", "hold")
        self.stir()
        eventually(lambda: call("/n", "now_inside") >= 4, 5.0, "several are held inside")
        call("/n", "let_go")
        self.wait_for_all()


class TimerTest(HandleTest):
    def setUp(self):
        self.manager.load("Metronome", "/n")

    def test_its_period_and_its_events(self):
        call("/n", "start", 0.05)
        eventually(lambda: call("/n", "count") >= 20, 5.0, "twenty calls")
        events = call("/n", "events")
        call("/n", "stop")
        self.assertGreater((events[19][1] - events[0][1]) / 19, 0.04)
        self.assertIsNone(events[0][2])
        for before, (_, _, last, duration) in zip(events, events[1:]):
            self.assertEqual(last, before[1])
            self.assertGreaterEqual(duration, 0.0)
        due = [event[0] for event in events]
        pauses = [later - earlier for earlier, later in zip(due, due[1:])]
        self.assertAlmostEqual(statistics.median(pauses), 0.05, delta=0.01)

    def test_one_shot(self):
        call("/n", "start_once", 0.02)
        call("/n", "start", 0.02)
        eventually(lambda: call("/n", "count") >= 10, 5.0, "ten calls of the other")
        self.assertEqual(call("/n", "count_shots"), 1)

    def test_it_ends_with_its_nodelet_or_before(self):
        call("/n", "start", 0.01)
        eventually(lambda: call("/n", "count") > 3, 5.0, "it ticks")
        call("/n", "stop")
        count = call("/n", "count")
        call("/n", "start_once", 0.1)
        eventually(lambda: call("/n", "count_shots") == 1, 5.0, "time has passed")
        self.assertLessEqual(call("/n", "count"), count + 1)  # one may have run just then
        call("/n", "start", 0.01)
        self.manager.unload("/n")
        self.manager.load("Metronome", "/other")
        call("/other", "start_once", 0.1)
        eventually(lambda: call("/other", "count_shots") == 1, 5.0, "time has passed")
        self.assertNotIn("Traceback", self.manager.output)

    def test_rate_and_sleep(self):
        self.manager.load("Features", "/features")
        took = call("/features", "rate", 50.0, 10)
        self.assertGreater(took, 0.15)
        self.assertLess(took, 0.2 * BUSY)
        self.assertGreaterEqual(call("/features", "sleep", 0.05), 0.05)


class LogTest(HandleTest):
    def test_throttle_and_once_count_for_each_place_in_the_code(self):
        lines = []
        subscriber = rospy.Subscriber("/rosout", Log, lines.append)
        self.addCleanup(subscriber.unregister)
        self.manager.load("Features", "/robot/n")
        eventually(lambda: any(line.name == "/manager" for line in lines), 5.0, "it is heard")
        call("/robot/n", "log_often")
        eventually(lambda: any("plainly logged" in line.msg for line in lines), 5.0, "logged")
        logged = [line.msg for line in lines if line.level >= Log.WARN]
        self.assertEqual(
            logged,
            [
                "once here 0",
                "once there 0",
                "seldom here 0",
                "seldom there 0",
                "the same",
                "plainly logged",
            ],
        )
        # The logged position is in the nodelet's code, not in DyKnow's.
        plainly = next(line for line in lines if "plainly" in line.msg)
        self.assertEqual(plainly.function, "Features.log_often")
        self.assertRegex(plainly.file, "features.py$")
        self.assertIn("plainly logged", self.manager.output)


class LifeTest(HandleTest):
    def test_hooks_are_called_at_the_unload(self):
        self.manager.load("Features", "/n")
        call("/n", "log_at_the_end")
        self.manager.unload("/n")
        eventually(lambda: "/n: the hook is called" in self.manager.output, 2.0, "it is called")
        self.assertEqual(self.manager.output.count("/n: the hook is called"), 1)

    def test_what_a_nodelet_must_not_do_is_explained(self):
        self.manager.load("Features", "/n")
        for name in ("init_node", "spin", "nothing_of_this_kind"):
            self.assertRegex(call("/n", "refused", name), f"no '{name}': .+")


if __name__ == "__main__":
    rospy.init_node("node_handle_test")
    rostest.rosrun("dyknow", "node_handle", "__main__")
