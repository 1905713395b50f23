#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window on the soccer case study: a stream is requested, runs, and changes its camera.

With DYKNOW_PICTURES the picture of the documentation is written into that folder.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Callable

os.environ["QT_QPA_PLATFORM"] = "offscreen"

import rospy
import rostest
from manager_suite import ManagerCase
from processes import BUSY
from python_qt_binding.QtCore import Qt
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication

from dyknow_rqt import screenshots
from dyknow_rqt.graph.changes import remove_transformations
from dyknow_rqt.ros_remote import RosRemote
from dyknow_rqt.window import DyKnowWidget

#: Where to write the picture; empty for nowhere.
PICTURES = os.environ.get("DYKNOW_PICTURES", "")
EXAMPLES = Path(__file__).resolve().parent.parent.parent / "examples"


def until(condition: Callable[[], object], what: str) -> None:
    screenshots.wait(condition, 4.0 * BUSY, what)


class CaseStudyTest(ManagerCase):
    def test_the_ball_is_asked_for_and_followed(self) -> None:
        manager = self.make(ontologies=[str(EXAMPLES / "ontologies" / "soccer.ttl")])
        manager.start()
        window = self.window()
        panel, scene = window.streams, window.graph.view.scene()
        until(lambda: window.monitor.is_linked, "the manager is found")
        window.library.import_file(str(EXAMPLES / "transformations" / "soccer.xml"))
        until(lambda: "bottom_camera" in window.library.table.names(), "the library is there")

        window.tabs.setCurrentWidget(panel)
        QTest.keyClicks(panel.tag, "FieldPosition(ball)")
        QTest.keyClick(panel.tag, Qt.Key_Return)
        until(lambda: "bottom_camera.image (new" in panel.plan.toPlainText(), "the plan is shown")
        self.assertEqual(window.monitor.snapshot.nodelets, ())

        def is_active() -> bool:
            return [each.state.name for each in panel.watch.streams] == ["ACTIVE"]

        refusals: list[str] = []
        window.monitor.failed.connect(refusals.append)
        QTest.mouseClick(panel.acquire, Qt.LeftButton)
        until(lambda: is_active() or refusals, "the stream is there")
        while refusals:  # a starved window takes the manager for a silent one
            self.assertIn("silent", refusals.pop())
            until(lambda: window.monitor.is_linked, "the manager answers")
            QTest.mouseClick(panel.acquire, Qt.LeftButton)
            until(lambda: is_active() or refusals, "the stream is there")
        (stream,) = panel.watch.streams
        until(lambda: f"t_{stream.topic}" in scene.vertices, "it is drawn")

        def traffic() -> list:
            return [item.traffic for item in scene.edges.values()]

        until(lambda: all(each and each.rate > 1.0 for each in traffic()), "all of it flows")
        panel.table.choose([stream.claim_id])
        selected = {item.vertex.name for item in scene.selectedItems()}
        self.assertEqual(selected, set(stream.nodelets))
        self.look_at(window)
        if PICTURES:
            until(lambda: not any(each.drop_rate for each in traffic()), "the beginning is over")
            window.graph.tidy()
            QTest.qWait(1000)
            window.grab().save(os.path.join(PICTURES, "gui_streams.png"))

        window.monitor.do(remove_transformations(["bottom_camera"]))
        until(lambda: any("ceiling_camera" in key for key in scene.vertices), "the other camera")
        until(
            lambda: is_active()
            and not any("bottom_camera" in name for name in panel.watch.streams[0].nodelets),
            "its stream has taken over",
        )
        self.assertEqual(panel.watch.streams[0].topic, stream.topic)
        self.assertIn("bottom_camera was removed", panel.events.toPlainText())
        panel.table.choose([stream.claim_id])
        QTest.mouseClick(panel.release, Qt.LeftButton)
        until(lambda: not panel.table.names(), "the stream is released")

    def window(self) -> DyKnowWidget:
        widget = DyKnowWidget(RosRemote())
        self.addCleanup(widget.shut_down)
        widget.resize(1600, 760)
        widget.show()
        widget.start()
        return widget

    def look_at(self, window: DyKnowWidget) -> None:
        """Check that the picture is not empty."""
        picture = window.grab().toImage()
        right = range(picture.width() // 2, picture.width(), 7)
        colours = {picture.pixel(x, y) for x in right for y in range(100, picture.height(), 7)}
        self.assertGreater(len(colours), 20)


if __name__ == "__main__":
    rospy.init_node("rqt_case_study")
    application = screenshots.dressed(QApplication(sys.argv[:1]))
    rostest.rosrun("dyknow", "rqt_case_study", CaseStudyTest, sys.argv)
