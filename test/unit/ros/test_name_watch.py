# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A node that lost its name to another one ends, however late it learns of it."""

from __future__ import annotations

import queue

import pytest
from clocks import PATIENCE
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.ros.nodelets import peer_services
from dyknow.ros.nodelets.peer_services import end_when_displaced


@pytest.fixture(name="graph")
def _graph(monkeypatch):
    monkeypatch.setattr(peer_services, "NAME_PERIOD", 0.05)
    with small_graph() as graph:
        monkeypatch.setenv("ROS_MASTER_URI", graph.uri)
        yield graph


def goes_on(reasons, seconds=0.2):
    with pytest.raises(queue.Empty):
        reasons.get(timeout=seconds)
    return True


def test_it_ends_when_another_node_has_its_name_and_not_before(graph):
    graph.nodes["/twin"] = elder = SmallManager()
    reasons = queue.Queue()
    end_when_displaced("/twin", elder.uri, reasons.put)
    assert goes_on(reasons)
    del graph.nodes["/twin"]  # a new master has no registrations
    assert goes_on(reasons)
    graph.nodes["/twin"] = SmallManager()
    try:
        assert "another node bears the name /twin" in reasons.get(timeout=PATIENCE)
    finally:
        elder.close()


def test_a_node_goes_on_while_the_master_is_away(graph):
    graph.nodes["/twin"] = elder = SmallManager()
    reasons = queue.Queue()
    graph.close()
    end_when_displaced("/twin", elder.uri, reasons.put)
    assert goes_on(reasons, 0.3)
