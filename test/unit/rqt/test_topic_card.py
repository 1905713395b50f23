# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The last message of a topic, as it is shown; its topic is heard only while it is shown."""

from __future__ import annotations

import io
import os
import threading

import numpy
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped
from python_qt_binding.QtCore import Qt
from python_qt_binding.QtWidgets import QToolButton
from sensor_msgs.msg import CompressedImage, Image, JointState
from unit.rqt.hands import centre_of, click, drag, until

from dyknow.errors import HostError
from dyknow.model.graph import State
from dyknow_rqt.graph.samples import HIGHEST, MOST_LINES, WIDEST, Sample, SmallImage, sample_of

BALL, YUV = "/field/ball", "/nao1/bottom_camera/yuv"


def size_of(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return len(buffer.getvalue())


def sampled(message):
    return sample_of(message, size_of(message))


def point(x):
    message = PointStamped()
    message.header.frame_id, message.point.x = "field", x
    return sampled(message)


def image(encoding, pixels):
    """An image of an array, rows first."""
    rows = numpy.ascontiguousarray(pixels)
    height, width = rows.shape[:2]
    step = rows.strides[0]
    return Image(height=height, width=width, encoding=encoding, step=step, data=rows.tobytes())


def place_on(view, topic, head):
    edge = next(e for e in view.scene().edges if (e.topic, e.head) == (topic, head))
    return view.mapFromScene(view.scene().edges[edge].path.pointAtPercent(0.5))


# A message as it is shown


def test_a_message_is_written_as_echo_does():
    sample = point(0.25)
    assert sample.text.splitlines() == [
        *("header:", "  seq: 0", "  stamp: 0.000000", "  frame_id: field"),
        *("point:", "  x: 0.25", "  y: 0", "  z: 0"),
    ]
    assert sample.numbers == {"point.x": 0.25, "point.y": 0.0, "point.z": 0.0}
    assert sample.size == 45 and sample.image is None


def test_long_parts_are_cut():
    joints = JointState(name=["j" * 500] * 1000, position=[0.5] * 1000)
    sample = sampled(joints)
    assert "(1000)" in sample.text and len(sample.numbers) == 12
    assert len(sample.text) < 3000
    values = [KeyValue(key="fan", value="on")] * 9
    status = DiagnosticArray(status=[DiagnosticStatus(values=values)] * 20)
    lines = sampled(status).text.splitlines()
    assert len(lines) == MOST_LINES + 1 and lines[-1] == "…" and "status: 20 of them" in lines


@pytest.mark.parametrize(
    ("encoding", "pixel", "seen"),
    [
        ("rgb8", [10, 20, 30], [10, 20, 30]),
        ("bgr8", [10, 20, 30], [30, 20, 10]),
        ("bgra8", [10, 20, 30, 0], [30, 20, 10]),
        ("8UC3", [10, 20, 30], [30, 20, 10]),
        ("mono8", [10], [10, 10, 10]),
        ("yuv422", [128, 77], [77, 77, 77]),
        ("bayer_rggb8", [9], [9, 9, 9]),
    ],
)
def test_an_image_is_reduced_and_keeps_its_colours(encoding, pixel, seen):
    pixels = numpy.empty((480, 640, len(pixel)), numpy.uint8)
    pixels[:] = pixel
    found = sampled(image(encoding, pixels)).image
    assert found.note == f"640 × 480 {encoding}"
    assert found.width <= WIDEST and found.height <= HIGHEST
    assert len(found.data) == 3 * found.width * found.height
    assert list(found.data[:3]) == list(found.data[-3:]) == seen


@pytest.mark.parametrize(
    ("encoding", "kind"),
    [
        ("16UC1", numpy.uint16),
        ("16SC1", numpy.int16),
        ("32SC1", numpy.int32),
        ("32FC1", numpy.float32),
        ("64FC1", numpy.float64),
        ("mono16", numpy.uint16),
        ("bayer_rggb16", numpy.uint16),
    ],
)
def test_distances_are_spread_over_all_greys(encoding, kind):
    start = -500 if encoding.startswith(("16S", "32S")) else 500
    distances = numpy.linspace(start, 3000, 300).astype(kind)[None, :].repeat(200, 0)
    if numpy.issubdtype(kind, numpy.floating):
        distances[0] = numpy.nan
    found = sampled(image(encoding, distances)).image
    greys = numpy.frombuffer(found.data, numpy.uint8).reshape(found.height, found.width, 3)[
        1, :, 0
    ]
    assert greys[0] == 0 and greys[-1] > 250 and (numpy.diff(greys.astype(int)) >= 0).all()


def test_an_image_that_cannot_be_read_says_so():
    pixels = numpy.zeros((4, 4, 3), numpy.uint8)
    for message in (image("rgb8", pixels), image("rgb8", pixels)):
        message.data = message.data[:7]
        assert sampled(message).image.note.endswith("cannot be shown")
    for unknown in ("rgb16", "8FC1", "nv21"):
        assert sampled(image(unknown, pixels)).image.note.endswith("cannot be shown")
    assert sampled(Image()).image is None
    assert sampled(CompressedImage(format="jpeg", data=b"no")).image.data == b"no"


# The card


def test_a_click_on_an_arrow_shows_its_last_message(qtbot, window, remote):
    view, card = window.graph.view, window.graph.card
    qtbot.mouseClick(view.viewport(), Qt.LeftButton, pos=place_on(view, BALL, "n_/field/tracker"))
    assert card.isVisible() and card.topic == BALL and "no message yet" in card.facts.text()
    until(qtbot, lambda: remote.listeners.get(BALL))
    for number in range(5):
        remote.send(BALL, point(number))
    until(qtbot, lambda: "x: 4" in card.text.toPlainText())
    assert [value for _, value in card.curve.points] == [0, 1, 2, 3, 4]
    card.field.setCurrentText("point.y")
    remote.send(BALL, point(7))
    until(qtbot, lambda: "x: 7" in card.text.toPlainText())
    assert [value for _, value in card.curve.points] == [0]
    until(qtbot, lambda: "Hz" in card.facts.text() and "B/s" in card.facts.text())
    assert "45 B each" in card.facts.text() and " s ago" in card.facts.text()
    assert view.viewport().rect().contains(card.geometry())


def test_keys_in_the_card_do_nothing_to_the_drawing(qtbot, window, remote, view):
    card = window.graph.card
    place = place_on(view, BALL, "n_/field/tracker")
    for close, key in ((card.text, Qt.Key_Escape), (card.findChild(QToolButton), Qt.Key_Return)):
        qtbot.mouseClick(view.viewport(), Qt.LeftButton, pos=place)
        until(qtbot, lambda: remote.listeners.get(BALL))
        remote.send(BALL, point(1))
        until(qtbot, card.text.isVisible)
        before = window.selection.edges, view.zoom
        assert before[0]
        card.text.setFocus()
        for other in (Qt.Key_Delete, Qt.Key_Plus, Qt.Key_Return, Qt.Key_Up):
            qtbot.keyClick(card.text, other)
        assert (window.selection.edges, view.zoom) == before and card.isVisible()
        assert not window.monitor.is_changing
        close.setFocus()
        qtbot.keyClick(close, key)
        assert not card.isVisible()


def test_the_card_stays_in_a_view_that_becomes_smaller(window):
    view, card = window.graph.view, window.graph.card
    card.show_topic(BALL)
    for size in ((1400, 800), (640, 480), (900, 700)):
        window.resize(*size)
        window.grab()  # which lays it out
        assert view.viewport().rect().contains(card.geometry())


def test_what_an_ordinary_node_publishes_has_the_rate_of_its_sink(qtbot, window, remote):
    window.graph.card.show_topic("/nao1/joint_states")
    until(qtbot, lambda: "50 Hz" in window.graph.card.facts.text())


@pytest.fixture
def send(qtbot, window, remote):
    """A function that sends a message, and waits until the card, which is open, shows it."""
    card = window.graph.card
    card.show_topic(BALL)
    until(qtbot, lambda: remote.listeners.get(BALL))

    def sent(text, image=None, **numbers):
        remote.send(BALL, Sample(text, numbers, image, 8))
        until(qtbot, lambda: card.text.toPlainText() == text)

    return sent


def test_the_curve_goes_on_while_other_numbers_come_and_go(window, send):
    card = window.graph.card
    for number in range(6):
        send(f"{number}", x=float(number), **({"y": 1.0} if number % 2 else {}))
    assert [value for _, value in card.curve.points] == [0, 1, 2, 3, 4, 5]
    send("6", y=7.0)
    assert [value for _, value in card.curve.points] == [0, 1, 2, 3, 4, 5]
    card.field.setCurrentText("y")
    send("7", x=7.0)
    send("8", x=8.0, y=8.0, z=8.0)
    assert [value for _, value in card.curve.points] == [8] and card.field.currentText() == "y"


def test_a_curve_and_an_image_are_shown_from_the_first_that_comes_on(window, send):
    card, places = window.graph.card, []
    send("nan")
    assert not card.curve.isVisible() and not card.field.isVisible()
    place, card.place = card.place, lambda: places.append(place())
    send("1", data=1.0)
    assert card.curve.isVisible() and card.field.isVisible() and len(places) == 1
    send("nan again")
    assert card.curve.isVisible() and len(places) == 1
    send("image", SmallImage(1, 1, b"rgb", "tiny"))
    assert card.image.isVisible() and not card.curve.isVisible() and len(places) == 2


def test_it_listens_only_while_it_is_shown(qtbot, window, remote):
    view, card = window.graph.view, window.graph.card
    for close in (
        lambda: qtbot.keyClick(view, Qt.Key_Escape),
        lambda: view.topic_pressed.emit(""),
        lambda: window.shut_down(),
    ):
        qtbot.mouseClick(view.viewport(), Qt.LeftButton, pos=centre_of(view, f"t_{BALL}"))
        until(qtbot, lambda: remote.listeners.get(BALL))
        close()
        assert not card.isVisible()
        until(qtbot, lambda: not any(remote.listeners.values()))


def test_it_listens_to_all_nodes_that_publish(qtbot, window, remote):
    card, topic = window.graph.card, "/nao1/bottom_camera/yuv"
    remote.client.alter("/nao1/top_camera", manager="/another")
    remote.client.connect([("/nao1/top_camera", {"yuv": topic})])
    until(qtbot, lambda: len(window.monitor.snapshot.topics()[topic].sources) == 2)
    card.show_topic(topic)
    until(qtbot, lambda: len(remote.listeners.get(topic, ())) == 2)
    nodes = {
        window.monitor.snapshot.nodelet(f"/nao1/{side}_camera").node for side in ("top", "bottom")
    }
    assert len(nodes) == 2 and all(node in card.facts.toolTip() for node in nodes)
    card.show_topic("")
    until(qtbot, lambda: not remote.listeners[topic])


def test_it_tries_again_when_it_could_not_listen(qtbot, window, remote):
    card, begin, tried = window.graph.card, remote.follow, []

    def follow(*given):
        tried.append(given)
        if len(tried) == 1:
            raise HostError("messages of type '' are not known here")
        return begin(*given)

    remote.follow = follow
    card._again.setInterval(0)
    card.show_topic(BALL)
    until(qtbot, lambda: remote.listeners.get(BALL))
    until(qtbot, lambda: "no message yet" in card.facts.text())
    assert len(tried) == 2
    remote.send(BALL, point(1))
    until(qtbot, lambda: "x: 1" in card.text.toPlainText())


def test_one_that_is_closed_before_it_listens_does_not_begin(window, remote, qtbot):
    card, begin, begun = window.graph.card, remote.follow, threading.Event()
    go_on = threading.Event()

    def follow(*given):
        begun.set()
        go_on.wait(60.0)
        return begin(*given)

    remote.follow = follow
    card.show_topic(BALL)
    assert begun.wait(60.0)
    window.shut_down()
    go_on.set()
    until(qtbot, lambda: remote.listeners.get(BALL) == [])


def test_another_click_shows_another_topic_and_an_image_as_one(qtbot, window, remote):
    view, card = window.graph.view, window.graph.card
    drag(view, centre_of(view, f"t_{BALL}"), centre_of(view, f"t_{BALL}") * 0.8)
    assert not card.isVisible(), "a drag is no click"
    qtbot.mouseClick(view.viewport(), Qt.LeftButton, pos=centre_of(view, f"t_{BALL}"))
    until(qtbot, lambda: remote.listeners.get(BALL))
    view.select(view.scene().vertices[f"t_{YUV}"])
    qtbot.keyClick(view, Qt.Key_Return)
    until(qtbot, lambda: remote.listeners.get(YUV))
    until(qtbot, lambda: not remote.listeners[BALL])
    assert card.topic == YUV
    pixels = numpy.zeros((480, 640, 3), numpy.uint8)
    remote.send(YUV, sampled(image("bgr8", pixels)))
    until(qtbot, card.image.isVisible)
    assert not card.curve.isVisible() and card.image.pixmap().width() <= WIDEST
    remote.send(YUV, sample_of(CompressedImage(format="jpeg", data=b"no"), 2))
    until(qtbot, lambda: card.image.text() == "jpeg")


def test_it_follows_the_node_that_publishes(qtbot, window, remote):
    window.graph.card.show_topic(BALL)
    until(qtbot, lambda: remote.listeners.get(BALL))
    remote.client.alter("/nao1/localization", state=State.LOST, detail="gone")
    until(qtbot, lambda: not remote.listeners[BALL])
    assert window.graph.card.facts.text() == "nothing publishes it"
    remote.client.alter("/nao1/localization", state=State.RUNNING, detail="")
    until(qtbot, lambda: remote.listeners[BALL])


def test_programs_that_are_there_open_the_topic(qtbot, window, remote, tmp_path, monkeypatch):
    program, said = tmp_path / "rqt_plot", tmp_path / "said"
    program.write_text(f'#!/bin/sh\necho "$@" > {said}.new; mv {said}.new {said}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    card = window.graph.card
    card.show_topic(BALL)
    until(qtbot, lambda: remote.listeners.get(BALL))
    remote.send(BALL, point(1))
    until(qtbot, lambda: card.field.count() == 3)
    menu = card.open_in.menu()
    menu.aboutToShow.emit()
    entries = {action.text(): action for action in menu.actions()}
    assert list(entries) == ["rqt_plot", "rostopic echo"]
    assert entries["rqt_plot"].isEnabled()
    entries["rqt_plot"].trigger()
    until(qtbot, said.exists)
    assert said.read_text() == f"{BALL}/point/x\n"
    click(qtbot, next(b for b in card.findChildren(type(card.open_in)) if b.text() == "×"))
    assert not card.isVisible()
