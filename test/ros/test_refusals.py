#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bad input is refused with a text that names the mistake, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import threading

import graph  # first: it makes the test packages known
import rospy
import rostest
from dyknow_test.puppet import Echo
from graph import NodeletManagerCase, call, registrations, set_config, set_config_pairs
from processes import BUSY, NODELET, Running, eventually
from std_msgs.msg import Header, String


class Refusals(NodeletManagerCase):
    def setUp(self):
        self.before = registrations("/manager"), graph.parameters()

    def assert_untouched(self):
        self.assertEqual((registrations("/manager"), graph.parameters()), self.before)

    def assert_refused(self, *texts, **request):
        """Check that a load is refused, with all the texts in the answer and in the log."""
        with self.assertRaises(rospy.ServiceException) as caught:
            self.manager.load_nodelet(**request)
        self.assert_told(str(caught.exception), texts)
        self.assert_untouched()

    def assert_told(self, answer, texts):
        for text in texts:
            self.assertIn(text, answer.replace("\\'", "'"))
            eventually(lambda text=text: text in self.manager.output, 2.0, f"'{text}' is logged")


class LoadTest(Refusals):
    def test_bad_requests(self):
        def request(name="/n", type_name="dyknow_test/Talker", remappings=()):
            return {
                "name": name,
                "type": type_name,
                "remap_source_args": [source for source, _ in remappings],
                "remap_target_args": [target for _, target in remappings if target is not None],
            }

        for type_name in ("dyknow_test/Nothing", "nowhere/Talker", "Talker", "", "os.path"):
            texts = f"'{type_name}'", "declared types", "dyknow_test/Talker"
            self.assert_refused(*texts, **request("/n", type_name))
        broken = "dyknow_test_broken/Broken"
        self.assert_refused(broken, "nodelets.xml", "not well-formed", **request("/n", broken))
        for type_name, text in {
            "Unimportable": "RuntimeError: this module needs a camera",
            "Missing": "has no class 'Missing'",
            "NoNodelet": "does not derive from dyknow.Nodelet",
        }.items():
            type_name = f"dyknow_test/{type_name}"
            self.assert_refused(type_name, text, "nodelets.xml", **request("/n", type_name))
        for name in ("", "1st", "a b", "/a//b", "/", "~", "/a-b"):
            self.assert_refused(f"'{name}'", "not a valid nodelet name", **request(name))
        unpaired = request(remappings=[("out", "/a"), ("in", None)])
        texts = "/n", "2 remap_source_args but 1 remap_target_args", "one target for each source"
        self.assert_refused(*texts, **unpaired)
        for source, target, wrong in (
            ("out", "no name", "no name"),
            ("1st", "/a", "1st"),
            ("", "/a", ""),
            ("out", "", ""),
        ):
            bad = request(remappings=[(source, target)])
            self.assert_refused(f"'{wrong}'", "not a valid remap", **bad)
        self.manager.load("Talker", "/n")  # nothing of that hides it

    def test_a_name_that_is_taken(self):
        self.manager.load("Talker", "/n", {"/out": "/topic"})
        self.before = registrations("/manager"), graph.parameters()
        for name in ("/n", "n"):
            self.assert_refused("/n", "already loaded", name=name, type="dyknow_test/Listener")
        self.assertEqual(self.manager.list(), ["/n"])
        self.assertEqual(call("/n", "connections"), 0)

    def test_on_init_that_raises(self):
        for type_name, text in {
            "FailsInInit": "ValueError: the camera is not plugged in",
            "ExitsInInit": "SystemExit: enough",
        }.items():
            self.assert_refused(
                "/n",
                text,
                name="/n",
                type=f"dyknow_test/{type_name}",
                remap_source_args=["in", "out"],
                remap_target_args=["/a", "/b"],
            )
            self.assertIn("Traceback", self.manager.output)
            self.assertIn(
                "in register_much" if "exit" in text else "in on_init", self.manager.output
            )
            self.assertEqual(self.manager.list(), [])
        self.manager.load("Talker", "/n")

    def test_parameters_outlive_a_failed_load(self):
        rospy.set_param("/n/gain", 3)
        self.before = registrations("/manager"), graph.parameters()
        self.assert_refused("/n", name="/n", type="dyknow_test/FailsInInit")
        self.assertEqual(rospy.get_param("/n/gain"), 3)
        rospy.delete_param("/n")

    @contextlib.contextmanager
    def waiting_client(self):
        """A client that loads /n, whose on_init waits for the parameter /go_on."""
        rospy.set_param("/go_on", False)
        self.before = registrations("/manager"), graph.parameters()
        words = ("load", "dyknow_test/WaitsInInit", "manager", "--no-bond", "__name:=n")
        with Running(*NODELET, *words) as client:
            begun = "on_init has begun"
            eventually(lambda: "/n/get_config" in graph.services_of("/manager"), 10.0, begun)
            yield client

    def test_unloaded_in_the_middle_of_on_init(self):
        with self.waiting_client() as client:
            self.assertEqual(self.manager.list(), [])
            self.manager.unload("/n")
            self.assertEqual(client.exit_code(20.0), 255)
            self.assertIn("unloaded during its load", client.output)
        self.manager.load("Talker", "/n")
        self.manager.unload("/n")
        self.assert_untouched()
        rospy.set_param("/go_on", True)
        eventually(lambda: "/n: on_init is through" in self.manager.output, 5.0, "it goes on")
        rospy.set_param("/go_on", False)
        self.assert_untouched()

    def test_two_loads_of_one_name_at_once(self):
        with self.waiting_client() as client:
            with self.assertRaises(rospy.ServiceException) as caught:
                self.manager.load("Talker", "/n")
            self.assertIn("being loaded", str(caught.exception))
            rospy.set_param("/go_on", True)
            eventually(lambda: self.manager.list() == ["/n"], 5.0, "the first one has won")
            client.stop()
            client.exit_code(20.0)

    def test_unload_of_a_stranger(self):
        self.manager.load("Talker", "/n")
        self.before = registrations("/manager"), graph.parameters()
        for name in ("/stranger", "", "not a name"):
            with self.subTest(name), self.assertRaises(rospy.ServiceException) as caught:
                self.manager.unload(name)
            self.assert_told(str(caught.exception), [f"'{name}'"])
            self.assert_untouched()
        with self.assertRaises(rospy.ServiceException) as caught:
            self.manager.unload("/stranger")
        self.assert_told(str(caught.exception), ["no nodelet named '/stranger'", "loaded: /n"])


class SetConfigTest(Refusals):
    def setUp(self):
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        super().setUp()

    def assert_config_refused(self, answer, *texts):
        self.assertFalse(answer.success)
        self.assert_told(answer.message, texts)
        self.assertEqual(graph.topics_of_ports("/n"), {"in": "/a", "out": "/b"})
        self.assertEqual(graph.get_statistics("/n").reconfigurations, 0)
        self.assert_untouched()

    def test_bad_requests(self):
        for pairs, texts in (
            ([("out", "/x"), ("lens", "/y")], ["unknown port 'lens'", "known ports: in, out"]),
            ([("in", "/x"), ("out", "/y"), ("in", "/z")], ["port 'in' is named twice or more"]),
            *(
                (
                    [("in", "/x"), ("out", name)],
                    [f"'{name}' is not a valid topic name", "expected"],
                )
                for name in ("1st", "a b", "/a//b", "~", "/", "/a-b")
            ),
            (
                [("lens", "/x"), ("in", "a b"), ("in", "/y")],
                ["unknown port 'lens'", "'a b' is not a valid", "named twice or more"],
            ),
        ):
            with self.subTest(pairs):
                self.assert_config_refused(set_config_pairs("/n", *pairs), *texts)

    def test_a_topic_that_is_live_outside_with_another_type(self):
        publisher = rospy.Publisher("/outside", String, queue_size=1)
        eventually(lambda: graph.nodes_on("/outside")[0], 2.0, "it is registered")
        self.assert_config_refused(
            set_config("/n", **{"in": "/outside"}),
            "'/outside' carries std_msgs/String",
            "std_msgs/Header (port 'in')",
        )
        publisher.unregister()
        subscriber = rospy.Subscriber("/outside", String)
        self.assert_config_refused(
            set_config("/n", out="/outside"), "'/outside' carries std_msgs/String"
        )
        subscriber.unregister()
        eventually(lambda: not any(graph.nodes_on("/outside")), 2.0, "nobody is there any more")
        # The master remembers the type, but the topic has no publisher or subscriber.
        answer = set_config("/n", **{"in": "/outside"})
        self.assertTrue(answer.success, answer.message)

    def test_a_topic_of_this_process_with_another_type(self):
        self.manager.load("Stamper", "/images", {"/out": "/image"})
        self.before = registrations("/manager"), graph.parameters()
        self.assert_config_refused(
            set_config("/n", **{"in": "/image"}), "'/image' carries sensor_msgs/Image"
        )

    def test_the_services_of_an_unloaded_nodelet_are_gone(self):
        proxy = rospy.ServiceProxy("/n/get_config", graph.GetConfig, persistent=True)
        proxy()
        self.manager.unload("/n")
        with self.assertRaises(rospy.ServiceException):
            proxy()
        self.assertFalse([name for name in graph.services_of("/manager") if "/n/" in name])


class CallbackTest(NodeletManagerCase):
    """An error in a callback stays there."""

    def setUp(self):
        self.speaker = rospy.Publisher("/orders", Header, queue_size=100)
        self.load_fragile("/n", "/neighbour", "/other")

    def tearDown(self):
        for name in self.manager.list():
            if f"{name}/obey" in graph.services_of("/manager"):
                call(name, "wake")
        super().tearDown()
        self.speaker.unregister()

    def load_fragile(self, *names):
        """Load Fragile nodelets that listen to /orders."""
        for name in names:
            self.manager.load("Fragile", name, {"/in": "/orders"})
        eventually(lambda: self.speaker.get_num_connections() == 1, 5.0, "they listen")

    def order(self, number, order=""):
        self.speaker.publish(Header(seq=number, frame_id=order))

    def wait_for_numbers(self, numbers, name):
        eventually(lambda: call(name, "received") == numbers, 5.0, f"{name} hears {numbers}")

    def assert_lives(self, name, number):
        set_config(name, **{"in": "/orders"})
        self.order(number)
        eventually(lambda: number in call(name, "received"), 5.0, f"{name} hears {number}")

    def test_a_callback_that_raises(self):
        self.manager.load("Listener", "/bystander", {"/in": "/orders"})
        for number, order in enumerate(("raise", "exit", "", "raise", "")):
            self.order(number, order)
        for name in ("/n", "/neighbour", "/bystander"):
            self.wait_for_numbers([0, 1, 2, 3, 4], name)
        self.manager.unload("/bystander")
        for name in ("/n", "/neighbour"):
            self.assertEqual(graph.get_statistics(name).callback_errors, 3)
            self.assertEqual(graph.port_statistics(name, "in").messages, 5)
        eventually(
            lambda: all(
                text in self.manager.output
                for text in (
                    "/n: the callback of 'in' raised",
                    "RuntimeError: fragile at 0",
                    "RuntimeError: fragile at 3",
                    "SystemExit: 3",
                    "in obey",
                )
            ),
            2.0,
            "the tracebacks are in the log",
        )

    def test_a_service_handler_that_raises_or_exits(self):
        service = rospy.ServiceProxy("/n/obey", Echo)
        for number, order in enumerate(("raise", "exit")):
            request = Header(seq=number, frame_id=order)
            with self.assertRaises(rospy.ServiceException) as caught:
                within(5.0, lambda request=request: service(request))
            self.assertIn(("fragile at 0", "SystemExit")[number], str(caught.exception))
        self.assertEqual(service(Header(seq=7)).seq, 7)
        self.assertEqual(graph.get_statistics("/n").callback_errors, 2)
        for text in ("the handler of service /n/obey raised: fragile at 0", "in obey"):
            eventually(lambda text=text: text in self.manager.output, 2.0, f"'{text}' is logged")

    def test_a_reconfigure_callback_that_raises(self):
        answer = set_config("/n", out="/please/raise")
        self.assertTrue(answer.success, answer.message)
        eventually(lambda: graph.get_statistics("/n").callback_errors == 1, 2.0, "it is counted")
        self.assertEqual(graph.topics_of_ports("/n")["out"], "/please/raise")
        self.assertIn("fragile at its reconfiguration", self.manager.output)
        self.assert_lives("/n", 1)

    def test_all_workers_held_by_callbacks_that_do_not_return(self):
        self.load_fragile("/third", "/fourth", "/fifth")
        self.order(1, "hang")
        held = ("/n", "/neighbour", "/other", "/third", "/fourth", "/fifth")
        for name in held:
            self.wait_for_numbers([1], name)
        self.manager.load("Relay", "/relay", {"/in": "/source", "/out": "/sink"})
        heard = []
        listener = rospy.Subscriber("/sink", Header, lambda message: heard.append(message.seq))
        speaker = rospy.Publisher("/source", Header, queue_size=100)
        probe = 1000  # rospy counts connections before their handshake: only a message is proof

        def arrives():
            speaker.publish(Header(seq=probe))
            return heard

        eventually(arrives, 10.0, "wired")
        for number in range(100):
            speaker.publish(Header(seq=number))
        eventually(
            lambda: [number for number in heard if number != probe] == list(range(100)),
            10.0,
            "the others go on",
        )
        eventually(
            lambda: all(
                f"{name}: a callback has not returned" in self.manager.output for name in held
            ),
            5.0,
            "it is reported",
        )
        self.assertIn("in pass_through", self.manager.output)
        # They can still be re-wired and unloaded.
        self.assertTrue(
            set_config("/third", **{"in": "/elsewhere", "out": "/elsewhere_too"}).success
        )
        call("/third", "wake")
        within(2.0, lambda: self.manager.unload("/n"))
        self.assertFalse([name for name in graph.services_of("/manager") if "/n/" in name])
        self.load_fragile("/n")
        self.assert_lives("/n", 5)
        listener.unregister()
        speaker.unregister()

    def test_unloaded_in_the_middle_of_a_callback(self):
        set_config("/n", out="/late")
        heard = []
        listener = rospy.Subscriber("/late", Header, lambda message: heard.append(message.seq))
        eventually(lambda: listener.get_num_connections() == 1, 5.0, "wired")
        self.order(1, "hang")
        for number in range(2, 6):
            self.order(number)
        eventually(lambda: call("/n", "received") == [1], 5.0, "it hangs")
        waker = rospy.ServiceProxy("/n/call", graph.Call, persistent=True)
        waker.wait_for_service(2.0 * BUSY)
        waker(String('["received", []]'))
        within(2.0, lambda: self.manager.unload("/n"))
        self.assertEqual(graph.nodes_on("/late")[0], set())
        waker(String('["wake", []]'))
        waker.close()
        eventually(
            lambda: "/n: woken" in self.manager.output
            and "the callback that ran at the unload has ended" in self.manager.output,
            5.0,
            "its end is noted",
        )
        self.assertIn("publisher 'out' of /n is closed", self.manager.output)
        self.assertEqual(heard, [])
        listener.unregister()

    def test_a_callback_that_unloads_its_own_nodelet(self):
        names = ("/n", "/neighbour", "/other")
        before = [self.manager.output.count(f"{name}: shut down for the") for name in names]
        self.order(1, "unload")
        eventually(
            lambda: not [
                name for name in graph.services_of("/manager") if not name.startswith("/manager/")
            ],
            5.0,
            "they are gone",
        )
        self.assertEqual(self.manager.list(), [])
        after = [self.manager.output.count(f"{name}: shut down for the") for name in names]
        self.assertEqual(after, [count + 1 for count in before])
        for name in names:  # each name is free as soon as its unload is done
            eventually(lambda name=name: self.manager.is_free(name), 2.0, f"{name} is free")

    def test_unloaded_in_the_middle_of_a_service_call(self):
        caught = []

        def ask():
            try:
                rospy.ServiceProxy("/n/obey", Echo)(Header(seq=1, frame_id="hang"))
            except rospy.ServiceException as error:
                caught.append(str(error))

        asking = threading.Thread(target=ask)
        asking.start()
        eventually(lambda: call("/n", "received") == [1], 5.0, "it hangs")
        within(2.0, lambda: self.manager.unload("/n"))
        asking.join(2.0 * BUSY)
        self.assertFalse(asking.is_alive(), "the caller is told")
        self.assertEqual(len(caught), 1)


def within(seconds, function):
    """Call a function on a thread of its own; its result, or AssertionError if it is late."""
    outcome = []

    def run():
        try:
            outcome.append((function(), None))
        except Exception as error:
            outcome.append((None, error))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds * BUSY)
    if not outcome:
        raise AssertionError(f"not within {seconds:g} s")
    result, error = outcome[0]
    if error is not None:
        raise error
    return result


if __name__ == "__main__":
    rospy.init_node("refusals_test")
    rospy.set_param("/manager/stuck_after", 1.0)
    rospy.set_param("/manager/num_worker_threads", 4)
    rostest.rosrun("dyknow", "refusals", "__main__")
