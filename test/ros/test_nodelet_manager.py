#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet manager and its clients, each a real process: names, bonds, launch files."""

from __future__ import annotations

import contextlib
import signal
import socket
import tempfile
import threading
import time
import xmlrpc.client

import graph  # first: it makes the test package known
import rosgraph
import rospy
import test_nodelet_command
from dyknow_msgs.msg import NodeletChanges
from dyknow_test.puppet import Echo
from graph import Heard, Manager, NodeletManagerCase, call, refusal, registrations, set_config
from nodelet.srv import NodeletList, NodeletLoad, NodeletUnload
from processes import BUSY, NODELET, STOCK_NODELET, TellingCase, becomes, eventually, nodes, run
from roslib.packages import find_node
from std_msgs.msg import Header, String
from test_nodelet_command import CommandCase

from dyknow.errors import HostError, PeerTimeout
from dyknow.ros.nodelets.announcements import TOPIC
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

#: rospy's message about a connection to a topic that the process does not publish.
REFUSED = "Could not process inbound connection"
#: Python's messages about a SIGINT before it runs a program.
TOO_EARLY = ("Fatal Python error: init", "Could not import runpy module", "KeyboardInterrupt")
#: Its message about a SIGINT that it drops then.
LOST = "Exception ignored in"


def stop_again_if_python_dropped_it(process):
    eventually(lambda: process.has_ended or LOST in process.output, 20.0, f"{process.pid} ends")
    if not process.has_ended:
        process.stop()


class StartTest(CommandCase):
    def test_every_command_that_starts_one_and_the_number_of_its_threads(self):
        rospy.set_param("/eleven/num_worker_threads", 11)
        rospy.set_param("/five/num_worker_threads", 5)
        eleven = self.enter(Manager("/eleven", command=("rosrun", "dyknow", "nodelet", "manager")))
        # Everything is in the page cache for the second one, as on a machine that runs.
        begin = time.monotonic()
        five = self.enter(Manager("/five", command=("rosrun", "dyknow", "nodelet_manager")))
        self.assertLess(time.monotonic() - begin, 2 * BUSY)
        becomes(lambda: eleven.threads() - five.threads(), 6)
        self.assertIn("Initializing nodelet with 11 worker threads.", eleven.output)
        for process in (eleven, five):
            process.stop()
            self.ends(process)
        self.assertFalse({"/eleven", "/five"} & nodes())

    def test_a_parameter_without_sense_ends_it_and_does_not_outlive_its_command_line(self):
        program = find_node("dyknow", "nodelet_manager")
        output = self.does(*program, "_stuck_after:=soon", code=255)
        self.assertIn("parameter '~stuck_after' is 'soon'", output)
        self.assertNotIn("Traceback", output)
        self.assertFalse(rospy.has_param("/manager/stuck_after"))

    def test_sigint_at_any_moment_of_the_start(self):
        for tenth in (1, 2, 4):
            process = self.enter(Manager("/hasty", wait=False))
            if not process.ends_within(tenth / 10):
                process.stop()
            stop_again_if_python_dropped_it(process)
            code = process.exit_code(20.0)
            is_too_early = any(each in process.output for each in TOO_EARLY)
            expected = (0, 130, -signal.SIGINT, 1 if is_too_early else 0)
            self.assertIn(code, expected, process.output)
            self.assertNotIn("/hasty", nodes())

    def test_signals_end_the_wait_for_a_master(self):
        for number, words in (
            (signal.SIGINT, ["manager"]),
            (signal.SIGTERM, ["standalone", "dyknow/Source"]),
        ):
            nowhere = ["env", "ROS_MASTER_URI=http://127.0.0.1:1"]
            process = self.run_process(*nowhere, *NODELET, *words)
            process.wait_for("master may not be running yet")
            process.stop(number)
            self.ends(process, 130)
            self.assertNotIn("Traceback", process.output)


class RobotCase(CommandCase, NodeletManagerCase):
    manager_name = "/robot/manager"


class ServiceTest(RobotCase):
    def test_names_and_lists(self):
        for _ in range(3):  # a name can be loaded again at once
            self.manager.load("Talker", "~b", {"manager/out": "/topic"})
            self.manager.load("Introspector", "a", {"~other": "there"}, ["--fast", "a b"])
            self.assertEqual(self.manager.list(), ["/robot/a", "/robot/manager/b"])
            self.assertEqual(call("/robot/a", "describe")["argv"], ["--fast", "a b"])
            self.assertEqual(call("/robot/a", "resolve", "~other"), "/robot/there")
            self.assertEqual(graph.nodes_on("/topic")[0], {"/robot/manager"})
            for name in self.manager.list():
                self.assertTrue(self.manager.unload(name).success)
            self.assertEqual(self.manager.list(), [])
            self.assertFalse(any(graph.nodes_on("/topic")))

    def test_changes_and_newcomers_are_announced(self):
        def listen():
            return Heard(TOPIC, NodeletChanges, graph.named)

        with listen() as heard:
            for change in (
                lambda: self.manager.load("Listener", "/b"),
                lambda: set_config("/b", **{"in": "/topic"}),
                lambda: self.manager.unload("/b"),
            ):
                del heard[:]
                change()
                heard.has(lambda names: "/b" in names)
        for name in ("/b", "/a"):
            self.manager.load("Listener", name)
        with listen() as heard:
            heard.has(lambda names: names == ["/a", "/b"])

    def test_it_publishes_nothing_of_a_type_that_nodelets_use(self):
        """Programs may search for a nodelet's topics by type."""
        published = registrations("/robot/manager")["publishers"]
        types = dict(rosgraph.Master(rospy.get_name()).getTopicTypes())
        self.assertEqual(types[TOPIC], "dyknow_msgs/NodeletChanges")
        own = {"rosgraph_msgs/Log", "bond/Status", "dyknow_msgs/NodeletChanges"}
        self.assertLessEqual({types[topic] for topic in published}, own)


class RefusalTest(RobotCase):
    """A refusal is a failed service call that names the mistake; nothing is left behind."""

    def tearDown(self):
        super().tearDown()
        graph.forget("/n")

    def refused(self, *texts, kind="dyknow_test/Talker", name="/n", **request):
        """A load is refused, with all the texts in the answer and in the log."""
        before = graph.registered("/robot/manager"), graph.parameters()
        with self.assertRaises(rospy.ServiceException) as caught:
            self.manager.load_nodelet(name=name, type=kind, **request)
        for text in texts:
            self.assertIn(text, str(caught.exception).replace("\\'", "'"))
            self.manager.wait_for(text)
        becomes(lambda: (graph.registered("/robot/manager"), graph.parameters()), before)

    def test_loads(self):
        rospy.set_param("/n/gain", 3)  # outlives all of it
        for kind, name, *texts in (
            ("dyknow_test/Nothing", "/n", "'dyknow_test/Nothing'", "declared types"),
            ("os.path", "/n", "'os.path'", "dyknow_test/Talker"),
            ("dyknow_test_broken/Broken", "/n", "nodelets.xml", "not well-formed"),
            ("dyknow_test/Unimportable", "/n", "RuntimeError: this module needs a camera"),
            ("dyknow_test/Missing", "/n", "has no class 'Missing'", "nodelets.xml"),
            ("dyknow_test/NoNodelet", "/n", "does not derive from dyknow.Nodelet"),
            ("dyknow_test/Talker", "/a//b", "'/a//b'", "not a valid nodelet name"),
            ("dyknow_test/FailsInInit", "/n", "ValueError: the camera is not plugged in"),
            ("dyknow_test/ExitsInInit", "/n", "SystemExit: enough"),
        ):
            with self.subTest(kind, name=name):
                remap = {"remap_source_args": ["in", "out"], "remap_target_args": ["/a", "/b"]}
                self.refused(*texts, name=name, kind=kind, **remap)
        self.assertIn("in on_init", self.manager.output)  # a traceback
        unpaired = {"remap_source_args": ["out", "in"], "remap_target_args": ["/a"]}
        self.refused("2 remap_source_args but 1 remap_target_args", **unpaired)
        self.assertEqual(self.manager.list(), [])
        self.manager.load("Talker", "/n")  # nothing of that hides it
        self.refused("already loaded", kind="dyknow_test/Listener")
        self.assertEqual(rospy.get_param("/n/gain"), 3)

    def test_types_of_topics_that_are_live_outside(self):
        """The master remembers the types of topics without publishers and subscribers."""
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        for make, port, role in (
            (lambda: rospy.Publisher("/outside", String, queue_size=1), "in", 0),
            (lambda: rospy.Subscriber("/outside", String), "out", 1),
        ):
            other = make()
            eventually(lambda role=role: graph.nodes_on("/outside")[role], 5.0, "registered")
            self.assertIn("'/outside' carries std_msgs/String", refusal("/n", port, "/outside"))
            self.assertEqual(graph.topics_of_ports("/n"), {"in": "/a", "out": "/b"})
            other.unregister()
        becomes(lambda: graph.nodes_on("/outside"), (set(), set()))
        answer = set_config("/n", **{"in": "/outside"})
        self.assertTrue(answer.success, answer.message)

    def test_service_handlers(self):
        """rospy's caller gets an answer even if the handler fails, or its nodelet is unloaded."""
        self.manager.load("Fragile", "/n")
        service = rospy.ServiceProxy("/n/obey", Echo)
        for number, (order, said) in enumerate(
            (("raise", "fragile at 0"), ("exit", "SystemExit"))
        ):
            with self.assertRaisesRegex(rospy.ServiceException, said):
                service(Header(seq=number, frame_id=order))
        self.assertEqual(service(Header(seq=7)).seq, 7)
        becomes(lambda: graph.get_statistics("/n").callback_errors, 2)

        def hang():
            with self.assertRaises(rospy.ServiceException):
                service(Header(seq=8, frame_id="hang"))
            answered.set()

        answered = threading.Event()
        threading.Thread(target=hang, daemon=True).start()
        becomes(lambda: call("/n", "received")[-1:], [8])
        config = rospy.ServiceProxy("/n/get_config", graph.GetConfig, persistent=True)
        config()
        self.manager.unload("/n")
        self.assertTrue(answered.wait(5.0 * BUSY), "the caller is answered")

        def is_answered():
            with contextlib.suppress(rospy.ServiceException):
                return bool(config())
            return False

        becomes(is_answered, False)


class ProcessRemappingTest(TellingCase):
    def test_the_requests_remappings_come_first_then_the_processes(self):
        manager = self.enter(Manager("/manager", "topic:=/by_process", "other:=/by_process_too"))
        manager.load("Introspector", "/n", {"topic": "/by_request"})
        for name, topic in (("topic", "/by_request"), ("other", "/by_process_too")):
            self.assertEqual(call("/n", "resolve", name), topic)
            self.assertEqual(call("/n", "publish_plain", name), topic)
        self.assertEqual(graph.nodes_on("/by_process_too")[0], {"/manager"})


class EndTest(TellingCase):
    def managed(self, *names):
        """A nodelet manager, and a client of nodelet_core for each nodelet."""
        manager = self.enter(Manager("/ending"))
        words = (*STOCK_NODELET, "load", "dyknow_test/Relay", "ending")
        clients = [self.run_process(*words, f"__name:={name}") for name in names]
        becomes(lambda: len(manager.list()), len(names))
        return manager, *clients

    def test_an_end_of_manager_and_clients_at_once_is_silent(self):
        def is_silent():
            processes = self.managed("a", "b")
            for process in processes:
                process.stop()
            for process in processes:
                process.exit_code(20.0)
            texts = ("Couldn't find service", REFUSED)
            return not any(text in process.output for text in texts for process in processes)

        # On a busy machine a client may come later than the manager waits for it, 0.5 s.
        self.assertTrue(any(is_silent() for _ in range(5)))

    def test_who_connects_to_what_has_ended_already_is_not_told_of_at_the_end(self):
        manager, client = self.managed("relay")
        api = rosgraph.Master(rospy.get_name()).lookupNode("/ending")
        _, host, port = xmlrpc.client.ServerProxy(api).requestTopic(
            rospy.get_name(), "/rosout", [["TCPROS"]]
        )[2]

        def connect(topic):
            fields = {"topic": topic, "md5sum": "*", "type": "*", "callerid": rospy.get_name()}
            with socket.create_connection((host, port), 5.0 * BUSY) as connection:
                rosgraph.network.write_ros_handshake_header(connection, fields)
                connection.recv(1)  # the answer: it is refused

        connect("/nowhere")
        manager.wait_for(REFUSED)
        client.stop(signal.SIGSTOP)  # so that the manager waits for it at its end
        manager.stop()
        becomes(manager.lists, False)
        with contextlib.suppress(ConnectionError):  # on a busy machine it has ended by now
            connect("/nowhere_either")
        manager.exit_code(20.0)
        self.assertNotIn("/nowhere_either", manager.output)


class ClientTest(test_nodelet_command.ClientTest):
    """DyKnow's client with its manager; those of both kinds run in the long run."""

    clients = {"own": NODELET}


class StandaloneTest(CommandCase):
    def test_one_nodelet_under_the_name_of_its_node(self):
        process = self.run_process(
            *(*NODELET, "standalone", "dyknow_test/Introspector", "one", "two", "_answer:=42"),
            *("topic:=/by_node", "~topic:=mine", "__name:=alone", "__ns:=/robot"),
        )
        process.wait_for("loaded nodelet /robot/alone")
        description = call("/robot/alone", "describe")
        self.assertEqual(description["name"], "/robot/alone")
        self.assertEqual([description["argv"], description["myargv"]], [["one", "two"]] * 2)
        self.assertEqual(call("/robot/alone", "resolve", "topic"), "/by_node")
        self.assertEqual(call("/robot/alone", "resolve", "~topic"), "/robot/mine")
        self.assertEqual(rospy.get_param("/robot/alone/answer"), 42)
        process.stop()
        self.ends(process)

    def test_a_port_has_a_name_that_another_one_gave_up(self):
        process = self.run_process(
            *(*NODELET, "standalone", "dyknow/Relay", "_datatype:=std_msgs/Header"),
            *("in:=/a", "out:=/in", "__name:=alone"),
        )
        process.wait_for("loaded nodelet /alone")
        self.assertEqual(graph.topics_of_ports("/alone"), {"in": "/a", "out": "/in"})
        self.assertTrue(set_config("/alone", **{"in": "/in", "out": "/b"}).success)
        process.stop()
        self.ends(process)

    def test_a_nodelet_that_cannot_be_loaded_ends_it(self):
        output = self.does(*NODELET, "standalone", "dyknow_test/FailsInInit", code=255)
        self.assertIn("the camera is not plugged in", output)


LAUNCH = """
<launch>
  <arg name="rate" default="5"/>
  <group ns="rover">
    <remap from="image" to="camera/image"/>
    <node pkg="nodelet" type="nodelet" name="manager" args="manager" output="screen">
      <param name="num_worker_threads" value="3"/>
    </node>
    <node pkg="nodelet" type="nodelet" name="relay"
          args="load dyknow_test/Relay manager --no-bond first second" output="screen">
      <remap from="in" to="source"/>
      <remap from="~out" to="unused"/>
      <remap from="out" to="/result"/>
      <param name="rate" value="$(arg rate)"/>
      <rosparam>gains: [1, 2]</rosparam>
    </node>
    <node pkg="nodelet" type="nodelet" name="alone"
          args="standalone dyknow_test/Introspector third" output="screen"/>
    <node pkg="nodelet" type="nodelet" name="introspector"
          args="load dyknow_test/Introspector manager" output="screen"/>
  </group>
</launch>
"""


class LaunchTest(CommandCase):
    def test_a_launch_file_with_the_package_replaced(self):
        with tempfile.NamedTemporaryFile("w", suffix=".launch") as file:
            file.write(LAUNCH.replace('pkg="nodelet"', 'pkg="dyknow"'))
            file.flush()
            launch = self.run_process("roslaunch", file.name, "rate:=7")
            for nodelet in ("relay", "alone", "introspector"):
                rospy.wait_for_service(f"/rover/{nodelet}/call", 20.0 * BUSY)
            topics = {"in": "/rover/source", "out": "/result"}
            becomes(lambda: graph.topics_of_ports("/rover/relay"), topics)
            self.assertEqual(rospy.get_param("/rover/relay/rate"), 7)
            self.assertEqual(rospy.get_param("/rover/relay/gains"), [1, 2])
            self.assertEqual(call("/rover/alone", "describe")["argv"], ["third"])
            self.assertEqual(call("/rover/introspector", "describe")["argv"], [])
            image = call("/rover/introspector", "resolve", "image")
            self.assertEqual(image, "/rover/camera/image")
            speaker = self.publisher("/rover/source", Header)
            with Heard("/result", note=lambda message: message.seq) as heard:
                eventually(speaker.get_num_connections, 5.0, "the relay is connected")
                speaker.publish(Header(seq=9))
                becomes(heard.copy, [9])
            launch.stop()
            self.ends(launch)
        becomes(lambda: {node for node in nodes() if node.startswith("/rover")}, set())


class DescriptorsTest(TellingCase):
    def test_a_process_without_file_descriptors_answers_when_some_are_free(self):
        command = " ".join(NODELET)
        self.run_process("bash", "-c", f"ulimit -n 64; exec {command} manager __name:=few")
        graph.ManagerServices("/few").wait_until_up()

        def client(name, service_class, **options):
            return ServiceClient(Master("/tests"), f"/few/{name}", service_class, **options)

        client("load_nodelet", NodeletLoad).call(
            5.0 * BUSY, name="/relay", type="dyknow_test/Relay"
        )
        clients = []
        with self.assertRaises((HostError, PeerTimeout)):
            for _ in range(64):
                clients.append(client("list", NodeletList, persistent=True))
                clients[-1].call(2.0)
        for each in clients:
            each.close()
        client("unload_nodelet", NodeletUnload).call(5.0 * BUSY, "/relay")
        becomes(lambda: [name for name in graph.registered("/few") if "/relay" in name], [])


if __name__ == "__main__":
    run()
