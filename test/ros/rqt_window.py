#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window, with a DyKnow manager in another process."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from typing import Callable
from unittest import mock

os.environ["QT_QPA_PLATFORM"] = "offscreen"

import rospy
import rostest
from manager_suite import LIBRARY, ManagerCase, Receiver, eventually
from processes import HELD_UP, Running, TellingCase, free_port
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication
from roslib.packages import find_node

from dyknow.model.graph import PortRef, SpawnRequest
from dyknow.ros.client import ManagerClient
from dyknow.ros.wire.master import Master
from dyknow_rqt.canvas.scene import GraphScene
from dyknow_rqt.graph.changes import spawn
from dyknow_rqt.graph.wiring import connect, connect_topic
from dyknow_rqt.ros_remote import RosRemote
from dyknow_rqt.window import DyKnowWidget

OUT, IN = PortRef("/count", "out"), PortRef("/relay", "in")


def until(condition: Callable[[], object], what: str, timeout: float = HELD_UP) -> None:
    """Process the window's events until something holds."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > timeout:
            raise AssertionError(f"not within {timeout:g} s: {what}")
        QTest.qWait(10)


class WindowTest(ManagerCase):
    def window(self) -> DyKnowWidget:
        widget = DyKnowWidget(RosRemote())
        self.addCleanup(widget.shut_down)
        widget.resize(1200, 700)
        widget.show()
        widget.start()
        return widget

    def keys(self, widget: DyKnowWidget) -> set[str]:
        return set(widget.graph.view.scene().vertices)

    def test_the_window_waits_for_a_manager_and_changes_its_graph(self) -> None:
        self.end_idle()
        window = self.window()
        sign = window.graph.sign
        until(lambda: sign.text() == "waiting for /dyknow_manager", "it says that nobody is there")
        manager = self.started()
        until(lambda: "No nodelets yet" in sign.text(), "the manager is found")
        until(lambda: "counter" in window.library.table.names(), "the library is shown")

        monitor = window.monitor
        for label, name in (("counter", "/count"), ("relay", "/relay")):
            monitor.do(spawn(SpawnRequest(label, name)))
            until(lambda name=name: f"n_{name}" in self.keys(window), f"{name} is drawn")
            until(lambda: not monitor.is_changing, "the change has ended")

        until(lambda: all(map(monitor.snapshot.port, (OUT, IN))), "their ports are known")
        monitor.do(connect(monitor.snapshot, OUT, IN))
        arrows = window.graph.view.scene().edges

        def rates() -> list[float]:
            found = [item.traffic for edge, item in arrows.items() if edge.head == "n_/relay"]
            return [traffic.rate for traffic in found if traffic is not None]

        until(lambda: any(25 < rate < 75 for rate in rates()), "the rate stands on the arrow")

        until(lambda: not monitor.is_changing, "the change has ended")
        until(lambda: monitor.snapshot.port(IN).topic == "/count/out", "the window knows")
        monitor.do(connect_topic(monitor.snapshot, PortRef("/relay", "out"), "/end"))
        receiver = Receiver("/end")
        self.addCleanup(receiver.close)
        until(lambda: len(receiver.numbers) > 5, "messages flow through what was connected")
        window.graph.bar.debug.setChecked(False)  # this node is named like rqt's
        window.graph.bar.nodes.setChecked(True)
        until(lambda: f"p_{rospy.get_name()}" in self.keys(window), "the listening node is shown")

        until(lambda: not monitor.is_changing, "the change has ended")
        monitor.undo()
        until(lambda: manager.topics("/relay")["out"] == "", "the connection is taken back")

    def test_the_own_window_starts_and_ends_on_request(self) -> None:
        manager = self.started()
        manager.client.spawn("counter", "/count")
        with Running("rosrun", "dyknow", "dyknow_rqt") as process:
            started = lambda: readers_of_the_model()  # noqa: E731
            eventually(lambda: started() or process.has_ended, 20.0, process.output)
            self.assertFalse(process.has_ended, process.output)
            process.stop()
            eventually(lambda: process.has_ended, 10.0, "the window is closed")
            self.assertEqual(process.exit_code(5.0), 0, process.output)
            self.assertNotIn("Traceback", process.output)


class DeadSystemTest(TellingCase):
    """Everything that can go away does so; the master and the manager are the test's own."""

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.state = folder.name
        self.port = free_port()
        self.uri = f"http://localhost:{self.port}"
        patch = mock.patch.dict(os.environ, {"ROS_MASTER_URI": self.uri})
        patch.start()
        self.addCleanup(patch.stop)

    def start(self, *command: str) -> Running:
        process = Running(*command)
        self.addCleanup(process.__exit__)
        return process

    def roscore(self) -> Running:
        return self.start("rosmaster", "--core", "-p", self.port)

    def manager(self) -> Running:
        manager = find_node("dyknow", "manager")[0]
        return self.start(manager, f"_state_dir:={self.state}", "_orphan_timeout:=1.0")

    def end(self, process: Running) -> None:
        process.stop(signal.SIGKILL)
        process.exit_code(10.0)

    def test_the_window_says_what_is_dead_and_finds_what_comes_back(self) -> None:
        window = DyKnowWidget(RosRemote())
        self.addCleanup(window.shut_down)
        window.show()
        window.start()
        scene, sign, contact = window.graph.view.scene(), window.graph.sign, window.line.contact

        def says(words: str) -> None:
            until(lambda: words in contact.text(), words)
            self.assertIn(words, sign.text())

        def is_drawn(name: str) -> None:
            until(lambda: f"n_{name}" in scene.vertices and window.monitor.is_linked, name)

        says(f"no ROS master at {self.uri}")
        core = self.roscore()
        says("waiting for /dyknow_manager")
        manager = self.manager()
        until(lambda: "/dyknow_manager answers since" in contact.text(), "it answers")
        client = ManagerClient()
        client.add_transformation(LIBRARY)
        client.spawn("counter", "/count", {"out": "/numbers"})
        is_drawn("/count")

        manager.stop(signal.SIGSTOP)
        says("⚠ /dyknow_manager silent for 3 s")
        self.assertTrue(is_grey(scene))
        manager.stop(signal.SIGCONT)
        until(lambda: not sign.isVisible(), "it answers again")
        self.assertFalse(is_grey(scene))

        self.end(core)
        says(f"⚠ no ROS master at {self.uri}")
        self.assertIn("/dyknow_manager answers", sign.text())
        self.assertFalse(is_grey(scene))
        self.roscore()
        says(f"⚠ the ROS master at {self.uri} does not know /dyknow_manager")
        self.end(manager)
        says("⚠ /dyknow_manager gone for")
        self.assertTrue(is_grey(scene))

        self.manager()
        until(lambda: not sign.isVisible(), "the next manager is found")
        client.spawn("counter", "/another", {"out": "/numbers"})
        is_drawn("/another")
        self.assertEqual(len(readers_of_the_model()), 1)
        self.assertNotIn("rqt", str(Master("/test").ask("getSystemState")))
        window.shut_down()
        until(lambda: not readers_of_the_model(), "the window has left")


def readers_of_the_model() -> set[int]:
    """Ports of the subscribers of the manager's model."""
    master = Master("/test")
    uri = master.node("/dyknow_manager")
    return master.connections(uri, "/dyknow_manager/model", 2.0) if uri else set()


def is_grey(scene: GraphScene) -> bool:
    colours = scene.vertices["n_/count"].colours
    return colours.text == colours.muted


if __name__ == "__main__":
    rospy.init_node("rqt_window")
    application = QApplication(sys.argv[:1])
    rostest.rosrun("dyknow", "rqt_window", "__main__", sys.argv)
