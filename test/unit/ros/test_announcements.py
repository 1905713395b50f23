# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The numbers of changes, and their announcements."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import rospy
from clocks import eventually
from dyknow_msgs.msg import NodeletPorts

from dyknow.ros.nodelets.announcements import Announcer

MANY = [f"/n{number:03}" for number in range(500)]


@pytest.fixture
def announced(monkeypatch):
    """An announcer, and the nodelets of each of its messages."""
    published = []
    topic = SimpleNamespace(publish=published.append, unregister=lambda: None)
    monkeypatch.setattr(rospy, "Publisher", lambda *arguments, **options: topic)
    announcer = Announcer(lambda name: NodeletPorts(name, name != "/gone", [], "", ""))
    yield announcer, published
    announcer.close()


def names(changes):
    return [each.nodelet for each in changes.nodelets]


def test_a_change_among_many_nodelets_is_announced_alone(announced):
    announcer, published = announced
    for name in MANY:
        announcer.announce(name)
    announcer.start()
    eventually(lambda: published)
    assert (published[0].sequence, names(published[0])) == (500, MANY)
    announcer.announce("/n007")
    eventually(lambda: len(published) == 2)
    assert (published[1].sequence, names(published[1])) == (501, ["/n007"])
    assert published[1].process == published[0].process


def test_each_poll_and_each_newcomer_gets_what_it_has_not_seen(announced):
    announcer, published = announced
    for name in ("/b", "/gone", "/a", "/b"):
        announcer.announce(name)
    found = {seen: names(announcer.since(seen)) for seen in (0, 2, 3, 4)}
    assert found == {0: ["/a", "/b", "/gone"], 2: ["/a", "/b"], 3: ["/b"], 4: []}
    announcer.start()
    eventually(lambda: published)
    eventually(lambda: names(announcer.since(0)) == ["/a", "/b"])
    newcomer = []
    announcer.peer_subscribe("", None, newcomer.append)
    assert names(newcomer[0]) == ["/a", "/b"]
