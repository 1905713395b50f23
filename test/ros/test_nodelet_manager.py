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
from typing import Callable

import graph  # first: it makes the test package known
import rosgraph
import rospy
import rostest
import test_nodelet_command
from dyknow_msgs.msg import NodeletChanges
from dyknow_test.puppet import Echo
from graph import Manager, NodeletManagerCase, call, registrations, set_config
from nodelet.srv import NodeletList, NodeletLoad, NodeletUnload
from processes import BUSY, NODELET, STOCK_NODELET, eventually, finished, nodes
from roslib.packages import find_node
from std_msgs.msg import Header, String
from test_nodelet_command import StartingCase

from dyknow.errors import HostError, PeerTimeout
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

#: What rospy says of a connection to a topic that the process does not publish.
REFUSED = "Could not process inbound connection"


def connector(node: str, topic: str) -> Callable[[str], None]:
    """Return a function that connects to topics of a node, which publishes one for certain."""
    api = rosgraph.Master(rospy.get_name()).lookupNode(node)
    _, host, port = xmlrpc.client.ServerProxy(api).requestTopic(
        rospy.get_name(), topic, [["TCPROS"]]
    )[2]

    def connect(name: str) -> None:
        fields = {"topic": name, "md5sum": "*", "type": "*", "callerid": rospy.get_name()}
        with socket.create_connection((host, port), 5.0) as connection:
            rosgraph.network.write_ros_handshake_header(connection, fields)
            connection.recv(1)  # the answer: it is refused

    return connect


class ManagersCase(StartingCase):
    def run_manager(self, *arguments, **options):
        manager = Manager(*arguments, **options)
        self.addCleanup(manager.__exit__)
        return manager


class StartTest(ManagersCase):
    def test_the_number_of_its_threads_and_its_time_to_start(self):
        def workers(manager):
            return len([*graph.Path(f"/proc/{manager.pid}/task").iterdir()])

        rospy.set_param("/eleven/num_worker_threads", 11)
        rospy.set_param("/five/num_worker_threads", 5)
        eleven = self.run_manager("/eleven")
        # Everything is in the page cache for the second one, as on a machine that runs.
        begin = time.monotonic()
        five = self.run_manager("/five")
        self.assertLess(time.monotonic() - begin, 2 * BUSY)
        eventually(
            lambda: workers(eleven) - workers(five) == 6, 5.0, "six threads more in the one"
        )
        self.assertIn("Initializing nodelet with 11 worker threads.", eleven.output)

    def test_every_command_that_starts_a_manager(self):
        for command in (
            ["rosrun", "dyknow", "nodelet_manager"],
            ["rosrun", "dyknow", "nodelet", "manager"],
        ):
            process = self.start(*command, "__name:=started")
            rospy.wait_for_service("/started/list", 10.0 * BUSY)
            process.stop()
            self.assertEqual(process.exit_code(20.0), 0, process.output)
            self.assertNotIn("/started", nodes())

    def test_a_parameter_without_sense_ends_it_and_does_not_outlive_its_command_line(self):
        rospy.set_param("/confused/num_worker_threads", "many")
        process = self.run_manager("/confused", wait=False)
        self.assertEqual(process.exit_code(20.0), 255, process.output)
        self.assertIn("expected an integer", process.output)
        self.assertIn("rosparam set /confused/num_worker_threads", process.output)
        self.assertNotIn("Traceback", process.output)
        process = self.start(*find_node("dyknow", "nodelet_manager"), "_stuck_after:=soon")
        self.assertEqual(process.exit_code(20.0), 255, process.output)
        self.assertIn("parameter '~stuck_after' is 'soon'", process.output)
        self.assertFalse(rospy.has_param("/manager/stuck_after"), process.output)

    def test_sigint_at_any_moment_of_the_start(self):
        for tenth in range(1, 8, 2):
            process = self.run_manager("/hasty", wait=False)
            if not process.ends_within(tenth / 10):
                process.stop()
            code = process.exit_code(20.0)
            # Python itself had not started yet.
            early = ("Fatal Python error: init", "Could not import runpy module")
            too_early = any(each in process.output for each in early)
            expected = (1,) if too_early else (0, 130, -signal.SIGINT)
            self.assertIn(code, expected, process.output)
            self.assertNotIn("/hasty", nodes())

    def test_signals_end_the_wait_for_a_master(self):
        for number, command in (
            (signal.SIGINT, ["manager"]),
            (signal.SIGTERM, ["standalone", "dyknow/Source"]),
        ):
            nowhere = ["env", "ROS_MASTER_URI=http://127.0.0.1:1"]
            process = self.start(*nowhere, *NODELET, *command)
            process.wait_for("master may not be running yet")
            process.stop(number)
            self.assertEqual(process.exit_code(10.0), 130, process.output)
            self.assertNotIn("Traceback", process.output)


class RobotCase(StartingCase, NodeletManagerCase):
    manager_name = "/robot/manager"


class ServiceTest(RobotCase):
    def test_load_list_unload(self):
        before = registrations("/robot/manager")
        self.assertEqual(self.manager.list(), [])
        for _ in range(3):  # a name can be loaded again at once
            self.manager.load("Talker", "~b", {"out": "/topic"})
            self.manager.load("Listener", "a", {"in": "/topic"})
            self.assertEqual(self.manager.list(), ["/robot/a", "/robot/manager/b"])
            self.assertIn("/robot/a/get_config", registrations("/robot/manager")["services"])
            self.assertEqual(graph.nodes_on("/topic")[1], {"/robot/manager"})
            for name in self.manager.list():
                self.assertTrue(self.manager.unload(name).success)
            self.assertEqual(self.manager.list(), [])
            self.assertEqual(registrations("/robot/manager"), before)

    def test_names_resolve_in_the_nodelets_namespace(self):
        self.manager.load("Introspector", "/deep/er/down", {"~other": "there"}, ["--fast", "a b"])
        description = call("/deep/er/down", "describe")
        self.assertEqual(description["get_name"], "/deep/er/down")
        self.assertEqual(description["namespace"], "/deep/er/")
        self.assertEqual(description["argv"], ["--fast", "a b"])
        names = description["names"]
        self.assertEqual(names["proxy"], ["/deep/er/topic", "/topic", "/deep/er/down/topic"])
        self.assertEqual(names["private_node_handle"][0], "/deep/er/down/topic")
        self.assertEqual(call("/deep/er/down", "resolve", "~other"), "/robot/there")

    def test_changes_and_newcomers_are_announced(self):
        heard = []

        def listen():
            del heard[:]
            return rospy.Subscriber(
                "/robot/manager/changes",
                NodeletChanges,
                lambda message: heard.append(message.nodelets),
            )

        subscriber = listen()
        for change in (
            lambda: self.manager.load("Listener", "/b"),
            lambda: set_config("/b", **{"in": "/topic"}),
            lambda: self.manager.unload("/b"),
        ):
            del heard[:]
            change()
            eventually(lambda: any("/b" in names for names in heard), 5.0, "a change")
        subscriber.unregister()
        for name in ("/b", "/a"):
            self.manager.load("Listener", name)
        self.addCleanup(listen().unregister)
        eventually(lambda: ["/a", "/b"] in heard, 5.0, "a newcomer is told of every nodelet")

    def test_it_publishes_nothing_of_a_type_that_nodelets_use(self):
        """Programs may search for a nodelet's topics by type."""
        published = registrations("/robot/manager")["publishers"]
        types = dict(rosgraph.Master(rospy.get_name()).getTopicTypes())
        self.assertEqual(types["/robot/manager/changes"], "dyknow_msgs/NodeletChanges")
        own = {"rosgraph_msgs/Log", "bond/Status", "dyknow_msgs/NodeletChanges"}
        self.assertLessEqual({types[topic] for topic in published}, own)


class RefusalTest(RobotCase):
    """A refusal is a failed service call that names the mistake; nothing is left behind."""

    def tearDown(self):
        super().tearDown()
        for key in ("/n", "/go_on"):
            if rospy.has_param(key):
                rospy.delete_param(key)

    def assert_refused(self, *texts, **request):
        """A load is refused, with all the texts in the answer and in the log."""
        before = registrations("/robot/manager"), graph.parameters()
        with self.assertRaises(rospy.ServiceException) as caught:
            self.manager.load_nodelet(**request)
        for text in texts:
            self.assertIn(text, str(caught.exception).replace("\\'", "'"))
            eventually(lambda text=text: text in self.manager.output, 2.0, f"'{text}' is logged")
        self.assertEqual((registrations("/robot/manager"), graph.parameters()), before)

    def test_loads(self):
        rospy.set_param("/n/gain", 3)  # outlives all of it
        for kind, name, texts in (
            ("dyknow_test/Nothing", "/n", ("'dyknow_test/Nothing'", "declared types")),
            ("os.path", "/n", ("'os.path'", "dyknow_test/Talker")),
            ("dyknow_test_broken/Broken", "/n", ("nodelets.xml", "not well-formed")),
            ("dyknow_test/Unimportable", "/n", ("RuntimeError: this module needs a camera",)),
            ("dyknow_test/Missing", "/n", ("has no class 'Missing'", "nodelets.xml")),
            ("dyknow_test/NoNodelet", "/n", ("does not derive from dyknow.Nodelet",)),
            ("dyknow_test/Talker", "/a//b", ("'/a//b'", "not a valid nodelet name")),
            ("dyknow_test/FailsInInit", "/n", ("ValueError: the camera is not plugged in",)),
            ("dyknow_test/ExitsInInit", "/n", ("SystemExit: enough",)),
        ):
            with self.subTest(kind, name=name):
                remap = {"remap_source_args": ["in", "out"], "remap_target_args": ["/a", "/b"]}
                self.assert_refused(*texts, name=name, type=kind, **remap)
        self.assertIn("in on_init", self.manager.output)  # a traceback
        unpaired = {"remap_source_args": ["out", "in"], "remap_target_args": ["/a"]}
        why = "2 remap_source_args but 1 remap_target_args"
        self.assert_refused(why, name="/n", type="dyknow_test/Talker", **unpaired)
        self.assertEqual(self.manager.list(), [])
        self.manager.load("Talker", "/n")  # nothing of that hides it
        self.assert_refused("already loaded", name="/n", type="dyknow_test/Listener")
        self.assertEqual(rospy.get_param("/n/gain"), 3)

    @staticmethod
    def begins():
        return "/n/get_config" in graph.services_of("/robot/manager")

    def test_unloads_and_loads_during_on_init(self):
        rospy.set_param("/go_on", False)
        words = (*NODELET, "load", "dyknow_test/WaitsInInit", "/robot/manager", "--no-bond")
        for is_unloaded in (True, False):
            client = self.start(*words, "__name:=n")
            eventually(self.begins, 10.0, "on_init has begun", lambda c=client: c.output)
            with self.assertRaisesRegex(rospy.ServiceException, "being loaded"):
                self.manager.load("Talker", "/n")
            self.manager.load("Talker", "/quick")
            self.assertEqual(self.manager.list(), ["/quick"])
            if is_unloaded:
                self.manager.unload("/n")
                self.assertEqual(client.exit_code(20.0), 255)
                self.assertIn("unloaded during its load", client.output)
                self.manager.unload_all()
            rospy.set_param("/go_on", True)
            eventually(lambda: "/n: on_init is through" in self.manager.output, 5.0, "it goes on")
            self.manager.forget_output()
            if is_unloaded:
                rospy.set_param("/go_on", False)
        eventually(lambda: self.manager.list() == ["/n", "/quick"], 5.0, "both are loaded")
        client.stop()
        client.exit_code(20.0)
        with self.assertRaisesRegex(rospy.ServiceException, "loaded: /quick"):
            self.manager.unload("/stranger")

    def test_types_of_topics_that_are_live_outside(self):
        """The master remembers the types of topics without publishers and subscribers."""
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        others = [
            (lambda: rospy.Publisher("/outside", String, queue_size=1), "in", 0),
            (lambda: rospy.Subscriber("/outside", String), "out", 1),
        ]
        for make, port, role in others:
            other = make()
            eventually(lambda role=role: graph.nodes_on("/outside")[role], 2.0, "registered")
            answer = set_config("/n", **{port: "/outside"})
            self.assertIn("'/outside' carries std_msgs/String", answer.message)
            self.assertEqual(graph.topics_of_ports("/n"), {"in": "/a", "out": "/b"})
            other.unregister()
        eventually(lambda: not any(graph.nodes_on("/outside")), 2.0, "nobody is there any more")
        answer = set_config("/n", **{"in": "/outside"})
        self.assertTrue(answer.success, answer.message)

    def test_service_handlers(self):
        """rospy's caller is answered whatever becomes of the handler, and of its nodelet."""
        self.manager.load("Fragile", "/n")
        service = rospy.ServiceProxy("/n/obey", Echo)
        for number, (order, said) in enumerate(
            (("raise", "fragile at 0"), ("exit", "SystemExit"))
        ):
            with self.assertRaisesRegex(rospy.ServiceException, said):
                service(Header(seq=number, frame_id=order))
        self.assertEqual(service(Header(seq=7)).seq, 7)
        self.assertEqual(graph.get_statistics("/n").callback_errors, 2)
        answers = []

        def hang():
            try:
                rospy.ServiceProxy("/n/obey", Echo)(Header(seq=8, frame_id="hang"))
            except rospy.ServiceException as error:
                answers.append(str(error))

        caller = threading.Thread(target=hang, daemon=True)
        caller.start()
        eventually(lambda: call("/n", "received")[-1:] == [8], 5.0, "it hangs")
        config = rospy.ServiceProxy("/n/get_config", graph.GetConfig, persistent=True)
        config()
        self.manager.unload("/n")
        caller.join(5.0 * BUSY)
        self.assertEqual(len(answers), 1, "the caller is answered")
        with self.assertRaises(rospy.ServiceException):
            config()


class ProcessRemappingTest(ManagersCase):
    def test_the_requests_remappings_come_first_then_the_processes(self):
        manager = self.run_manager("/manager", "topic:=/by_process", "other:=/by_process_too")
        manager.load("Introspector", "/n", {"topic": "/by_request"})
        self.assertEqual(call("/n", "resolve", "topic"), "/by_request")
        self.assertEqual(call("/n", "resolve", "other"), "/by_process_too")
        self.assertEqual(call("/n", "publish_plain", "topic"), "/by_request")
        self.assertEqual(call("/n", "publish_plain", "other"), "/by_process_too")
        self.assertEqual(graph.nodes_on("/by_process_too")[0], {"/manager"})

        # A topic that the process remaps is out of a port's reach.
        manager.load("Listener", "/listener")
        answer = graph.set_config("/listener", **{"in": "/topic"})
        self.assertFalse(answer.success)
        self.assertIn("/by_process", answer.message)
        self.assertEqual(graph.topics_of_ports("/listener"), {"in": ""})


class EndTest(ManagersCase):
    def test_an_end_of_manager_and_clients_at_once_is_silent(self):
        manager = self.run_manager("/ending")
        clients = [
            self.start(*STOCK_NODELET, "load", "dyknow_test/Relay", "ending", f"__name:=relay{n}")
            for n in range(3)
        ]
        eventually(lambda: len(manager.list()) == 3, 10.0, "all are loaded")
        for process in (manager, *clients):
            process.stop()
        for process in (manager, *clients):
            process.exit_code(20.0)
            self.assertNotIn("Couldn't find service", process.output)
            self.assertNotIn(REFUSED, process.output)

    def test_who_connects_to_what_has_ended_already_is_not_told_of_at_the_end(self):
        manager = self.run_manager("/ending")
        client = self.start(*STOCK_NODELET, "load", "dyknow_test/Relay", "ending", "__name:=relay")
        eventually(lambda: manager.list() == ["/relay"], 10.0, "it is loaded")
        connect = connector("/ending", "/rosout")
        connect("/nowhere")
        manager.wait_for(REFUSED)
        client.stop(signal.SIGSTOP)  # so that the manager waits for it at its end
        manager.stop()
        eventually(lambda: not manager.lists(), 5.0, "it ends")
        with contextlib.suppress(ConnectionError):  # on a busy machine it has ended by now
            connect("/nowhere_either")
        manager.exit_code(20.0)
        self.assertNotIn("/nowhere_either", manager.output)


class ClientTest(test_nodelet_command.ClientTest):
    """Clients of both kinds with DyKnow's manager."""


class StandaloneTest(StartingCase):
    def test_one_nodelet_under_the_name_of_its_node(self):
        process = self.start(
            *NODELET,
            "standalone",
            "dyknow_test/Introspector",
            "one",
            "two",
            "topic:=/by_node",
            "~topic:=mine",
            "__name:=alone",
            "__ns:=/robot",
            "_answer:=42",
        )
        rospy.wait_for_service("/robot/alone/call", 10.0 * BUSY)
        description = call("/robot/alone", "describe")
        self.assertEqual(description["name"], "/robot/alone")
        self.assertEqual(description["argv"], ["one", "two"])
        self.assertEqual(call("/robot/alone", "resolve", "topic"), "/by_node")
        self.assertEqual(call("/robot/alone", "resolve", "~topic"), "/robot/mine")
        self.assertEqual(rospy.get_param("/robot/alone/answer"), 42)
        process.stop()
        self.assertEqual(process.exit_code(20.0), 0, process.output)

    def test_a_nodelet_that_cannot_be_loaded_ends_it(self):
        code, output = finished([*NODELET, "standalone", "dyknow_test/FailsInInit"])
        self.assertEqual(code, 255, output)
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


class LaunchTest(StartingCase):
    def test_a_launch_file_with_the_package_replaced(self):
        with tempfile.NamedTemporaryFile("w", suffix=".launch") as file:
            file.write(LAUNCH.replace('pkg="nodelet"', 'pkg="dyknow"'))
            file.flush()
            launch = self.start("roslaunch", file.name, "rate:=7")
            for nodelet in ("relay", "alone", "introspector"):
                rospy.wait_for_service(f"/rover/{nodelet}/call", 20.0 * BUSY)
            topics = {"in": "/rover/source", "out": "/result"}
            eventually(
                lambda: graph.topics_of_ports("/rover/relay") == topics, 5.0, "it is connected"
            )
            self.assertEqual(rospy.get_param("/rover/relay/rate"), 7)
            self.assertEqual(rospy.get_param("/rover/relay/gains"), [1, 2])
            self.assertEqual(call("/rover/alone", "describe")["argv"], ["third"])
            self.assertEqual(call("/rover/introspector", "describe")["argv"], [])
            self.assertEqual(
                call("/rover/introspector", "resolve", "image"), "/rover/camera/image"
            )
            heard = rospy.Subscriber("/result", Header, self.note)
            speaker = rospy.Publisher("/rover/source", Header, queue_size=1)
            self.heard = []
            eventually(
                lambda: graph.is_fed("/result") and speaker.get_num_connections(),
                5.0,
                "the relay is connected",
            )
            speaker.publish(Header(seq=9))
            eventually(lambda: self.heard == [9], 5.0, "the relay relays")
            heard.unregister()
            speaker.unregister()
            launch.stop()
            self.assertEqual(launch.exit_code(15.0), 0, launch.output)
        self.assertFalse({node for node in nodes() if node.startswith("/rover")})

    def note(self, message):
        self.heard.append(message.seq)


class DescriptorsTest(StartingCase):
    def test_a_process_without_file_descriptors_answers_when_some_are_free(self):
        command = " ".join(NODELET)
        self.start("bash", "-c", f"ulimit -n 64; exec {command} manager __name:=few")
        master = Master(rospy.get_name())
        rospy.wait_for_service("/few/unload_nodelet", 10.0 * BUSY)
        load = ServiceClient(master, "/few/load_nodelet", NodeletLoad)
        load.call(10.0, name="/relay", type="dyknow_test/Relay")
        clients = []
        with self.assertRaises((HostError, PeerTimeout)):
            for _ in range(64):
                clients.append(ServiceClient(master, "/few/list", NodeletList, persistent=True))
                clients[-1].call(2.0)
        for client in clients:
            client.close()
        ServiceClient(master, "/few/unload_nodelet", NodeletUnload).call(10.0, "/relay")
        self.assertEqual(registrations("/relay"), registrations("/nothing"))


if __name__ == "__main__":
    rospy.init_node("nodelet_manager_test")
    rostest.rosrun("dyknow", "nodelet_manager", "__main__")
