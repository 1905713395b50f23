# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``make screenshots``: takes the pictures of the documentation, from a made-up graph.

It needs neither a screen nor ROS processes.
"""

from __future__ import annotations

import math
import os
import sys
import time
from functools import partial
from typing import Callable, List, Optional, Sequence, Sized

from python_qt_binding.QtCore import QEvent, QPointF, Qt
from python_qt_binding.QtGui import QColor, QFontDatabase, QMouseEvent, QPalette
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication, QStyleFactory

from dyknow.model.graph import PortRef
from dyknow.model.streams import StreamRequest
from dyknow_rqt.example_graphs import soccer, tree
from dyknow_rqt.graph.figure import Boxes
from dyknow_rqt.graph.samples import Sample
from dyknow_rqt.simulated import SimulatedRemote
from dyknow_rqt.window import DyKnowWidget


def dressed(application: QApplication) -> QApplication:
    """Make the application look the same on every machine, and return it."""
    application.setStyle(QStyleFactory.create("Fusion"))
    application.setFont(_font())
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


def main(argv: Optional[List[str]] = None) -> int:
    """Take all pictures into the folder that is given; returns the exit code.

    A second argument such as ``1366x768`` is the size of the window.
    """
    words = list(argv if argv is not None else sys.argv)
    folder = words[1] if words[1:] else os.path.join("doc", "images")
    size = [int(part) for part in (words[2] if words[2:] else "1600x760").split("x")]
    os.makedirs(folder, exist_ok=True)
    application = dressed(QApplication(words[:1]))
    light = QPalette(application.palette())
    for name, palette, pose in (
        ("graph", light, _pose_graph),
        ("highlight", light, _pose_highlight),
        ("nodelets_only", light, _pose_nodelets_only),
        ("hosts", light, _pose_hosts),
        ("library", light, _pose_library),
        ("create", light, _pose_create),
        ("connect", light, _pose_connect),
        ("plan", light, _pose_plan),
        ("card", light, _pose_card),
        ("timeline", light, _pose_timeline),
        ("gone", light, _pose_gone),
        ("dark", dark_palette(), _pose_dark),
    ):
        application.setPalette(palette)
        _take(os.path.join(folder, f"gui_{name}.png"), soccer(), pose, size)
    for name, count, pose, size in (
        ("many", 500, _pose_many, [1366, 768]),
        ("found", 500, _pose_found, [1366, 768]),
        ("narrow", 30, _pose_narrow, [500, 768]),
    ):
        application.setPalette(light)
        _take(os.path.join(folder, f"gui_{name}.png"), tree(count), pose, size)
    return 0


def _take(
    path: str, remote: SimulatedRemote, pose: Callable[[DyKnowWidget], None], size: Sequence[int]
) -> None:
    widget = DyKnowWidget(remote)
    widget.resize(*size)
    widget.show()
    widget.start()
    try:
        wait(lambda: len(widget.graph.drawn.vertices) > 15, 20.0, "the graph is drawn")
        wait(lambda: widget.monitor.library, 10.0, "the library is there")
        if remote.client.rates:
            wait(lambda: _has_rates(widget), 20.0, "the rates are there")
        pose(widget)
        QTest.qWait(300)
        print(f"screenshots: {path}")
        if not widget.grab().save(path):
            raise OSError(f"cannot write '{path}'")
    finally:
        widget.shut_down()
        widget.close()
        widget.deleteLater()
        QTest.qWait(50)


def _has_rates(widget: DyKnowWidget) -> bool:
    traffic = [item.traffic for item in widget.graph.view.scene().edges.values()]
    return any(each is not None and each.drop_rate > 0 for each in traffic)


def _tidy(widget: DyKnowWidget) -> None:
    QTest.qWait(500)
    widget.graph.tidy()
    QTest.qWait(500)


def _pose_graph(widget: DyKnowWidget) -> None:
    widget.graph.bar.choose("nodes", 1)
    wait(lambda: len(widget.graph.drawn.vertices) > 20, 10.0, "nodes are shown")
    _tidy(widget)
    widget.active.table.choose(["/nao1/ball_detector"])


def _pose_many(widget: DyKnowWidget) -> None:
    wait(lambda: len(widget.graph.drawn.vertices) == 1000, 20.0, "all are drawn")


def _pose_found(widget: DyKnowWidget) -> None:
    _pose_many(widget)
    widget.active.table.filter.setText("part17")
    widget.active.table.choose(["/part17/nodelet3"])
    QTest.qWait(1500)


def _pose_narrow(widget: DyKnowWidget) -> None:
    widget.graph.bar.panel.trigger()
    wait(lambda: widget.graph.drawn.is_downwards, 20.0, "streams flow downwards")
    QTest.qWait(1500)


def _pose_highlight(widget: DyKnowWidget) -> None:
    view = widget.graph.view
    QTest.qWait(300)
    view.scene().highlight("n_/nao1/subsampler")


def _pose_nodelets_only(widget: DyKnowWidget) -> None:
    widget.graph.bar.choose("mode", 1)
    _tidy(widget)


def _pose_hosts(widget: DyKnowWidget) -> None:
    """The robot, and the computer beside the field."""
    remote = widget.monitor.remote
    assert isinstance(remote, SimulatedRemote)
    for nodelet in remote.graph().nodelets:
        remote.client.alter(nodelet.name, host=nodelet.name.split("/")[1])
    widget.graph.bar.choose("boxes", list(Boxes).index(Boxes.HOSTS))
    _tidy(widget)


def _pose_library(widget: DyKnowWidget) -> None:
    widget.tabs.setCurrentWidget(widget.library)
    widget.library.table.choose(["ball_detector"])


def _pose_create(widget: DyKnowWidget) -> None:
    widget.tabs.setCurrentWidget(widget.create_)
    widget.create_.begin("ball_detector")
    widget.create_.given.fields["?robot"].setText("nao1")


def _pose_connect(widget: DyKnowWidget) -> None:
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


def _pose_plan(widget: DyKnowWidget) -> None:
    """The plan of a stream whose last three nodelets are to be made again."""
    remote, streams = widget.monitor.remote, widget.streams
    assert isinstance(remote, SimulatedRemote)
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


def _pose_card(widget: DyKnowWidget) -> None:
    """The ball rolls back and forth."""
    remote, card = widget.monitor.remote, widget.graph.card
    assert isinstance(remote, SimulatedRemote)
    card.show_topic("/field/ball")
    for number in range(60):
        x = 1.5 * math.sin(number / 8)
        lines = [
            "header:",
            f"  seq: {900 + number}",
            "  stamp: 1732550400.25",
            "  frame_id: field",
        ]
        lines += ["point:", f"  x: {x:.6g}", "  y: 0.25", "  z: 0"]
        numbers = {"point.x": x, "point.y": 0.25, "point.z": 0.0}
        remote.send("/field/ball", Sample("\n".join(lines), numbers, None, 45))
        QTest.qWait(80)
    card.place()


def _pose_timeline(widget: DyKnowWidget) -> None:
    """The graph before some changes."""
    remote, graph = widget.monitor.remote, widget.graph
    assert isinstance(remote, SimulatedRemote)
    client, every = remote.client, graph.timeline.moments.all
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
        wait(partial(_is_longer, every, count), 10.0, "the change is noted")
    graph.timeline.track.choose(every[0])
    drawn = graph.view.scene().vertices
    wait(lambda: "n_/field/tracker_2" not in drawn, 10.0, "the past is drawn")
    wait(lambda: graph.layouter.is_idle, 10.0, "all of it")


def _is_longer(every: Sized, count: int) -> bool:
    return len(every) > count


def _pose_gone(widget: DyKnowWidget) -> None:
    remote = widget.monitor.remote
    assert isinstance(remote, SimulatedRemote)
    remote.client.is_up = False
    wait(lambda: " for 2 s" in widget.graph.sign.text(), 10.0, "the manager is missed")


def _pose_dark(widget: DyKnowWidget) -> None:
    _pose_highlight(widget)
    widget.line.report(
        "connect /field/ceiling_camera:field_position with /nao1/line_detector:hsv: "
        "/field/ceiling_camera:field_position sends geometry_msgs/PointStamped, "
        "but /nao1/line_detector:hsv expects sensor_msgs/Image"
    )


def _font() -> object:
    font = QFontDatabase.systemFont(QFontDatabase.GeneralFont)
    font.setFamily("DejaVu Sans")
    font.setPointSize(9)
    return font


if __name__ == "__main__":
    sys.exit(main())
