#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window, with a DyKnow manager in another process.

With DYKNOW_PICTURES the picture of the documentation is written into that folder.
"""

from __future__ import annotations

import os
import re
import signal
import sys
from pathlib import Path
from typing import Any, Callable

os.environ["QT_QPA_PLATFORM"] = "offscreen"

import rospy
import rostest
from graph import Battery, Heard
from manager_suite import LIBRARY, ManagerCase, MasterCase
from processes import HELD_UP
from python_qt_binding.QtCore import QPoint, Qt
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication, QMenu
from unit.rqt.hands import drag

from dyknow.model.graph import PortRef, SpawnRequest
from dyknow.model.streams import StreamStatus
from dyknow.ros.wire.master import Master
from dyknow_rqt import screenshots
from dyknow_rqt.graph.changes import Change, spawn
from dyknow_rqt.graph.snapshot import difference
from dyknow_rqt.graph.wiring import connect, connect_topic
from dyknow_rqt.monitoring.ros_remote import RosRemote
from dyknow_rqt.window import DyKnowWidget

OUT, IN = PortRef("/count", "out"), PortRef("/relay", "in")
#: Where to write the picture; empty for nowhere.
PICTURES = os.environ.get("DYKNOW_PICTURES", "")
EXAMPLES = Path(__file__).resolve().parent.parent.parent / "examples"


def until(condition: Callable[[], object], what: str) -> None:
    """Process the window's events until something holds."""
    screenshots.wait(condition, HELD_UP, what)


class Window:
    """Opens windows, and works with the last one."""

    def open(self: Any) -> DyKnowWidget:
        self.window = DyKnowWidget(RosRemote())
        self.monitor, self.scene = self.window.monitor, self.window.graph.view.scene()
        self.addCleanup(self.window.shut_down)
        self.refusals: list[str] = []
        self.monitor.failed.connect(self.refusals.append)
        self.window.resize(1600, 760)
        self.window.show()
        self.window.start()
        return self.window

    def topic(self: Any, ref: PortRef) -> object:
        """The topic of a port; None while it is not known."""
        port = self.monitor.snapshot.port(ref)
        return None if port is None else port.topic

    def does(
        self: Any, act: Callable[[], object], effect: Callable[[], object], what: str
    ) -> None:
        """Act when the manager answers, until it has an effect.

        A window that a busy machine has starved takes the manager for a silent one, and refuses.
        """
        self.refusals.clear()
        while not effect():
            while self.refusals:
                self.assertIn("silent", self.refusals.pop())
            until(lambda: self.monitor.is_linked, "the manager answers")
            act()
            until(lambda: effect() or self.refusals, what)
        until(lambda: not self.monitor.is_changing, "the change has ended")


class WindowTest(Window, ManagerCase):
    def test_the_window_waits_for_a_manager_and_changes_its_graph(self) -> None:
        self.end_idle()
        window = self.open()
        monitor, scene, sign = self.monitor, self.scene, window.graph.sign
        until(lambda: sign.text() == "waiting for /dyknow_manager", "it says that nobody is there")
        manager = self.started()
        until(lambda: "No nodelets yet" in sign.text(), "the manager is found")
        until(lambda: "counter" in window.library.table.names(), "the library is shown")

        def do(change: Callable[[], Change], effect: Callable[[], object], what: str) -> None:
            self.does(lambda: monitor.do(change()), effect, what)

        for label, name in (("counter", "/count"), ("relay", "/relay")):
            request = SpawnRequest(label, name)
            do(
                lambda request=request: spawn(request),
                lambda name=name: f"n_{name}" in scene.vertices,
                f"{name} is drawn",
            )
        until(lambda: None not in (self.topic(OUT), self.topic(IN)), "their ports are known")
        do(
            lambda: connect(monitor.snapshot, OUT, IN),
            lambda: self.topic(IN) == self.topic(OUT) == "/count/out",
            "they are connected",
        )

        def rates(end: str) -> list[float]:
            """Those of the arrows to ("head") or from ("tail") the relay."""
            arrows = [item for e, item in scene.edges.items() if getattr(e, end) == "n_/relay"]
            return [item.traffic.rate for item in arrows if item.traffic is not None]

        until(lambda: any(25 < rate < 75 for rate in rates("head")), "the rate is on the arrow")
        out = PortRef("/relay", "out")
        do(
            lambda: connect_topic(monitor.snapshot, out, "/end"),
            lambda: self.topic(out) == "/end",
            "it is connected",
        )
        heard = self.enter(Heard("/end"))
        until(lambda: len(heard) > 5, "messages flow through what was connected")

        until(lambda: any(rates("tail")), "its rate is shown")
        arrow = next(item for e, item in scene.edges.items() if e.tail == "n_/relay")
        over = next(item for e, item in scene.edges.items() if e.tail == "n_/count")
        self.assertIn("connections: 1 within the process", scene.facts.tip_of(over))
        window.graph._ask_transports({monitor.snapshot.nodelet("/relay").node})
        outside = re.compile(r"connections: 1 (SHMROS|TCPROS)$")
        until(lambda: outside.search(scene.facts.tip_of(arrow)), "the transport of the subscriber")
        with manager.child_stopped():
            until(lambda: not rates("tail"), "a process that stands still has no rate")
        until(lambda: any(rates("tail")), "it goes on")
        manager.client.set_config("/count", {"out": ""})
        until(lambda: rates("tail") == [0.0], "nothing is sent any more")
        window.graph.bar.choose("debug", 0)  # this node is named like rqt's
        window.graph.bar.choose("nodes", 1)
        me = f"p_{rospy.get_name()}"
        until(lambda: me in scene.vertices, "the listening node is shown")
        self.does(monitor.undo, lambda: self.topic(out) == "", "the connection is taken back")

    def test_the_ball_is_asked_for_and_followed(self) -> None:
        manager = self.make(ontologies=[str(EXAMPLES / "ontologies" / "soccer.ttl")])
        manager.start()
        battery = self.enter(Battery(0.5, "/nao/battery"))
        window = self.open()
        panel, scene = window.streams, self.scene
        soccer = str(EXAMPLES / "transformations" / "soccer.xml")
        self.does(
            lambda: window.library.import_file(soccer),
            lambda: "bottom_camera" in window.library.table.names(),
            "the library is there",
        )
        window.tabs.setCurrentWidget(panel)
        QTest.keyClicks(panel.tag, "FieldPosition(ball)")
        self.does(
            lambda: QTest.keyClick(panel.tag, Qt.Key_Return),
            lambda: "bottom_camera.image  2  new" in panel.plan.text,
            "the plan is shown",
        )
        self.assertEqual(self.monitor.snapshot.nodelets, ())

        def is_active() -> bool:
            states = {each.tag: each.state.name for each in self.monitor.streams}
            return states == {"FieldPosition(ball)": "ACTIVE", "Holds(charged, nao)": "ACTIVE"}

        def asked() -> StreamStatus:
            return next(each for each in self.monitor.streams if each.tag == "FieldPosition(ball)")

        def arrow(verdict: str) -> Any:
            """The arrow of the formula, once it shows a verdict."""
            arrows = [item for edge, item in scene.edges.items() if edge.tail == "n_/charged_1"]
            return next((item for item in arrows if verdict in item.label), None)

        def traffic() -> list:
            return [item.traffic for item in scene.edges.values()]

        self.does(
            lambda: QTest.mouseClick(panel.acquire, Qt.LeftButton),
            is_active,
            "the stream is there",
        )
        stream = asked()
        until(lambda: f"t_{stream.topic}" in scene.vertices, "it is drawn")
        until(lambda: all(each and each.rate > 1.0 for each in traffic()), "all of it flows")
        until(lambda: any(each and each.bandwidth for each in traffic()), "sizes are known")
        until(lambda: arrow("TRUE"), "the battery is charged")
        self.assertEqual(arrow("TRUE").stroke().color(), arrow("TRUE").colours.true)

        def is_selected() -> bool:
            panel.table.choose([stream.claim_id])
            return {item.vertex.name for item in scene.selectedItems()} == {*stream.nodelets}

        until(is_selected, "its nodelets are selected")
        picture = window.grab().toImage()
        right = range(picture.width() // 2, picture.width(), 7)
        colours = {picture.pixel(x, y) for x in right for y in range(100, picture.height(), 7)}
        self.assertGreater(len(colours), 20)  # it is not empty
        if PICTURES:
            until(lambda: not any(each.drop_rate for each in traffic()), "the beginning is over")
            window.graph.tidy()
            QTest.qWait(1000)
            window.grab().save(os.path.join(PICTURES, "gui_streams.png"))

        battery.percentage = 0.19
        until(lambda: arrow("FALSE"), "the battery is flat")
        self.assertEqual(arrow("FALSE").stroke().color(), arrow("FALSE").colours.false)
        flat = r"FALSE since \d+\.\d{3}\nbattery\.percentage = 0\.19 at \d"
        self.assertRegex(scene.facts.tip_of(arrow("FALSE")), rf"Holds\(charged, nao\): {flat}")
        until(lambda: any("ceiling_camera" in key for key in scene.vertices), "the other camera")
        until(
            lambda: is_active() and not any("bottom_camera" in name for name in asked().nodelets),
            "its stream has taken over",
        )
        self.assertEqual(asked().topic, stream.topic)

        def mended() -> set[tuple[str, str]]:
            every = window.graph.timeline.moments.all
            pairs = [difference(*pair).mended for pair in zip(every, list(every)[1:])]
            return {(was[:-2], now[:-2]) for found in pairs for was, now in found}

        until(lambda: any("ceiling_camera" in now for _, now in mended()), "it says so")
        reason = "/bottom_camera_1 is not available: Holds(charged, nao) is FALSE since"
        until(lambda: reason in panel.events.toPlainText(), "the event is shown")

        def release() -> None:
            panel.table.choose([stream.claim_id])
            QTest.mouseClick(panel.release, Qt.LeftButton)

        self.does(release, lambda: not panel.table.names(), "the stream is released")

    def test_the_last_message_of_a_topic_is_shown_while_its_card_is_open(self) -> None:
        manager = self.started()
        manager.client.spawn("counter", "/count", {"out": "/numbers"})
        card, view = self.open().graph.card, self.window.graph.view
        until(lambda: "t_/numbers" in self.scene.vertices, "it is drawn")
        until(lambda: not self.scene.slices.is_wanted(self.scene._draw), "all of it")
        place = view.mapFromScene(self.scene.vertices["t_/numbers"].pos())
        QTest.mouseClick(view.viewport(), Qt.LeftButton, Qt.NoModifier, place)
        until(lambda: len(card.curve.points) > 3, "numbers come")
        values = [value for _, value in card.curve.points]
        self.assertEqual(values, sorted(set(values)))
        until(lambda: re.search(r"Hz · .*B/s · \d+ B each", card.facts.text()), "and how much")
        master, node = Master("/test"), self.monitor.snapshot.nodelet("/count").node
        uri = master.node(node)
        self.assertEqual(len(master.connections(uri, "/numbers", 2.0)), 1)
        QTest.keyClick(view, Qt.Key_Escape)
        until(lambda: not master.connections(uri, "/numbers", 2.0), "it is heard no more")

    def test_wires_make_nodelets_splice_them_and_nodelets_stay_where_they_are_put(self) -> None:
        manager = self.started()
        manager.client.spawn("counter", "/count")
        window, scene = self.open(), self.scene
        view = window.graph.view

        def topic(nodelet: str, port: str) -> object:
            return self.topic(PortRef(nodelet, port))

        def at(ref: PortRef) -> QPoint:
            until(lambda: view.place_of(ref) and window.graph.layouter.is_idle, "it is drawn")
            view.fit()
            return view.place_of(ref)

        def choose(text: str) -> None:
            menus = [menu for menu in window.graph.findChildren(QMenu) if menu.isVisible()]
            (action,) = [each for menu in menus for each in menu.actions() if each.text() == text]
            action.trigger()
            menus[0].close()

        until(lambda: "relay" in self.monitor.library, "the library is there")
        drag(view, at(OUT), QPoint(view.viewport().width() - 90, view.viewport().height() - 90))
        choose("relay: in")
        until(lambda: topic("/relay", "in") == topic("/count", "out") == "/count/out", "made")
        put = window.graph.edits.places.present["n_/relay"]
        until(lambda: "n_/relay" in scene.vertices and window.graph.layouter.is_idle, "drawn")
        place = scene.vertices["n_/relay"].pos()
        self.assertEqual((place.x(), place.y()), tuple(put))
        manager.client.spawn("relay", "/second")
        end = at(PortRef("/second", "in"))
        edge = next(each for each in scene.edges if each.head == "n_/relay")
        drag(view, end, view.mapFromScene(scene.edges[edge].path.pointAtPercent(0.5)))
        until(lambda: topic("/relay", "in") == topic("/second", "out") != "", "it is spliced in")
        self.assertEqual(topic("/second", "in"), "/count/out")
        heard = self.enter(Heard("/end"))
        manager.client.set_config("/relay", {"out": "/end"})
        until(lambda: len(heard) > 5, "messages flow through both")


class DeadSystemTest(Window, MasterCase):
    """Everything that can go away does so."""

    def test_the_window_says_what_is_dead_and_finds_what_comes_back(self) -> None:
        window = self.open()
        sign, contact = window.graph.sign, window.line.contact

        def says(words: str, on_sign: str = "") -> None:
            until(lambda: words in contact.text() and (on_sign or words) in sign.text(), words)

        def is_drawn(name: str) -> None:
            until(lambda: f"n_{name}" in self.scene.vertices and self.monitor.is_linked, name)

        def is_grey() -> bool:
            colours = self.scene.vertices["n_/count"].colours
            return colours.text == colours.muted

        says(f"no ROS master at {self.uri}")
        core = self.roscore()
        says("waiting for /dyknow_manager")
        manager = self.manager("_orphan_timeout:=1.0")
        until(lambda: "/dyknow_manager answers since" in contact.text(), "it answers")
        self.client.add_transformation(LIBRARY)
        self.client.spawn("counter", "/count", {"out": "/numbers"})
        is_drawn("/count")

        manager.stop(signal.SIGSTOP)
        says("⚠ /dyknow_manager silent for")
        until(is_grey, "what it shows is old")
        manager.stop(signal.SIGCONT)
        until(lambda: not sign.isVisible() and not is_grey(), "it answers again")

        self.kill(core)
        says(f"⚠ no ROS master at {self.uri}", "/dyknow_manager answers")
        self.assertFalse(is_grey())
        self.roscore()
        until(lambda: not sign.isVisible(), "the manager has registered with the new master")
        self.assertFalse(is_grey())
        self.kill(manager)
        says("⚠ /dyknow_manager gone for")
        until(is_grey, "what it shows is old")

        self.manager("_orphan_timeout:=1.0")
        until(lambda: not sign.isVisible(), "the next manager is found")
        self.client.spawn("counter", "/another", {"out": "/numbers"})
        is_drawn("/another")
        until(lambda: len(readers_of_the_model()) == 1, "one window reads")
        self.assertNotIn("rqt", str(Master("/test").ask("getSystemState")))
        window.shut_down()
        until(lambda: not readers_of_the_model(), "the window has left")


def readers_of_the_model() -> set[int]:
    """Ports of the subscribers of the manager's model."""
    master = Master("/test")
    uri = master.node("/dyknow_manager")
    return master.connections(uri, "/dyknow_manager/model", 2.0) if uri else set()


if __name__ == "__main__":
    rospy.init_node("rqt_window")
    application = screenshots.dressed(QApplication(sys.argv[:1]))
    rostest.rosrun("dyknow", "rqt_window", "__main__", sys.argv)
