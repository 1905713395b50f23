#!/usr/bin/env python3
"""The window on the soccer case study: a stream is asked for, runs, and a camera replaces another.

With DYKNOW_PICTURES the picture of the documentation is written into that folder.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Callable

os.environ["QT_QPA_PLATFORM"] = "offscreen"

import rospy
import rostest
from manager_suite import ManagerCase
from python_qt_binding.QtCore import Qt
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication

from dyknow_rqt import screenshots
from dyknow_rqt.graph.library_changes import remove_transformations
from dyknow_rqt.ros_remote import RosRemote
from dyknow_rqt.window import DyKnowWidget

EXAMPLES = Path(__file__).resolve().parent.parent.parent / "examples"


def until(condition: Callable[[], object], what: str) -> None:
    screenshots.wait(condition, 40.0, what)


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
        QTest.mouseClick(panel.acquire, Qt.LeftButton)

        def is_active() -> bool:
            return [each.state.name for each in panel.watch.streams] == ["ACTIVE"]

        until(is_active, "the stream is there")
        (stream,) = panel.watch.streams
        until(lambda: f"t_{stream.topic}" in scene.vertices, "it is drawn")

        def flows() -> bool:
            traffic = [item.traffic for edge, item in scene.edges.items()]
            return all(each and each.rate > 1.0 and not each.drop_rate for each in traffic)

        until(flows, "all of it flows")
        window.graph.tidy()
        panel.table.choose([stream.claim_id])
        QTest.qWait(500)
        self.take(window)

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

    def take(self, window: DyKnowWidget) -> None:
        """Write the picture, and look whether there is something on it."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(os.environ.get("DYKNOW_PICTURES") or folder, "gui_streams.png")
            picture = window.grab().toImage()
            self.assertTrue(picture.save(path))
        right = range(picture.width() // 2, picture.width(), 7)
        colours = {picture.pixel(x, y) for x in right for y in range(100, picture.height(), 7)}
        self.assertGreater(len(colours), 20)


if __name__ == "__main__":
    rospy.init_node("rqt_case_study")
    application = screenshots.dressed(QApplication(sys.argv[:1]))
    rostest.rosrun("dyknow", "rqt_case_study", CaseStudyTest, sys.argv)
