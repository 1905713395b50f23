#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet manager and its clients, each a real process: names, bonds, launch files."""

from __future__ import annotations

import contextlib
import signal
import socket
import tempfile
import time
import xmlrpc.client
from typing import Callable

import graph  # first: it makes the test package known
import rosgraph
import rospy
import rostest
from dyknow_msgs.msg import NodeletChanges
from graph import (
    Ended,
    Manager,
    NodeletManagerCase,
    call,
    let_the_bond_form,
    registrations,
    set_config,
)
from nodelet.srv import NodeletList, NodeletLoad, NodeletUnload
from processes import (
    BUSY,
    HELD_UP,
    NODELET,
    STOCK_NODELET,
    TellingCase,
    eventually,
    finished,
    nodes,
)
from roslib.packages import find_node
from std_msgs.msg import Header

from dyknow.errors import HostError, PeerTimeout
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

CLIENTS = {"stock": STOCK_NODELET, "own": NODELET}


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


class Started(TellingCase):
    def start(self, *command):
        process = Ended(*command)
        self.addCleanup(process.__exit__)
        return process

    def run_manager(self, *arguments, **options):
        manager = Manager(*arguments, **options)
        self.addCleanup(manager.__exit__)
        return manager


class StartTest(Started):
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

    def test_a_parameter_without_sense(self):
        rospy.set_param("/confused/num_worker_threads", "many")
        process = self.run_manager("/confused", wait=False)
        self.assertEqual(process.exit_code(20.0), 255, process.output)
        self.assertIn("num_worker_threads", process.output)
        self.assertIn("expected an integer", process.output)
        self.assertNotIn("Traceback", process.output)
        self.assertIn("rosparam set /confused/num_worker_threads", process.output)

    def test_a_parameter_without_sense_does_not_outlive_its_command_line(self):
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
            too_early = "Fatal Python error: init" in process.output  # it was not Python yet
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


class RobotCase(Started, NodeletManagerCase):
    manager_name = "/robot/manager"


class ServiceTest(RobotCase):
    def test_load_list_unload(self):
        before = registrations("/robot/manager")
        self.assertEqual(self.manager.list(), [])
        self.manager.load("Talker", "/b", {"out": "/topic"})
        self.manager.load("Listener", "/a", {"in": "/topic"})
        self.assertEqual(self.manager.list(), ["/a", "/b"])
        self.assertIn("/a/get_config", registrations("/robot/manager")["services"])
        self.assertTrue(self.manager.unload("/b").success)
        self.assertEqual(self.manager.list(), ["/a"])
        self.manager.unload("/a")
        self.assertEqual(registrations("/robot/manager"), before)

    def test_a_name_can_be_loaded_again_at_once(self):
        for _ in range(5):
            self.manager.load("Talker", "/again", {"/out": "/topic"})
            self.manager.unload("/again")

    def test_names_and_namespaces(self):
        self.manager.load("Introspector", "relative")
        self.manager.load("Introspector", "/absolute")
        self.manager.load("Introspector", "/deep/er/down")
        self.manager.load("Introspector", "~private")
        self.assertEqual(
            self.manager.list(),
            ["/absolute", "/deep/er/down", "/robot/manager/private", "/robot/relative"],
        )
        description = call("/deep/er/down", "describe")
        self.assertEqual(description["name"], "/deep/er/down")
        self.assertEqual(description["get_name"], "/deep/er/down")
        self.assertEqual(description["namespace"], "/deep/er/")
        public = ["/deep/er/topic", "/topic", "/deep/er/down/topic"]
        private = ["/deep/er/down/topic", "/topic", "/deep/er/down/topic"]
        self.assertEqual(
            description["names"],
            {
                "node_handle": public,
                "private_node_handle": private,
                "mt_node_handle": public,
                "mt_private_node_handle": private,
                "proxy": public,
            },
        )

    def test_my_argv(self):
        self.manager.load("Introspector", "/n", my_argv=["--fast", "a b", "", "x:=y"])
        self.assertEqual(call("/n", "describe")["argv"], ["--fast", "a b", "", "x:=y"])

    def test_remappings_of_the_request(self):
        remappings = {
            "topic": "/relative/to/the/manager",
            "/cam/topic": "/absolute",
            "~topic": "/private",
            "/cam/n/other": "where",
        }
        self.manager.load("Introspector", "/cam/n", remappings)
        for name, target in {
            "topic": "/absolute",
            "/cam/topic": "/absolute",
            "/robot/topic": "/relative/to/the/manager",
            "~topic": "/private",
            "/cam/n/topic": "/private",
            "~other": "/robot/where",
            "else": "/cam/else",
        }.items():
            self.assertEqual(call("/cam/n", "resolve", name), target, name)

    def test_remappings_reach_no_neighbour(self):
        self.manager.load("Introspector", "/one", {"/topic": "/elsewhere"})
        self.manager.load("Introspector", "/two")
        self.assertEqual(call("/two", "resolve", "topic"), "/topic")

    def test_ports_are_connected_by_the_request_alone(self):
        self.manager.load("Relay", "/ns/relay", {"/ns/in": "/source"})
        self.assertEqual(graph.topics_of_ports("/ns/relay"), {"in": "/source", "out": ""})
        self.assertEqual(graph.nodes_on("/source"), (set(), {"/robot/manager"}))

    def test_it_publishes_nothing_of_a_type_that_nodelets_use(self):
        """Programs may search for a nodelet's topics by type."""
        published = registrations("/robot/manager")["publishers"]
        types = dict(rosgraph.Master(rospy.get_name()).getTopicTypes())
        self.assertEqual(types["/robot/manager/changes"], "dyknow_msgs/NodeletChanges")
        own = {"rosgraph_msgs/Log", "bond/Status", "dyknow_msgs/NodeletChanges"}
        self.assertLessEqual({types[topic] for topic in published}, own)

    def test_changes_are_told(self):
        heard = self.listen_to_changes()
        for change in (
            lambda: self.manager.load("Listener", "/b"),
            lambda: set_config("/b", **{"in": "/topic"}),
            lambda: self.manager.unload("/b"),
        ):
            del heard[:]
            change()
            eventually(lambda: any("/b" in names for names in heard), 5.0, "a change")

    def test_a_newcomer_is_told_of_every_nodelet(self):
        self.manager.load("Listener", "/b")
        self.manager.load("Talker", "/a")
        heard = self.listen_to_changes()
        eventually(lambda: ["/a", "/b"] in heard, 5.0, "they are told")

    def listen_to_changes(self):
        heard = []
        subscriber = rospy.Subscriber(
            "/robot/manager/changes",
            NodeletChanges,
            lambda message: heard.append(message.nodelets),
        )
        self.addCleanup(subscriber.unregister)
        return heard

    def test_a_slow_on_init_holds_up_nobody(self):
        rospy.set_param("/go_on", False)
        slow = self.start(
            *NODELET, "load", "dyknow_test/WaitsInInit", "/robot/manager", "__name:=slow"
        )
        eventually(
            lambda: "/slow/get_config" in registrations("/robot/manager")["services"],
            10.0,
            "on_init has begun",
        )
        begin = time.monotonic()
        self.manager.load("Introspector", "/quick")
        self.assertEqual(self.manager.list(), ["/quick"])
        self.assertLess(time.monotonic() - begin, HELD_UP)
        rospy.set_param("/go_on", True)
        eventually(lambda: "/slow" in self.manager.list(), 5.0, "the slow one is loaded")
        slow.stop()
        slow.exit_code(20.0)


class ProcessRemappingTest(Started):
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


class ClientTest(RobotCase):
    """`nodelet load`, the stock one and DyKnow's, against DyKnow's manager."""

    def load(self, client, *arguments):
        process = self.start(
            *CLIENTS[client],
            "load",
            "dyknow_test/Relay",
            "manager",
            *arguments,
            "__name:=relay",
            "__ns:=/robot",
        )
        eventually(
            lambda: "/robot/relay" in self.manager.list() or process.has_ended,
            15.0,
            "the nodelet is loaded",
        )
        self.assertEqual(self.manager.list(), ["/robot/relay"], process.output)
        return process

    def test_remappings_arrive(self):
        for client in CLIENTS:
            with self.subTest(client):
                process = self.load(client, "in:=a", "out:=/b", "_size:=3")
                self.assertEqual(
                    graph.topics_of_ports("/robot/relay"), {"in": "/robot/a", "out": "/b"}
                )
                self.assertEqual(rospy.get_param("/robot/relay/size"), 3)
                let_the_bond_form(f"{self.manager.name}/bond")
                process.stop()
                self.assertEqual(process.exit_code(20.0), 0, process.output)

    def test_ctrl_c_unloads(self):
        for client in CLIENTS:
            with self.subTest(client):
                process = self.load(client)
                # The stock client handles signals once the nodelet is loaded, not before.
                let_the_bond_form(f"{self.manager.name}/bond")
                process.stop(signal.SIGINT)
                self.assertEqual(process.exit_code(20.0), 0, process.output)
                eventually(lambda: self.manager.list() == [], 2.0, "it is unloaded")
                eventually(lambda: "/robot/relay" not in nodes(), 2.0, "the client is gone")

    def test_a_manager_that_ended_before_is_no_trouble_at_the_end(self):
        manager = self.run_manager("/ended")
        relay = ("load", "dyknow_test/Relay", "/ended", "--no-bond", "__name:=relay")
        process = self.start(*NODELET, *relay)
        eventually(lambda: manager.list() == ["/relay"], 15.0, "the nodelet is loaded")
        manager.stop()
        manager.exit_code(10.0)
        process.stop(signal.SIGINT)
        self.assertEqual(process.exit_code(20.0), 0, process.output)
        for word in ("Couldn't find", "WARN", "ERROR", "FATAL", "Traceback"):
            self.assertNotIn(word, process.output)

    def test_kill_9_of_the_client_unloads(self):
        for client in CLIENTS:
            with self.subTest(client):
                process = self.load(client)
                let_the_bond_form(f"{self.manager.name}/bond")
                process.stop(signal.SIGKILL)
                eventually(lambda: self.manager.list() == [], 6.0, "the manager misses it")
                self.assertIn("bond", self.manager.output)

    def test_a_service_unload_ends_the_client(self):
        for client in CLIENTS:
            with self.subTest(client):
                process = self.load(client)
                self.manager.unload("/robot/relay")
                self.assertEqual(process.exit_code(20.0), 0, process.output)

    def test_without_bond_the_nodelet_outlives_the_client(self):
        process = self.load("own", "--no-bond")
        process.stop(signal.SIGKILL)
        process.exit_code(20.0)
        for client in ("own", "stock"):
            self.assertEqual(self.manager.list(), ["/robot/relay"])
            code, output = finished([*CLIENTS[client], "unload", "/robot/relay", "/robot/manager"])
            self.assertEqual(code, 0, output)
            self.assertEqual(self.manager.list(), [])
            self.manager.load("Relay", "/robot/relay")

    def test_what_the_manager_refuses_ends_the_client(self):
        for client in CLIENTS:
            with self.subTest(client):
                code, output = finished(
                    [*CLIENTS[client], "load", "dyknow_test/Nothing", "/robot/manager"]
                )
                self.assertEqual(code, 255, output)
                self.assertIn("dyknow_test/Nothing", output)
                self.assertIn("dyknow_test/Relay", self.manager.output)  # what there is

    def test_two_managers(self):
        other = self.run_manager("/other")
        self.manager.load("Talker", "/talker", {"/out": "/topic"})
        other.load("Listener", "/listener", {"/in": "/topic"})
        self.assertEqual((self.manager.list(), other.list()), (["/talker"], ["/listener"]))
        eventually(lambda: call("/talker", "connections") == 1, 5.0, "they are connected")
        call("/talker", "publish", 0, 5)
        eventually(lambda: call("/listener", "received") == [0, 1, 2, 3, 4], 5.0, "all arrive")
        other.unload("/listener")
        eventually(lambda: call("/talker", "connections") == 0, 5.0, "it is told")


class EndTest(Started):
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


class StandaloneTest(Started):
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

    def test_its_ports_are_connected_by_the_command_line(self):
        process = self.start(
            *NODELET, "standalone", "dyknow_test/Relay", "in:=/a", "out:=/b", "__name:=relay"
        )
        rospy.wait_for_service("/relay/call", 10.0 * BUSY)
        connected = {"in": "/a", "out": "/b"}
        eventually(lambda: graph.topics_of_ports("/relay") == connected, 5.0, "they are connected")
        process.stop(signal.SIGTERM)
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


class LaunchTest(Started):
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


class DescriptorsTest(Started):
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
