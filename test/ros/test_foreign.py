#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that other clients have loaded, in processes that they have started."""

from __future__ import annotations

import signal

import rospy
from cpp_suite import OURS, PRELOADED, CppManager
from graph import Manager
from manager_suite import LIBRARY, ManagerCase
from processes import DYKNOW, NODELET, STOCK_NODELET, becomes, eventually, finished, run

from dyknow.errors import Refused
from dyknow.model.graph import NodeletKind, State

THEIRS = "/robot/dyknow_manager"
RELAY = "dyknow_manager_test/Relay"


class ForeignTest(ManagerCase):
    """Started by hand: nodelet managers in Python and C++, a nodelet alone, a DyKnow manager."""

    def setUp(self):
        super().setUp()
        self.manager = self.started(denied_topics=["/estop"])
        self.client = self.manager.client

    def shown(self, name: str):
        eventually(lambda: self.manager.nodelet(name), 10.0, f"{name} is in the model")
        return self.manager.nodelet(name)

    def rewired(self, nodelet: str, port: str, topic: str) -> None:
        self.client.connect([(nodelet, {port: topic})])
        self.assertEqual(self.manager.topics(nodelet)[port], topic)

    def test_nodelets_in_a_nodelet_manager_in_python(self):
        theirs = self.enter(Manager("/my_manager"))
        loading = (*STOCK_NODELET, "load", RELAY, "my_manager", "__name:=bonded")
        self.run_process(*loading)
        theirs.load(RELAY, "/by_hand")
        for name, owner in (("/bonded", "/bonded"), ("/by_hand", rospy.get_name())):
            found = self.shown(name)
            self.assertEqual((found.manager, found.owner), ("/my_manager", owner))
            self.assertEqual((found.kind, found.state), (NodeletKind.PYTHON, State.RUNNING))
        code, printed = finished([*DYKNOW, "list", "-l"])
        self.assertRegex(printed, r"/bonded +\(by /bonded\) +running +1 +1 +/my_manager")
        code, printed = finished([*DYKNOW, "info", "bonded"])
        self.assertIn("Owner: /bonded", printed)

        self.client.spawn("counter", "/counter", {"out": "/numbers"})
        self.rewired("/by_hand", "in", "/numbers")
        self.rewired("/by_hand", "out", "/passed")
        eventually(
            lambda: self.client.get_statistics("/by_hand").ports[1].messages > 0,
            10.0,
            "messages pass",
        )
        with self.assertRaisesRegex(Refused, "nodelet unload /by_hand /my_manager"):
            self.client.destroy("/by_hand")
        with self.assertRaisesRegex(Refused, "restart it where it was started"):
            self.client.restart("/by_hand")
        with self.assertRaisesRegex(Refused, "unknown nodelet manager '/my_manager'; known"):
            self.client.spawn("relay", "/mine", manager="/my_manager")

        self.manager.kill()
        self.manager.start()
        self.assertEqual(self.shown("/by_hand").owner, rospy.get_name())
        code, printed = finished([*NODELET, "unload", "/by_hand", "my_manager"])
        self.assertEqual(code, 0, printed)
        becomes(lambda: self.manager.nodelet("/by_hand"), None)
        theirs.stop(signal.SIGKILL)
        becomes(lambda: self.manager.nodelet("/bonded"), None)
        self.assertEqual(self.manager.nodelet("/counter").state, State.RUNNING)

    def test_nodelets_in_nodelet_managers_in_cpp(self):
        for name, command in (("/ours", ()), ("/stock", PRELOADED)):
            with self.subTest(name):
                theirs = self.enter(CppManager(name, *command))
                sink = f"{name}_sink"
                theirs.load("Sink", sink)
                found = self.shown(sink)
                self.assertEqual((found.manager, found.owner), (name, rospy.get_name()))
                self.assertEqual((found.kind, found.is_fixed), (NodeletKind.CPP, False))
                self.rewired(sink, found.ports[0].name, f"{name}/elsewhere")
                with self.assertRaisesRegex(Refused, f"nodelet unload {sink} {name}"):
                    self.client.destroy(sink)
                self.assertEqual(theirs.list(), [sink])
                theirs.unload(sink)
                becomes(lambda sink=sink: self.manager.nodelet(sink), None)

    def test_the_nodelets_of_another_dyknow_manager(self):
        theirs = self.make(THEIRS)
        theirs.start()
        theirs.client.add_transformation(LIBRARY)
        theirs.client.spawn("relay", "/shared")
        theirs.client.spawn("relay", "/alone", isolated=True)
        for name in ("/shared", "/alone"):
            self.assertEqual(self.shown(name).owner, THEIRS)
            self.assertEqual(theirs.nodelet(name).owner, "")
        self.client.connect([("/shared", {"in": "/from_here"})])
        becomes(lambda: theirs.topics("/shared")["in"], "/from_here")
        with self.assertRaisesRegex(Refused, f"of {THEIRS}; end it with"):
            self.client.destroy("/shared")
        theirs.client.destroy("/alone")
        becomes(lambda: self.manager.nodelet("/alone"), None)

    def test_a_nodelet_alone(self):
        process = self.run_process(*NODELET, "standalone", RELAY, "__name:=alone")
        found = self.shown("/alone")
        self.assertEqual((found.kind, found.manager), (NodeletKind.NODE, ""))
        self.rewired("/alone", "in", "/a")
        with self.assertRaisesRegex(Refused, "rosnode kill /alone"):
            self.client.destroy("/alone")
        process.stop(signal.SIGKILL)
        becomes(lambda: self.manager.nodelet("/alone"), None)

    def test_guards_of_this_manager_do_not_bind_processes_of_other_clients(self):
        theirs = self.enter(Manager("/my_manager"))
        theirs.load(RELAY, "/early")
        self.shown("/early")
        with self.assertRaisesRegex(Refused, "'/estop' is denied"):
            self.client.connect([("/early", {"in": "/estop"})])
        theirs.load(RELAY, "/late", {"/in": "/estop"})
        becomes(lambda: self.manager.topics("/late").get("in"), "/estop")

    def test_an_owner_that_allows_no_rewiring(self):
        for name, command, kind, port in (
            ("/python", (*NODELET, "manager", "_rewirable:=false"), RELAY, "in"),
            ("/cpp", (*OURS, "_rewirable:=false"), "dyknow_cpp_test/Sink", "in"),
        ):
            with self.subTest(name):
                self.enter(Manager(name, command=command)).load(kind, f"{name}_nodelet")
                before = self.shown(f"{name}_nodelet").ports
                for connect in (self.client.set_config, self.connect):
                    with self.assertRaisesRegex(Refused, "not to be re-wired .*~rewirable"):
                        connect(f"{name}_nodelet", {port: "/a"})
                self.assertEqual(self.manager.nodelet(f"{name}_nodelet").ports, before)

    def connect(self, nodelet: str, config: dict[str, str]) -> None:
        self.client.connect([(nodelet, config)])


if __name__ == "__main__":
    run()
