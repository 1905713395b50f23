# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connecting two ports: the topic, the checks, the order, and undoing."""

from __future__ import annotations

import pytest
from unit.cli.fake_client import play, run

from dyknow.errors import HostError
from dyknow.wiring.ports import types_fit

#: With a camera and a relay, and an ordinary node that publishes on /lidar/scan.
SESSIONS = {
    "ports": """
$ connect cam:image robot/relay:in
/cam:image -> /cam/image -> /robot/relay:in
$ connect cam:image robot/relay:in
/cam:image -> /cam/image -> /robot/relay:in (as it was)
$ disconnect cam:image robot/relay:in robot/relay:out cam:image
/cam:image has left /cam/image
/robot/relay:in has left /cam/image
/robot/relay:out was not connected
$ graph
(disconnected)
    out  /cam:image
    in   /robot/relay:in
    out  /robot/relay:out
$ connect cam:image robot/relay:in --topic raw
/cam:image -> /raw -> /robot/relay:in
""",
    "topics": """
$ connect raw robot/relay:in
/raw -> /robot/relay:in
dyknow: warning: connected, but no node publishes on '/raw' yet
$ connect /lidar/scna robot/relay:in
/lidar/scna -> /robot/relay:in
dyknow: warning: connected, but no node publishes on '/lidar/scna' yet; did you mean /lidar/scan?
$ connect /lidar/scan robot/relay:in
/lidar/scan -> /robot/relay:in
$ connect cam:image /raw
/cam:image -> /raw
$ connect /raw robot/relay:in
/raw -> /robot/relay:in
""",
}


@pytest.mark.parametrize("name", SESSIONS)
def test_sessions(pair, name):
    pair.ordinary.add("/lidar/scan")
    play(pair, SESSIONS[name])


def topics(client):
    return {
        f"{nodelet.name}:{port.name}": port.topic
        for nodelet in client.get_graph().nodelets
        for port in nodelet.ports
        if port.topic
    }


def test_a_port_that_is_connected_keeps_its_topic(pair):
    image, into = {"nodelet": "/cam", "port": "image"}, {"nodelet": "/robot/relay", "port": "in"}
    pair.set_config("/robot/relay", {"in": "/old"})
    assert run(pair, "connect cam:image robot/relay:in --json").json == {
        "out": image,
        "in": into,
        "topic": "/old",
        "changed": [{**image, "before": "", "after": "/old"}],
    }
    pair.set_config("/robot/relay", {"in": "/other"})
    run(pair, "connect cam:image robot/relay:in")
    assert topics(pair) == {"/cam:image": "/old", "/robot/relay:in": "/old"}
    assert run(pair, "connect /old robot/relay:in --json").json == {
        "out": None,
        "in": into,
        "topic": "/old",
        "changed": [],
    }
    assert run(pair, "connect cam:image /raw --json").json["in"] is None


def test_a_port_that_a_lazy_nodelet_declares_is_connected_before_it_subscribes(pair):
    image = "sensor_msgs/Image"
    pair.world.host.stock = False
    pair.world.host.sources["pkg/Native"] = [("image", "in", image), ("~out", "out", image)]
    pair.world.host.lazy["pkg/Native"] = ("image",)
    pair.world.spawn("native", "lazy")
    assert run(pair, "connect /raw lazy:image").lines == ["/raw -> /lazy:image"]
    assert pair.calls == [("connect", "/lazy")]
    error = run(pair, "connect /raw lazy:imag").err
    assert "has no port 'imag'; its ports: image (in), ~out (out); did you mean image?" in error
    assert run(pair, "disconnect lazy:image").lines == ["/lazy:image has left /raw"]


@pytest.mark.parametrize(
    ("line", "moved"),
    [
        ("connect cam:image robot/relay:in --topic x", ["/robot/relay, /cam"]),  # the reader first
        ("connect robot/relay:out robot/relay:in", ["/robot/relay"]),
        ("connect /old robot/relay:in", []),
    ],
)
def test_ports_that_have_to_move_do_so_at_once(pair, line, moved):
    pair.set_config("/robot/relay", {"in": "/old"})
    pair.calls.clear()
    assert run(pair, line).code == 0
    assert pair.calls == [("connect", each) for each in moved]


def test_the_reader_goes_back_if_the_writer_is_refused(pair):
    pair.set_config("/robot/relay", {"in": "/before"})

    def fail(operation, argument):
        if (operation, argument) == ("connect", "/cam"):
            raise HostError("/cam: nothing was changed: topic '/x' carries std_msgs/String")

    pair.world.host.fail = fail
    outcome = run(pair, "connect cam:image robot/relay:in --topic x")
    assert outcome.code == 1
    assert outcome.err == (
        "dyknow: cannot connect: /cam: nothing was changed: topic '/x' carries std_msgs/String\n"
    )
    assert topics(pair) == {"/robot/relay:in": "/before"}


@pytest.mark.parametrize(
    ("line", "calls"),
    [
        ("connect cam:image robot/relay:in", ["get_config", "get_config", "connect"]),
        ("connect cam:image robot/relay:in --topic /raw", ["get_config", "get_config", "connect"]),
        ("connect /raw robot/relay:in", ["get_config", "connect"]),
        ("disconnect cam:image robot/relay:in", ["get_config", "get_config", "connect"]),
    ],
)
def test_connecting_takes_few_calls_and_no_graph(pair, line, calls):
    run(pair, "connect /before robot/relay:in")
    asked = []
    pair.asked = asked.append
    assert run(pair, line).code == 0
    assert asked == calls


def test_a_nodelet_with_fixed_topics_says_how_to_get_live_ports(pair):
    pair.world.spawn("native", "fixed", config={"image": "/raw"})
    for line in ("connect cam:image fixed:image --topic /x", "disconnect fixed:image"):
        outcome = run(pair, line)
        assert outcome.code == 1
        assert "the topics of '/fixed' are fixed" in outcome.err
        assert "launch-prefix 'rosrun dyknow rewirable'" in outcome.err
    assert topics(pair) == {"/fixed:image": "/raw"}
    assert "Re-wiring: its topics are fixed" in run(pair, "info fixed").out


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("connect /raw cam:image", "'/cam:image' is an out-port; swap the two"),
        ("connect robot/relay:in /raw", "'/robot/relay:in' is an in-port; swap the two"),
        ("connect cam robot/relay:in", "'/cam' is a nodelet; expected a topic, or its port as"),
        ("connect cam:image robot/relay", "its in-ports: in"),
        ("connect /raw robot/relay:inn", "no port 'inn'; its ports: in (in), out (out); did you"),
        ("connect nix:a robot/relay:in", "no nodelet named '/nix' runs; see 'dyknow list'"),
        ("connect camm:a robot/relay:in", "no nodelet named '/camm' runs; did you mean /cam?"),
        (
            "connect cam:imag robot/relay:in",
            "nodelet '/cam' has no port 'imag'; its ports: image (out); did you mean image?",
        ),
        (
            "connect robot/relay:in cam:image",
            "'/robot/relay:in' is an in-port and '/cam:image' an out-port; swap the two",
        ),
        (
            "connect robot/relay:in robot/relay:in",
            "'/robot/relay:in' is an in-port, expected an out-port first",
        ),
        (
            "connect cam:image robot/relay:out",
            "'/robot/relay:out' is an out-port, expected an in-port second",
        ),
        ("disconnect cam:nix", "nodelet '/cam' has no port 'nix'"),
        (
            "connect cam:image text:in",
            "'/cam:image' carries sensor_msgs/Image, '/text:in' expects std_msgs/String",
        ),
        (
            "connect hung:image robot/relay:in",
            "nodelet '/hung' did not answer within 5 s; it is running",
        ),
    ],
)
def test_ends_that_do_not_fit_are_named_before_anything_is_changed(pair, line, message):
    pair.world.host.sources["pkg/Text"] = [("in", "in", "std_msgs/String")]
    text = "<transformation><label>text</label><source>pkg/Text</source></transformation>"
    pair.world.manager.add_transformation(text)
    pair.world.spawn("text", "text")
    pair.world.spawn("camera", "hung")
    pair.hung.add("/hung")
    outcome = run(pair, line)
    assert outcome.code == 1
    assert message in outcome.err
    assert pair.calls == []


def test_an_unknown_type_fits_any():
    assert types_fit("*", "a/B") and types_fit("", "a/B") and not types_fit("a/B", "a/C")
