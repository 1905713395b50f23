# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connecting two ports: the topic, the checks, the order, and undoing."""

from __future__ import annotations

import pytest
from unit.cli.fake_client import FakeClient, run
from unit.manager.world import World

from dyknow.errors import HostError
from dyknow.wiring.ports import types_fit


@pytest.fixture
def client() -> FakeClient:
    client = FakeClient(World())
    client.world.spawn("camera", "cam")
    client.world.spawn("relay", "/robot/relay")
    return client


def topics(client: FakeClient) -> dict[str, str]:
    return {
        f"{nodelet.name}:{port.name}": port.topic
        for nodelet in client.get_graph().nodelets
        for port in nodelet.ports
        if port.topic
    }


def test_the_topic_is_the_out_ports_else_the_in_ports_else_a_new_one(client: FakeClient) -> None:
    assert run(client, "connect cam:image robot/relay:in").lines == [
        "/cam:image -> /cam/image -> /robot/relay:in"
    ]
    run(client, "disconnect cam:image")
    client.set_config("/robot/relay", {"in": "/old"})
    assert run(client, "connect cam:image robot/relay:in --json").json == {
        "out": {"nodelet": "/cam", "port": "image"},
        "in": {"nodelet": "/robot/relay", "port": "in"},
        "topic": "/old",
        "changed": [{"nodelet": "/cam", "port": "image", "before": "", "after": "/old"}],
    }
    client.set_config("/robot/relay", {"in": "/other"})
    run(client, "connect cam:image robot/relay:in")
    assert topics(client) == {"/cam:image": "/old", "/robot/relay:in": "/old"}


def test_a_port_that_a_lazy_nodelet_declares_is_connected_before_it_subscribes(
    client: FakeClient,
) -> None:
    image = "sensor_msgs/Image"
    client.world.host.stock = False
    client.world.host.sources["pkg/Native"] = [("image", "in", image), ("~out", "out", image)]
    client.world.host.lazy["pkg/Native"] = ("image",)
    client.world.spawn("native", "lazy")
    assert run(client, "connect /raw lazy:image").lines == ["/raw -> /lazy:image"]
    assert client.calls == [("connect", "/lazy")]
    error = run(client, "connect /raw lazy:imag").err
    assert "has no port 'imag'; its ports: image (in), ~out (out); did you mean image?" in error
    assert run(client, "disconnect lazy:image").lines == ["/lazy:image has left /raw"]


def test_a_topic_that_is_given_begins_at_the_manager(client: FakeClient) -> None:
    run(client, "connect cam:image robot/relay:in --topic raw")
    assert set(topics(client).values()) == {"/raw"}


def test_an_in_port_is_connected_to_a_topic(client: FakeClient) -> None:
    assert run(client, "connect raw robot/relay:in").lines == ["/raw -> /robot/relay:in"]
    assert topics(client) == {"/robot/relay:in": "/raw"}
    assert run(client, "connect /raw robot/relay:in --json").json == {
        "out": None,
        "in": {"nodelet": "/robot/relay", "port": "in"},
        "topic": "/raw",
        "changed": [],
    }
    assert client.calls == [("connect", "/robot/relay")]


def test_a_topic_without_a_publisher_is_reported(client: FakeClient) -> None:
    client.ordinary.add("/lidar/scan")
    outcome = run(client, "connect /lidar/scna robot/relay:in")
    assert outcome.lines == ["/lidar/scna -> /robot/relay:in"]
    assert outcome.err == (
        "dyknow: warning: connected, but no node publishes on '/lidar/scna' yet; did you mean "
        "/lidar/scan?\n"
    )
    assert run(client, "connect /lidar/scan robot/relay:in").err == ""
    run(client, "connect cam:image /raw")
    assert run(client, "connect /raw robot/relay:in").err == ""


def test_an_out_port_is_connected_to_a_topic(client: FakeClient) -> None:
    assert run(client, "connect cam:image /raw --json").json == {
        "out": {"nodelet": "/cam", "port": "image"},
        "in": None,
        "topic": "/raw",
        "changed": [{"nodelet": "/cam", "port": "image", "before": "", "after": "/raw"}],
    }
    assert topics(client) == {"/cam:image": "/raw"}


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("connect /raw cam:image", "'/cam:image' is an out-port; swap the two"),
        ("connect robot/relay:in /raw", "'/robot/relay:in' is an in-port; swap the two"),
        ("connect cam robot/relay:in", "'/cam' is a nodelet; expected a topic, or its port as"),
        ("connect cam:image robot/relay", "its in-ports: in"),
        ("connect /raw robot/relay:inn", "no port 'inn'; its ports: in (in), out (out); did you"),
    ],
)
def test_a_topic_at_the_wrong_end_is_refused(client: FakeClient, line: str, said: str) -> None:
    outcome = run(client, line)
    assert outcome.code == 1
    assert said in outcome.err
    assert client.calls == []


def test_the_reader_is_moved_first(client: FakeClient) -> None:
    run(client, "connect cam:image robot/relay:in")
    assert client.calls == [("connect", "/robot/relay, /cam")]


def test_what_is_connected_already_is_left_alone(client: FakeClient) -> None:
    run(client, "connect cam:image robot/relay:in")
    client.calls.clear()
    outcome = run(client, "connect cam:image robot/relay:in")
    assert outcome.lines == ["/cam:image -> /cam/image -> /robot/relay:in (as it was)"]
    assert client.calls == []


def test_both_ports_of_one_nodelet_are_moved_at_once(client: FakeClient) -> None:
    run(client, "connect robot/relay:out robot/relay:in")
    assert client.calls == [("connect", "/robot/relay")]
    assert topics(client) == {
        "/robot/relay:in": "/robot/relay/out",
        "/robot/relay:out": "/robot/relay/out",
    }


def test_the_reader_goes_back_if_the_writer_is_refused(client: FakeClient) -> None:
    client.set_config("/robot/relay", {"in": "/before"})

    def fail(operation: str, argument: str) -> None:
        if (operation, argument) == ("connect", "/cam"):
            raise HostError("/cam: nothing was changed: topic '/x' carries std_msgs/String")

    client.world.host.fail = fail
    outcome = run(client, "connect cam:image robot/relay:in --topic x")
    assert outcome.code == 1
    assert outcome.err == (
        "dyknow: cannot connect: /cam: nothing was changed: topic '/x' carries std_msgs/String\n"
    )
    assert topics(client) == {"/robot/relay:in": "/before"}


@pytest.mark.parametrize(
    ("line", "calls"),
    [
        ("connect cam:image robot/relay:in", ["get_config", "get_config", "connect"]),
        ("connect cam:image robot/relay:in --topic /raw", ["get_config", "get_config", "connect"]),
        ("connect /raw robot/relay:in", ["get_config", "connect"]),
        ("disconnect cam:image robot/relay:in", ["get_config", "get_config", "connect"]),
    ],
)
def test_connecting_takes_few_calls_and_no_graph(
    client: FakeClient, line: str, calls: list[str]
) -> None:
    run(client, "connect /before robot/relay:in")
    asked: list[str] = []
    client.asked = asked.append
    assert run(client, line).code == 0
    assert asked == calls


def test_a_nodelet_with_fixed_topics_says_how_to_get_live_ports(client: FakeClient) -> None:
    client.world.spawn("native", "fixed", config={"image": "/raw"})
    for line in ("connect cam:image fixed:image --topic /x", "disconnect fixed:image"):
        outcome = run(client, line)
        assert outcome.code == 1
        assert "the topics of '/fixed' are fixed" in outcome.err
        assert "launch-prefix 'rosrun dyknow rewirable'" in outcome.err
    assert topics(client) == {"/fixed:image": "/raw"}
    assert "Re-wiring: its topics are fixed" in run(client, "info fixed").out


@pytest.mark.parametrize(
    ("line", "said"),
    [
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
    ],
)
def test_what_does_not_fit_is_named_before_anything_is_changed(
    client: FakeClient, line: str, said: str
) -> None:
    outcome = run(client, line)
    assert outcome.code == 1
    assert said in outcome.err
    assert client.calls == []


def test_types_have_to_fit(client: FakeClient) -> None:
    client.world.host.sources["pkg/Text"] = [("in", "in", "std_msgs/String")]
    text = "<transformation><label>text</label><source>pkg/Text</source></transformation>"
    client.world.manager.add_transformation(text)
    client.world.spawn("text", "text")
    outcome = run(client, "connect cam:image text:in")
    assert outcome.err == (
        "dyknow: cannot connect: '/cam:image' carries sensor_msgs/Image, '/text:in' expects "
        "std_msgs/String\n"
    )
    assert types_fit("*", "a/B") and types_fit("", "a/B") and not types_fit("a/B", "a/C")


def test_a_silent_nodelet_is_told_with_its_state(client: FakeClient) -> None:
    client.hung.add("/cam")
    outcome = run(client, "connect cam:image robot/relay:in")
    assert outcome.code == 1
    assert "nodelet '/cam' did not answer within 5 s; it is running" in outcome.err


def test_disconnecting_several_ports_and_one_that_is_not_connected(client: FakeClient) -> None:
    run(client, "connect cam:image robot/relay:in")
    outcome = run(client, "disconnect cam:image robot/relay:in robot/relay:out cam:image")
    assert outcome.lines == [
        "/cam:image has left /cam/image",
        "/robot/relay:in has left /cam/image",
        "/robot/relay:out was not connected",
    ]
    assert topics(client) == {}
