#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What doc/security.md promises, tried on real processes."""

from __future__ import annotations

import contextlib

import graph
import rospy
import rostest
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import (
    AcquireStream,
    AddTransformation,
    Destroy,
    FindBindings,
    ReleaseStream,
    RemoveTransformation,
    RenewStream,
    ReplanStream,
    SetConfig,
    SetProtection,
    Spawn,
)
from graph import Manager, topics_of_ports
from manager_suite import (
    CHILD,
    MANAGER,
    ManagerCase,
    eventually,
    listed,
    parameters,
    specification,
)
from nodelet.srv import NodeletLoad, NodeletUnload
from std_msgs.msg import String

from dyknow.errors import Refused

RELAY = "/relay"
OTHER = "/other/manager"
CPP_CHILD = "/dyknow_cpp_nodelet_manager"
SCRIPT = "dyknow_test/talker.py"
LONG = "x" * 2**20
SERVICES = {
    "add_transformation": AddTransformation,
    "remove_transformation": RemoveTransformation,
    "spawn": Spawn,
    "destroy": Destroy,
    "set_protection": SetProtection,
    "acquire_stream": AcquireStream,
    "release_stream": ReleaseStream,
    "renew_stream": RenewStream,
    "replan_stream": ReplanStream,
    "find_bindings": FindBindings,
}
#: Specifications may be long: they have their own limits.
UNLIMITED = ("specification",)


def refusal(manager, name=RELAY):
    """The reason for which a nodelet manager refuses an unload; empty if it does not."""
    try:
        rospy.ServiceProxy(f"{manager}/unload_nodelet", NodeletUnload)(name)
    except rospy.ServiceException as error:
        return str(error)
    return ""


def too_long(service_class):
    """Requests, each with one text that is too long, or one array with too many entries."""
    request_class = service_class._request_class
    for field, kind in zip(request_class.__slots__, request_class._slot_types):
        if field in UNLIMITED:
            continue
        if kind == "string":
            yield field, request_class(**{field: LONG})
        elif kind == "string[]":
            yield field, request_class(**{field: [LONG]})
            yield f"{field}, many", request_class(**{field: ["x"] * 5000})
        elif kind == "dyknow_msgs/PortConfig[]":
            yield f"{field}, ports", request_class(**{field: [PortConfig(LONG, "")]})
            yield f"{field}, topics", request_class(**{field: [PortConfig("in", LONG)]})
            yield f"{field}, many", request_class(**{field: [PortConfig("in", "")] * 5000})


def load_refusal(manager, name, type_name, remappings=(), my_argv=()):
    """The reason for which a nodelet manager refuses a load of ours; empty if it does not."""
    call = rospy.ServiceProxy(f"{manager}/load_nodelet", NodeletLoad)
    try:
        call(name, type_name, list(dict(remappings)), list(dict(remappings).values()), my_argv, "")
    except rospy.ServiceException as error:
        return str(error)
    return ""


def program(label, source):
    return (
        f'<transformation type="node"><label>{label}</label><source>{source}</source>'
        "</transformation>"
    )


class TopicsTest(ManagerCase):
    """Nothing that a DyKnow manager starts is on a denied topic, by any way of connecting it."""

    def setUp(self):
        self.manager = self.started(denied_topics=["/e_stop", "/tf"])

    def assert_untouched(self, topic="/e_stop"):
        publishers, subscribers = graph.nodes_on(topic)
        self.assertEqual((set(publishers), set(subscribers) - {rospy.get_name()}), (set(), set()))

    def test_programs(self):
        words = rospy.Publisher("/words", String, queue_size=1, latch=True)
        words.publish("hello")
        for number, arguments in enumerate(("/words /e_stop", "/words b b:=/e_stop")):
            name = f"/copier_{number}"
            source = f"topic_tools/relay {arguments} _lazy:=false"
            self.manager.client.add_transformation(program("copier", source))
            self.manager.client.spawn("copier", name)
            # It makes its out-port with its first message.
            eventually(
                lambda name=name: len(topics_of_ports(name)) == 2,
                20.0,
                "it has both ports",
                lambda name=name: topics_of_ports(name),
            )
            self.assertIn("", topics_of_ports(name).values())
        self.assert_untouched()

    def test_scripts(self):
        words = rospy.Publisher("/words", String, queue_size=1, latch=True)
        words.publish("hello")
        copier = program("copier", "topic_tools/transform /words /e_stop std_msgs/String m")
        self.manager.client.add_transformation(copier)
        with self.assertRaisesRegex(Refused, "'/e_stop' is denied"):
            self.manager.client.spawn("copier", "/copier")
        with contextlib.suppress(Refused):  # it ends by itself, during its spawn or after it
            self.manager.client.spawn("copier", "/alone", isolated=True)
        eventually(
            lambda: self.manager.output.count("'/e_stop' is denied") > 1, 10.0, "its log says why"
        )
        self.assertIn(
            "is denied",
            load_refusal(CHILD, "/s", "dyknow/Script", {"/words": "/e_stop"}, [SCRIPT]),
        )
        self.assert_untouched()

    def test_nodelets_that_use_rospy_itself(self):
        self.manager.client.spawn("relay", RELAY)  # the nodelet manager is there
        self.assertEqual(load_refusal(CHILD, "/n", "dyknow_test/Ordinary"), "")
        for kind in ("rospy", "bus"):
            for make in ("make_publisher", "make_subscriber"):
                with self.assertRaisesRegex(rospy.ServiceException, "'/e_stop' is denied"):
                    graph.call("/n", make, kind, kind, "/e_stop")
                graph.call("/n", make, kind + make, kind, "/fine")
        self.assert_untouched()

    def test_nodelets_in_cpp(self):
        self.manager.client.add_transformation(
            specification("source", "dyknow_cpp_test/Source", "out>")
        )
        self.manager.client.spawn("source", "/source", is_protected=True)
        refused = load_refusal(CPP_CHILD, "/names", "dyknow_cpp_test/Names", {"/words": "/e_stop"})
        self.assertIn("topic '/e_stop' is denied", refused)
        self.assertEqual(load_refusal(CPP_CHILD, "/names", "dyknow_cpp_test/Names"), "")
        self.assertEqual(topics_of_ports("/names")["/tf"], "")
        self.assert_untouched("/tf")
        self.assert_untouched()
        self.assertIn("protected from unloading", refusal(CPP_CHILD, "/source"))
        self.assertEqual(refusal(CPP_CHILD, "/names"), "")
        # Read-only for everyone but for those who bring back what died.
        other = self.make(
            OTHER, num_nodelet_managers=0, nodelet_managers=[CPP_CHILD], read_only=True
        )
        other.start()
        eventually(
            lambda: "read-only" in load_refusal(CPP_CHILD, "/n", "dyknow_cpp_test/Source"),
            10.0,
            "it is read-only",
        )
        self.assertIn("read-only", refusal(CPP_CHILD, "/source"))
        other.stop()
        eventually(
            lambda: "read-only" not in refusal(CPP_CHILD, "/source"), 10.0, "it is no longer"
        )
        self.manager.client.set_protection("/source", False)
        self.manager.client.destroy("/source")

    def test_guards_that_are_deleted_come_back(self):
        self.manager.client.spawn("relay", RELAY)
        rospy.delete_param(f"{CHILD}/guards")

        def is_denied():
            answer = rospy.ServiceProxy(f"{RELAY}/set_config", SetConfig)(
                [PortConfig("out", "/e_stop"), PortConfig("out", "/e_stop")]
            )
            return "deny list" in answer.message

        eventually(lambda: rospy.has_param(f"{CHILD}/guards"), 10.0, "they are set again")
        eventually(is_denied, 10.0, "it is denied again")


class ProgramsTest(ManagerCase):
    def test_only_programs_of_the_allow_list_are_started(self):
        manager = self.started(allowed_programs=["dyknow_test/*"])
        with self.assertRaisesRegex(Refused, "allowed_programs"):
            manager.client.add_transformation(program("record", "rosbag/record -O /tmp/bag /a"))
        manager.client.add_transformation(program("script", SCRIPT))
        manager.client.spawn("script", "/script")
        self.assertIn(
            "allowed_programs",
            load_refusal(CHILD, "/s", "dyknow/Script", my_argv=["topic_tools/transform"]),
        )

    def test_services_start_no_programs(self):
        manager = self.started(remote_programs=False)
        with self.assertRaisesRegex(Refused, "remote_programs"):
            manager.client.add_transformation(program("script", SCRIPT))
        manager.client.spawn("relay", RELAY)  # declared code is not a program
        for script in (SCRIPT, __file__):
            self.assertIn(
                "is denied", load_refusal(CHILD, "/s", "dyknow/Script", my_argv=[script])
            )


class SharedGuardsTest(ManagerCase):
    def setUp(self):
        self.first = self.started(denied_topics=["/e_stop"])
        self.first.client.spawn("relay", RELAY)

    def other(self, **guards):
        """Another DyKnow manager that uses the nodelet manager of the first."""
        manager = self.make(OTHER, num_nodelet_managers=0, nodelet_managers=[CHILD], **guards)
        manager.start()
        return manager

    def refusal(self, topic):
        """The reason for which the proxy refuses a connection; empty if it does not."""
        call = rospy.ServiceProxy(f"{RELAY}/set_config", SetConfig)
        try:
            return call([PortConfig("out", topic)]).message
        except rospy.ServiceException as error:  # while it is being brought back
            return str(error)

    def denies(self, *topics):
        eventually(
            lambda: all("deny list" in self.refusal(topic) for topic in topics),
            5.0,
            f"{topics} are denied",
        )

    def test_only_its_owner_takes_a_guard_away(self):
        self.denies("/e_stop")
        other = self.other(denied_topics=["/wheels"])
        self.denies("/e_stop", "/wheels")
        other.stop()
        eventually(lambda: not self.refusal("/wheels"), 5.0, "/wheels is free")
        self.denies("/e_stop")
        self.first.kill_child()  # it starts under the guards that it had
        self.denies("/e_stop")
        self.assertEqual(self.refusal("/wheels"), "")

    def test_guards_of_a_killed_owner_stay_until_it_comes_again(self):
        other = self.other(denied_topics=["/wheels"], read_only=True)
        eventually(lambda: "read-only" in self.refusal("/fine"), 5.0, "read-only")
        other.kill()
        self.assertIn("read-only", self.refusal("/fine"))
        with self.assertRaises(rospy.ServiceException):
            rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)(RELAY)
        other.parameters.update(denied_topics=["/arm"], read_only=False)
        other.start()
        eventually(lambda: not self.refusal("/wheels"), 10.0, "its new guards hold")
        self.denies("/arm", "/e_stop")
        other.stop()
        left = [name for name in parameters(f"{CHILD}/guards") if "other" in name]
        self.assertEqual(left, [])


class ProtectionTest(ManagerCase):
    def test_the_stock_service_is_refused_until_it_is_released_whatever_restarts(self):
        manager = self.started()
        manager.client.spawn("relay", RELAY, is_protected=True)
        manager.client.spawn("relay", "/two")
        self.assertIn("protected from unloading", refusal(CHILD))
        self.assertEqual(refusal(CHILD, "/two"), "")
        eventually(lambda: manager.nodelet("/two") is None, 10.0, "its end is known")
        with self.assertRaises(Refused):
            manager.client.destroy(RELAY)
        manager.kill_child()
        eventually(lambda: listed(CHILD) == [RELAY], 20.0, "the nodelet is back")
        for change in (lambda: None, manager.kill, manager.start):
            change()
            self.assertIn("protected from unloading", refusal(CHILD))
        self.assertEqual(listed(CHILD), [RELAY])
        manager.client.set_protection(RELAY, False)
        eventually(lambda: refusal(CHILD) == "", 5.0, "it is released")
        eventually(lambda: manager.nodelet(RELAY) is None, 5.0, "the user's will is followed")

    def test_what_is_protected_later_and_destroyed_in_the_end(self):
        manager = self.started()
        manager.client.spawn("relay", "/one")
        manager.client.set_protection("/one", True)
        self.assertIn("protected from unloading", refusal(CHILD, "/one"))
        manager.client.set_protection("/one", False)
        manager.client.destroy("/one")
        self.assertEqual(listed(CHILD), [])

    def test_a_nodelet_manager_of_others(self):
        other = Manager("/other")
        self.addCleanup(other.__exit__)
        manager = self.started(nodelet_managers=["/other"])
        manager.client.spawn("relay", RELAY, manager="/other", is_protected=True)
        self.assertIn("protected from unloading", refusal("/other"))
        manager.stop()  # deliberately: its nodelets there end with it
        eventually(lambda: listed("/other") == [], 10.0, "nothing is left")


class LimitsTest(ManagerCase):
    def test_what_is_too_long_is_refused_and_not_logged(self):
        manager = self.started()
        manager.client.spawn("relay", "/relay")
        services = {f"{MANAGER}/{name}": each for name, each in SERVICES.items()}
        services["/relay/set_config"] = SetConfig
        services[f"{CHILD}/load_nodelet"] = NodeletLoad
        services[f"{CHILD}/unload_nodelet"] = NodeletUnload
        for name, service_class in services.items():
            call = rospy.ServiceProxy(name, service_class)
            for field, request in too_long(service_class):
                with self.subTest(name, field=field):
                    if name.startswith(CHILD):  # as in C++, these calls fail
                        with self.assertRaisesRegex(rospy.ServiceException, "too many"):
                            call(request)
                    else:
                        answer = call(request)
                        self.assertFalse(answer.success)
                        self.assertIn("too many", answer.message[:200])
        answer = rospy.ServiceProxy(f"{MANAGER}/add_transformation", AddTransformation)(LONG)
        self.assertFalse(answer.success)
        self.assertLess(len(answer.message), 1000)

        # The log has the last refusals, by the manager and by its nodelet manager.
        self.assertIn("adding transformations for", manager.output)
        eventually(lambda: "Failed to unload nodelet" in manager.output, 10.0, "the child's log")
        self.assertLess(max(map(len, manager.output.splitlines())), 10_000)


if __name__ == "__main__":
    rospy.init_node("security_test")
    rostest.rosrun("dyknow", "security", "__main__")
