#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window, with a DyKnow manager in another process."""

from __future__ import annotations

import os
import sys
import time
from typing import Callable

os.environ["QT_QPA_PLATFORM"] = "offscreen"

import rospy
import rostest
from manager_suite import ManagerCase, Receiver, eventually
from processes import Running
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication

from dyknow.model.graph import PortRef, SpawnRequest
from dyknow_rqt.graph.changes import SpawnNodelet
from dyknow_rqt.graph.wiring import connect, connect_topic
from dyknow_rqt.ros_remote import RosRemote
from dyknow_rqt.window import DyKnowWidget

OUT, IN = PortRef("/count", "out"), PortRef("/relay", "in")


def until(condition: Callable[[], object], what: str, timeout: float = 30.0) -> None:
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
        window = self.window()
        sign = window.graph.sign
        until(lambda: "does not answer; waiting" in sign.text(), "it says that nobody is there")
        manager = self.started()
        until(lambda: "No nodelets yet" in sign.text(), "the manager is found")
        until(lambda: "counter" in window.library.table.names(), "the library is shown")

        monitor = window.monitor
        for label, name in (("counter", "/count"), ("relay", "/relay")):
            monitor.do(SpawnNodelet(SpawnRequest(label, name)))
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

    def test_changes_of_others_show_at_once_and_a_new_manager_is_found(self) -> None:
        manager = self.started()
        window = self.window()
        until(lambda: window.monitor.is_linked, "the manager is found")
        window.monitor.set_period(60.0)  # what comes now arrives by the topic
        until(lambda: window.monitor.remote._latest is not None, "the topic is heard")
        manager.client.spawn("counter", "/count")
        until(lambda: "n_/count" in self.keys(window), "it is drawn")
        manager.client.set_config("/count", {"out": "/numbers"})
        until(lambda: "t_/numbers" in self.keys(window), "it is drawn")

        window.monitor.set_period(0.3)
        manager.kill()
        until(lambda: not window.monitor.is_linked, "the window notices")
        self.assertIn("n_/count", self.keys(window))
        manager.start()
        until(lambda: window.monitor.is_linked, "the window finds the next manager")

    def test_a_refusal_is_a_line_in_the_words_of_the_manager(self) -> None:
        self.started()
        window = self.window()
        until(lambda: window.monitor.library, "the library is there")
        window.monitor.do(SpawnNodelet(SpawnRequest("fails", "/never")))
        until(lambda: window.line.text, "something is said")
        self.assertIn("create /never: cannot spawn '/never'", window.line.text)

    def test_the_own_window_starts_and_ends_on_request(self) -> None:
        manager = self.started()
        manager.client.spawn("counter", "/count")
        with Running("rosrun", "dyknow", "dyknow_rqt") as process:
            started = lambda: any(  # noqa: E731
                "dyknow_rqt" in node for node in _subscribers("/dyknow_manager/model")
            )
            eventually(lambda: started() or process.has_ended, 20.0, process.output)
            self.assertFalse(process.has_ended, process.output)
            process.stop()
            eventually(lambda: process.has_ended, 10.0, "the window is closed")
            self.assertEqual(process.exit_code(5.0), 0, process.output)
            self.assertNotIn("Traceback", process.output)


def _subscribers(topic: str) -> set[str]:
    from dyknow.ros.master import Master

    return Master(rospy.get_name()).subscribers(topic)


if __name__ == "__main__":
    rospy.init_node("rqt_window")
    application = QApplication(sys.argv[:1])
    rostest.rosrun("dyknow", "rqt_window", WindowTest, sys.argv)
