# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``make screenshots``: takes the pictures of the documentation, from a made-up graph.

It needs neither a screen nor ROS processes.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from typing import Callable, Sequence

from python_qt_binding.QtCore import QEvent, QPointF, Qt
from python_qt_binding.QtGui import QColor, QFontDatabase, QMouseEvent, QPalette
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication, QStyleFactory

from dyknow.model.graph import PortRef
from dyknow.model.streams import StreamRequest
from dyknow_rqt.graph.figure import Boxes
from dyknow_rqt.graph.samples import Sample
from dyknow_rqt.monitoring.simulated import SimulatedRemote, soccer, tree
from dyknow_rqt.window import DyKnowWidget

#: Does something with a window and its manager; its name is that of the picture.
Pose = Callable[[DyKnowWidget, SimulatedRemote], None]


def dressed(application: QApplication) -> QApplication:
    """Make the application look the same on every machine, and return it."""
    font = QFontDatabase.systemFont(QFontDatabase.GeneralFont)
    font.setFamily("DejaVu Sans")
    font.setPointSize(9)
    application.setStyle(QStyleFactory.create("Fusion"))
    application.setFont(font)
    application.setAttribute(Qt.AA_UseHighDpiPixmaps)
    return application


def dark_palette() -> QPalette:
    palette = QPalette(QColor("#31363b"), QColor("#2b2f33"))
    for role, colour in (
        (QPalette.Base, "#1f2326"),
        (QPalette.AlternateBase, "#26292d"),
        (QPalette.Text, "#e6e8ea"),
        (QPalette.WindowText, "#e6e8ea"),
        (QPalette.ButtonText, "#e6e8ea"),
        (QPalette.Highlight, "#3d8fd1"),
        (QPalette.HighlightedText, "#ffffff"),
        (QPalette.ToolTipBase, "#31363b"),
        (QPalette.ToolTipText, "#e6e8ea"),
    ):
        palette.setColor(QPalette.All, role, QColor(colour))
    for role in (QPalette.Text, QPalette.WindowText, QPalette.ButtonText):
        palette.setColor(QPalette.Disabled, role, QColor("#7b8085"))
    return palette


def wait(condition: Callable[[], object], seconds: float, what: str) -> None:
    """Run the window until a condition holds; TimeoutError names the condition."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {seconds:g} s: {what}")
        QTest.qWait(20)


def main(argv: list[str] | None = None) -> int:
    """Take all pictures; returns the exit code."""
    parser = argparse.ArgumentParser("python3 -m dyknow_rqt.screenshots", description=__doc__)
    parser.add_argument(
        "folder", nargs="?", default=os.path.join("doc", "images"), help="%(default)s"
    )
    parser.add_argument("--dark", action="store_true", help="take all of them in the dark")
    asked = parser.parse_args(argv)
    os.makedirs(asked.folder, exist_ok=True)
    application = dressed(QApplication(sys.argv[:1]))
    light = QPalette(application.palette())
    for pose in (
        *(_graph, _highlight, _load, _hosts, _connect, _plan, _card, _timeline, _gone, _dark),
        *(_many, _found, _narrow),
    ):
        application.setPalette(dark_palette() if asked.dark or pose is _dark else light)
        count, size = _TREES.get(pose, (0, (1600, 760)))
        remote = tree(count) if count else soccer()
        _take(os.path.join(asked.folder, f"gui{pose.__name__}.png"), remote, pose, size)
    return 0


def _take(path: str, remote: SimulatedRemote, pose: Pose, size: Sequence[int]) -> None:
    """Write a picture of a window that is in a pose."""
    widget = DyKnowWidget(remote)
    widget.resize(*size)
    widget.show()
    widget.start()
    try:
        wait(lambda: len(widget.graph.drawn.vertices) > 15, 20.0, "the graph is drawn")
        wait(lambda: widget.monitor.library, 10.0, "the library is there")
        if remote.client.rates:
            wait(lambda: _has_rates(widget), 20.0, "the rates are there")
        pose(widget, remote)
        for _ in range(2):  # the drawing may then be painted in steps
            wait(lambda: _is_drawn(widget), 120.0, "all of it is drawn")
            QTest.qWait(300)
        print(f"screenshots: {path}")
        if not widget.grab().save(path):
            raise OSError(f"cannot write '{path}'")
    finally:
        widget.shut_down()
        widget.close()
        widget.deleteLater()
        QTest.qWait(50)


def _is_drawn(widget: DyKnowWidget) -> bool:
    scene = widget.graph.view.scene()
    jobs = (scene._draw, scene._tell_looks, scene._picture)
    is_idle = widget.graph.layouter.is_idle and scene.labels.are_placed
    return is_idle and not any(map(scene.slices.is_wanted, jobs))


def _has_rates(widget: DyKnowWidget) -> bool:
    traffic = [item.traffic for item in widget.graph.view.scene().edges.values()]
    return any(each is not None and each.drop_rate > 0 for each in traffic)


def _tidy(widget: DyKnowWidget) -> None:
    QTest.qWait(500)
    widget.graph.tidy()
    QTest.qWait(500)


def _graph(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    widget.graph.bar.choose("nodes", 1)
    wait(lambda: len(widget.graph.drawn.vertices) > 20, 10.0, "nodes are shown")
    _tidy(widget)
    widget.active.table.choose(["/nao1/ball_detector"])


def _many(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    wait(lambda: len(widget.graph.drawn.vertices) == 1000, 20.0, "all are drawn")


def _found(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    _many(widget, remote)
    wait(lambda: _is_drawn(widget), 120.0, "all have their places")
    widget.active.table.filter.setText("part17")
    widget.active.table.choose(["/part17/nodelet3"])
    QTest.qWait(1500)


def _narrow(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    widget.graph.bar.panel.trigger()
    wait(lambda: widget.graph.drawn.is_downwards, 20.0, "streams flow downwards")
    QTest.qWait(1500)


def _highlight(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    view = widget.graph.view
    QTest.qWait(300)
    view.scene().highlight("n_/nao1/subsampler")


def _load(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    """Two nodelets with much to do, one with an error, images of 40 MB/s, and an old ball."""
    busy, failing = "/nao1/subsampler", "/nao1/localization"
    remote.client.strains.update(
        {busy: (0.9, ""), "/nao1/line_detector": (0.6, ""), failing: (0.1, "no lines")}
    )
    remote.client.samples["/nao1/bottom_camera", "yuv"] = (0.1, 1_300_000)
    remote.client.samples[failing, "field_position"] = (2.5, 64)
    drawn = [widget.graph.view.scene().vertices[f"n_{each}"] for each in (busy, failing)]
    wait(lambda: all(each.strain.text for each in drawn), 10.0, "the load is shown")
    QTest.qWait(5000)  # rates are those of some seconds


def _hosts(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    """The robot, and the computer beside the field."""
    for nodelet in remote.graph().nodelets:
        remote.client.alter(nodelet.name, host=nodelet.name.split("/")[1])
    widget.graph.bar.choose("boxes", list(Boxes).index(Boxes.HOSTS))
    _tidy(widget)


def _connect(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    """A connection half drawn by hand, and the same in the panel."""
    widget.tabs.setCurrentWidget(widget.connect_)
    widget.connect_.begin("/field/ceiling_camera", "field_position")
    widget.connect_.begin("/field/tracker", "position")
    view = widget.graph.view
    QTest.qWait(300)
    start = view.place_of(PortRef("/field/ceiling_camera", "field_position"))
    end = view.place_of(PortRef("/field/tracker", "position"))
    if start is not None and end is not None:
        QTest.mousePress(view.viewport(), Qt.LeftButton, Qt.NoModifier, start)
        move = QMouseEvent(
            QEvent.MouseMove, QPointF(end), Qt.NoButton, Qt.LeftButton, Qt.NoModifier
        )
        QApplication.sendEvent(view.viewport(), move)


def _plan(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    """The plan of a stream whose last three nodelets are to be made again."""
    streams = widget.streams
    gone = ("/field/tracker", "/nao1/localization", "/nao1/line_detector")
    for name in gone:
        remote.client.destroy(name)
    wait(lambda: not any(map(widget.monitor.snapshot.nodelet, gone)), 10.0, "they are gone")
    widget.tabs.setCurrentWidget(streams)
    streams.tag.setText("Track(ball)")
    streams.exclude.setText("ceiling_camera")
    streams.preview.click()
    wait(lambda: "g_tracker" in widget.graph.view.scene().vertices, 10.0, "the plan is drawn")
    QTest.qWait(1000)


def _card(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    """The ball rolls back and forth."""
    card = widget.graph.card
    card.show_topic("/field/ball")
    for number in range(60):
        x = 1.5 * math.sin(number / 8)
        header = f"header:\n  seq: {900 + number}\n  stamp: 1732550400.25\n  frame_id: field\n"
        point = f"point:\n  x: {x:.6g}\n  y: 0.25\n  z: 0"
        numbers = {"point.x": x, "point.y": 0.25, "point.z": 0.0}
        remote.send("/field/ball", Sample(header + point, numbers, None, 45))
        QTest.qWait(80)
    card.place()


def _timeline(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    """The graph before some changes."""
    client, graph = remote.client, widget.graph
    every = graph.timeline.moments.all
    graph.bar.timeline.trigger()
    for change in (
        lambda: client.acquire_stream(StreamRequest("Track(ball)")),
        lambda: client.spawn("tracker", "/field/tracker_2", {"position": "/field/ball"}),
        lambda: client.set_config("/nao1/resize", {"image": "/nao1/bottom_camera/yuv"}),
        lambda: client.destroy("/nao1/recorder"),
    ):
        count = len(every)
        QTest.qWait(600)  # else it is the same moment
        change()
        wait(lambda count=count: len(every) > count, 10.0, "the change is noted")  # type: ignore[misc]
    graph.timeline.track.choose(every[0])
    drawn = graph.view.scene().vertices
    wait(lambda: "n_/field/tracker_2" not in drawn, 10.0, "the past is drawn")


def _gone(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    remote.client.is_up = False
    wait(lambda: " for 2 s" in widget.graph.sign.text(), 10.0, "the manager is missed")


def _dark(widget: DyKnowWidget, remote: SimulatedRemote) -> None:
    _highlight(widget, remote)
    widget.line.report(
        "connect /field/ceiling_camera:field_position with /nao1/line_detector:hsv: "
        "/field/ceiling_camera:field_position sends geometry_msgs/PointStamped, "
        "but /nao1/line_detector:hsv expects sensor_msgs/Image"
    )


#: Poses of a tree: the number of its nodelets, the size of the window.
_TREES = {_many: (500, (1366, 768)), _found: (500, (1366, 768)), _narrow: (30, (500, 768))}


if __name__ == "__main__":
    sys.exit(main())
