# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connecting two ports: the topic, the checks, the order, and undoing."""

from __future__ import annotations

import pytest
from unit.cli.fake_client import FakeClient, cases, play, run
from unit.manager.world import World

from dyknow.errors import HostError, Refused
from dyknow.model.graph import PortRef, State
from dyknow_rqt.graph.snapshot import Snapshot, plain_nodes, taken_topics
from dyknow_rqt.graph.wiring import choose_topic

#: With a camera and a relay, and an ordinary node that publishes on /lidar/scan and /cam.
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
$ connect /cam robot/relay:in
/cam -> /robot/relay:in
""",
}


@pytest.mark.parametrize("name", SESSIONS)
def test_sessions(pair, name):
    pair.ordinary.update(["/lidar/scan", "/cam"])
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


def test_a_private_port_needs_no_tilde_unless_another_has_that_name(pair):
    image = "sensor_msgs/Image"
    ports = [("image", "in", image), ("~out", "out", image)]
    pair.world.host.stock = False
    pair.world.host.sources["pkg/Native"] = ports
    pair.world.spawn("native", "native")
    there = "/native:~out -> /native/out -> /robot/relay:in"
    assert run(pair, "connect native:out robot/relay:in").lines == [there]
    assert run(pair, "connect native:out /other").lines == ["/native:~out -> /other"]
    assert run(pair, "disconnect native:out").lines == ["/native:~out has left /other"]
    ports.append(("/out", "out", image))
    pair.world.spawn("native", "two")
    error = run(pair, "connect two:out robot/relay:in").err
    assert "has no port 'out'; its ports: image (in), ~out (out), /out (out)" in error


@pytest.mark.parametrize(
    ("line", "asked", "moved"),
    [
        ("connect cam:image robot/relay:in", 2, ["/cam"]),
        ("connect cam:image robot/relay:in --topic x", 2, ["/robot/relay, /cam"]),  # reader first
        ("connect robot/relay:out robot/relay:in", 2, ["/robot/relay"]),
        ("connect /raw robot/relay:in", 1, ["/robot/relay"]),
        ("connect /old robot/relay:in", 1, []),
        ("disconnect cam:image robot/relay:in", 2, ["/robot/relay"]),
    ],
)
def test_ports_move_at_once_with_few_calls_and_no_graph(pair, line, asked, moved):
    pair.set_config("/robot/relay", {"in": "/old"})
    pair.calls.clear()
    methods = []
    pair.asked = methods.append
    assert run(pair, line).code == 0
    assert methods == ["get_config"] * asked + ["connect"] * len(moved)
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


def test_a_nodelet_with_fixed_topics_says_how_to_get_live_ports(pair):
    pair.world.spawn("native", "fixed", config={"image": "/raw"})
    for line in ("connect cam:image fixed:image --topic /x", "disconnect fixed:image"):
        outcome = run(pair, line)
        assert outcome.code == 1
        assert "the topics of '/fixed' are fixed" in outcome.err
        assert "launch-prefix 'rosrun dyknow rewirable'" in outcome.err
    assert topics(pair) == {"/fixed:image": "/raw"}
    assert "Re-wiring: its topics are fixed" in run(pair, "info fixed").out


#: Wrong ends of connections, each with a message; at last a port of another type, and a hung one.
WRONG_ENDS = """
connect /raw cam:image | '/cam:image' is an out-port; swap the two
connect robot/relay:in /raw | '/robot/relay:in' is an in-port; swap the two
connect cam robot/relay:in | '/cam' is a nodelet; expected a topic, or its port as
connect cam:image robot/relay | its in-ports: in
connect /raw robot/relay:inn | no port 'inn'; its ports: in (in), out (out); did you
connect nix:a robot/relay:in | no nodelet named '/nix' runs; see 'dyknow list'
connect camm:a robot/relay:in | no nodelet named '/camm' runs; did you mean /cam?
connect cam:imag robot/relay:in | has no port 'imag'; its ports: image (out); did you mean image?
connect robot/relay:in cam:image | is an in-port and '/cam:image' an out-port; swap the two
connect robot/relay:in robot/relay:in | '/robot/relay:in' is an in-port, expected an out-port first
connect cam:image robot/relay:out | '/robot/relay:out' is an out-port, expected an in-port second
disconnect cam:nix | nodelet '/cam' has no port 'nix'
connect cam:image text:in | '/cam:image' carries sensor_msgs/Image, '/text:in' expects std_msgs/S
connect hung:image robot/relay:in | nodelet '/hung' did not answer within 5 s; it is running
"""


@pytest.mark.parametrize(("line", "message"), cases(WRONG_ENDS))
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


@pytest.mark.parametrize("line", ["connect cam:image robot/relay:in", "disconnect cam:image"])
def test_a_nodelet_that_is_being_restarted_is_connected_by_the_manager_which_waits(chain, line):
    chain.hung.add("/cam")
    chain.alter("/cam", state=State.STARTING)
    assert run(chain, line).code == 0


def test_a_nodelet_that_was_unloaded_and_is_back_is_asked_again(pair, monkeypatch):
    """Its services of before refuse in the moment in which they end."""
    ask, refusals = pair.get_config, [Refused("'/cam': nodelet /cam is unloaded")]

    def get_config(name):
        if refusals:
            raise refusals.pop()
        return ask(name)

    monkeypatch.setattr(pair, "get_config", get_config)
    assert run(pair, "connect cam:image robot/relay:in").code == 0


@pytest.mark.parametrize(
    ("topics", "ordinary", "topic"),
    [
        ({}, [], "/cam/image"),
        ({"/cam": "/a", "/relay": "/b"}, [], "/a"),
        ({"/relay": "/b"}, [], "/b"),
        ({"/relay": "/b", "/other": "/b"}, [], "/cam/image"),
        ({"/relay": "/b"}, ["/b"], "/cam/image"),
        ({"/other": "/cam/image"}, [], "/cam/image_2"),
        ({"/other": "/cam/image", "/relay": "/cam/image_2"}, ["/cam/image_2"], "/cam/image_3"),
        ({"/relay": "/b"}, ["/b", "/cam/image"], "/cam/image_2"),
        ({"/waiting": "/cam/image"}, [], "/cam/image_2"),
    ],
)
def test_command_line_and_window_choose_the_same(topics, ordinary, topic):
    client = FakeClient(World())
    client.world.spawn("camera", "cam")
    client.world.spawn("camera", "other")
    client.world.spawn("relay", "relay")
    client.world.spawn("relay", "waiting")
    client.ordinary.update(ordinary)
    ports = {"/cam": "image", "/other": "image", "/relay": "in", "/waiting": "in"}
    for nodelet, place in topics.items():
        client.set_config(nodelet, {ports[nodelet]: place})
    publishers = [(each, ["/usb_cam"]) for each in ordinary]
    nodelets = client.get_graph().nodelets
    connected = {port.topic for nodelet in nodelets for port in nodelet.ports}
    snapshot = Snapshot(
        nodelets,
        plain_nodes(publishers, (), connected, set()),
        taken_topics(publishers, nodelets, set()),
    )
    assert choose_topic(snapshot, PortRef("/cam", "image"), PortRef("/relay", "in")) == topic
    assert run(client, "connect cam:image relay:in --json").json["topic"] == topic
