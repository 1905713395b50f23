# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The topic on which two ports meet: one choice, for the command line and for the window."""

from __future__ import annotations

import pytest
from unit.cli.fake_client import FakeClient, run
from unit.manager.world import World

from dyknow.model.graph import PortRef
from dyknow_rqt.graph.snapshot import Snapshot, plain_nodes, taken_topics
from dyknow_rqt.graph.wiring import choose_topic


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
