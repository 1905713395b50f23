# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Children and their records on disk, which outlive the manager; names that a child may take."""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, List

import pytest
from clocks import join, wait_for
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import HostError
from dyknow.manager.store import Store
from dyknow.model.graph import NodeletKind
from dyknow.periodic import in_background
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting import children as children_module
from dyknow.ros.hosting import launcher as launcher_module
from dyknow.ros.hosting.child import Child
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.process import os_process
from dyknow.ros.process.os_process import ProcessId
from dyknow.ros.wire.master import Master


class FakeLauncher:
    """Notes what is done, in order; its processes are up at once, and cannot be started."""

    def __init__(self):
        self.store = Store()
        self.found: List[ChildRecord] = []
        self.cleaned: List[str] = []
        self.at_launch: List[ChildRecord] = []
        self.launched = threading.Event()
        self.living = self.follow = lambda name: None
        self.is_free = lambda *unused: True
        self.registered = lambda name: ""

    def running(self):
        return self.found

    def clean_up(self, child):
        self.cleaned.append(child.name)

    def launch(self, child, command):
        self.at_launch = read(self.store)
        self.launched.set()
        raise OSError("no process")


def read(store):
    return [*store.read(child_records.TABLE, ChildRecord.from_body).values()]


def write(store, records):
    store.write({(child_records.TABLE, each.name): each.body() for each in records})


def come_up(child):
    if child.record.process is not None:
        child.presence = replace(child.presence, state=replace(child.state, incarnation="1"))
        child.on_up()


@pytest.fixture
def launcher(monkeypatch):
    monkeypatch.setattr(Child, "_find", come_up)
    return FakeLauncher()


@pytest.fixture
def children(launcher):
    nowhere = Master("/manager", "http://127.0.0.1:9")
    return Children(PeerContext(nowhere), launcher, "/", launcher.store)


def test_a_record_is_there_before_the_process_and_none_after_the_end(children, launcher):
    children.want(NodeletKind.PYTHON, 1)
    wait_for(launcher.launched)
    assert [each.name for each in launcher.at_launch] == ["/dyknow_nodelet_manager"]
    children.end_all()
    with pytest.raises(HostError, match="being ended"):
        children.want(NodeletKind.PYTHON, 1)


def test_a_name_that_another_node_bears_is_told_at_once(children, launcher, monkeypatch):
    """The child is started as soon as its name is free; until then nobody waits for it."""
    monkeypatch.setattr(children_module, "START_TIMEOUT", 3600.0)
    launcher.living = lambda name: ProcessId(-1, -1)
    answers = []

    def ensure() -> None:
        with pytest.raises(HostError) as error:
            children.ensure(NodeletKind.PYTHON, "")
        answers.append(str(error.value))

    asking = in_background("asking", ensure)
    join(asking)
    assert answers == ["nodelet manager '/dyknow_nodelet_manager': another node has that name"]
    launcher.living = lambda name: None
    wait_for(launcher.launched)
    children.end_all()


def test_children_that_died_without_a_manager_are_cleaned_up(children, launcher):
    here = ProcessId.of(os.getpid())
    assert here is not None
    gone = ProcessId(here.pid, here.started + 1)
    records = [
        ChildRecord("/dead", NodeletKind.CPP, "", gone),
        ChildRecord("/lives", NodeletKind.PYTHON, "", here),
        ChildRecord("/node", NodeletKind.SCRIPT, "/node", gone),
        ChildRecord("/was_to_be_started", NodeletKind.PYTHON, "/n"),
    ]
    write(launcher.store, records)
    assert children.adopt() == ["/lives"]
    assert launcher.cleaned == ["/dead", "/node", "/was_to_be_started"]
    assert read(launcher.store) == records[1:2]


def test_children_that_run_are_taken_over_without_a_record(children, launcher):
    launcher.found = [ChildRecord("/lives", NodeletKind.CPP, "", ProcessId.of(os.getpid()))]
    assert children.adopt() == ["/lives"]
    assert read(launcher.store) == launcher.found


def test_records_name_processes_of_this_boot(monkeypatch):
    store = Store()
    records = [
        ChildRecord("/a", NodeletKind.CPP, "", ProcessId.of(os.getpid())),
        ChildRecord("/not_started", NodeletKind.PYTHON, "/n"),
    ]
    write(store, records)
    assert read(store) == records
    monkeypatch.setattr(os_process, "boot", lambda: "another boot")
    assert read(store) == [replace(records[0], process=None), records[1]]


def test_a_name_is_free_if_no_process_may_bear_it(tmp_path, monkeypatch):
    """One on a host that is cut off may run, and would be ended when the host is back."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    monkeypatch.setattr(launcher_module, "_ANSWER_TIMEOUT", 0.2)
    owner: Any = SimpleNamespace(path="")
    with small_graph() as graph:
        launcher = Launcher(Master("/manager", graph.uri), owner, 0.0, {})
        for name in ("/lives", "/away", "/dead"):
            graph.nodes[name] = SmallManager()
        graph.nodes["/away"].goes_on.clear()
        graph.nodes["/dead"].close()
        free = {name: launcher.is_free(name) for name in (*graph.nodes, "/new")}
        assert free == {"/lives": False, "/away": False, "/dead": True, "/new": True}
        del graph.nodes["/dead"]
