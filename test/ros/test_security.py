#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The promises of doc/security.md, tried on real processes."""

from __future__ import annotations

import contextlib

import graph
import rospy
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import (
    AcquireStream,
    AddTransformation,
    Destroy,
    FindBindings,
    PlanStream,
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
    CPP_CHILD,
    MANAGER,
    ManagerCase,
    listed,
    specification,
)
from nodelet.srv import NodeletLoad, NodeletUnload
from processes import becomes, eventually, run
from std_msgs.msg import String

from dyknow.errors import Refused

RELAY = "/relay"
OTHER = "/other/manager"
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
    "plan_stream": PlanStream,
    "find_bindings": FindBindings,
}


def refusal(service, service_class, *request):
    """The reason for which a service refuses a request; empty if it does not."""
    try:
        answer = rospy.ServiceProxy(service, service_class)(*request)
    except rospy.ServiceException as error:
        return str(error)
    return getattr(answer, "message", "")


def unload_refusal(manager, name=RELAY):
    return refusal(f"{manager}/unload_nodelet", NodeletUnload, name)


def load_refusal(manager, name, type_name, remappings=(), my_argv=()):
    """The reason for which a nodelet manager refuses a load of ours; empty if it does not."""
    pairs = dict(remappings)
    request = (name, type_name, [*pairs], [*pairs.values()], my_argv, "")
    return refusal(f"{manager}/load_nodelet", NodeletLoad, *request)


def port_refusal(topic, times=1):
    """The reason for which a proxy refuses a connection; empty if it does not."""
    ports = [PortConfig("out", topic)] * times
    return refusal(f"{RELAY}/set_config", SetConfig, ports)


def too_long(service_class):
    """Requests, each with one text that is too long, or one array with too many entries."""
    request_class = service_class._request_class
    for field, kind in zip(request_class.__slots__, request_class._slot_types):
        if field == "specification":  # has limits of its own
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


#: One manager for most tests.
GUARDED = {"denied_topics": ["/e_stop", "/tf"], "nodelet_managers": ["/other"]}


def program(label, source):
    return specification(label, source, "", "node")


class TopicsTest(ManagerCase):
    """Nothing that a DyKnow manager starts is on a denied topic, by any way of connecting it."""

    def setUp(self):
        self.manager = self.started(**GUARDED)
        words = self.publisher("/words", String, latch=True)
        words.publish("hello")

    def assert_untouched(self, *topics):
        for topic in ("/e_stop", *topics):
            publishers, subscribers = graph.nodes_on(topic)
            self.assertEqual((publishers, subscribers - {rospy.get_name()}), (set(), set()))

    def test_programs(self):
        for number, arguments in enumerate(("/words /e_stop", "/words b b:=/e_stop")):
            name = f"/copier_{number}"
            source = f"topic_tools/relay {arguments} _lazy:=false"
            self.manager.client.add_transformation(program("copier", source))
            self.manager.client.spawn("copier", name)
            # It makes its out-port with its first message.
            becomes(lambda name=name: len(topics_of_ports(name)), 2)
            self.assertIn("", topics_of_ports(name).values())
        self.assert_untouched()

    def test_scripts(self):
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
        self.assertIn("protected from unloading", unload_refusal(CPP_CHILD, "/source"))
        self.assertEqual(unload_refusal(CPP_CHILD, "/names"), "")
        # Read-only for everyone but managers that bring dead nodelets back.
        other = self.make(
            OTHER, num_nodelet_managers=0, nodelet_managers=[CPP_CHILD], read_only=True
        )
        other.start()
        eventually(
            lambda: "read-only" in load_refusal(CPP_CHILD, "/n", "dyknow_cpp_test/Source"),
            10.0,
            "it is read-only",
        )
        self.assertIn("read-only", unload_refusal(CPP_CHILD, "/source"))
        other.stop()
        is_free = lambda: "read-only" not in unload_refusal(CPP_CHILD, "/source")  # noqa: E731
        eventually(is_free, 10.0, "it is no longer")
        self.manager.client.set_protection("/source", False)
        self.manager.client.destroy("/source")


class AllowedProgramsTest(ManagerCase):
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
        self.first = self.started(**GUARDED)
        self.first.client.spawn("relay", RELAY)

    def other(self, **guards):
        """Another DyKnow manager that uses the nodelet manager of the first."""
        manager = self.make(OTHER, num_nodelet_managers=0, nodelet_managers=[CHILD], **guards)
        manager.start()
        return manager

    def denies(self, *topics):
        for topic in topics:
            eventually(lambda topic=topic: "deny list" in port_refusal(topic), 5.0, f"no {topic}")

    def test_only_its_owner_takes_a_guard_away(self):
        self.denies("/e_stop")
        other = self.other(denied_topics=["/wheels"])
        self.denies("/e_stop", "/wheels")
        other.stop()
        eventually(lambda: not port_refusal("/wheels"), 5.0, "/wheels is free")
        self.denies("/e_stop")
        self.first.kill_child()  # it starts under the guards that it had
        self.denies("/e_stop")
        self.assertEqual(port_refusal("/wheels"), "")

    def test_guards_of_a_killed_owner_stay_until_it_comes_again(self):
        other = self.other(denied_topics=["/wheels"], read_only=True)
        eventually(lambda: "read-only" in port_refusal("/fine"), 5.0, "read-only")
        other.kill()
        self.assertIn("read-only", port_refusal("/fine"))
        self.assertIn("read-only", unload_refusal(CHILD))
        other.parameters.update(denied_topics=["/arm"], read_only=False)
        other.start()
        eventually(lambda: not port_refusal("/wheels"), 10.0, "its new guards hold")
        self.denies("/arm", "/e_stop")
        other.stop()
        eventually(lambda: not port_refusal("/arm"), 5.0, "/arm is free")


class ProtectionTest(ManagerCase):
    def test_the_stock_service_is_refused_until_it_is_released_whatever_restarts(self):
        manager = self.started(**GUARDED)
        manager.client.spawn("relay", RELAY)
        manager.client.set_protection(RELAY, True)
        manager.client.spawn("relay", "/two")
        self.assertIn("protected from unloading", unload_refusal(CHILD))
        self.assertEqual(unload_refusal(CHILD, "/two"), "")
        manager.is_gone("/two")
        with self.assertRaises(Refused):
            manager.client.destroy(RELAY)
        manager.kill_child()
        becomes(lambda: listed(CHILD), [RELAY], 20.0)
        for change in (lambda: None, manager.kill, manager.start):
            change()
            self.assertIn("protected from unloading", unload_refusal(CHILD))
        self.assertEqual(listed(CHILD), [RELAY])
        manager.client.set_protection(RELAY, False)
        becomes(lambda: unload_refusal(CHILD), "")
        manager.is_gone(RELAY)  # the user's will is followed

    def test_a_nodelet_manager_of_others(self):
        self.enter(Manager("/other"))
        manager = self.started(**GUARDED)
        self.spawned(manager, "/first", "/other")
        manager.client.spawn("relay", RELAY, manager="/other", is_protected=True)
        self.assertIn("protected from unloading", unload_refusal("/other"))


class LimitsTest(ManagerCase):
    def test_what_is_too_long_is_refused_and_not_logged(self):
        manager = self.started(**GUARDED)
        manager.client.spawn("relay", "/relay")
        services = {f"{MANAGER}/{name}": each for name, each in SERVICES.items()}
        services["/relay/set_config"] = SetConfig
        services[f"{CHILD}/load_nodelet"] = NodeletLoad
        services[f"{CHILD}/unload_nodelet"] = NodeletUnload
        for name, service_class in services.items():
            for field, request in too_long(service_class):
                with self.subTest(name, field=field):
                    said = refusal(name, service_class, request)
                    self.assertIn("too many", said[:400])
        said = refusal(f"{MANAGER}/add_transformation", AddTransformation, LONG)
        self.assertTrue(0 < len(said) < 1000, said)

        # The log has the last refusals, by the manager and by its nodelet manager.
        self.assertIn("adding transformations for", manager.output)
        eventually(lambda: "Failed to unload nodelet" in manager.output, 10.0, "the child's log")
        self.assertLess(max(map(len, manager.output.splitlines())), 10_000)


if __name__ == "__main__":
    run()
