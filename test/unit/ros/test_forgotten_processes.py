# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Processes that come and go leave nothing with the manager; guards are handed over in order."""

from __future__ import annotations

import fcntl
import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Set, cast

import pytest
from clocks import PATIENCE, in_thread, join, wait_for
from dyknow_msgs.msg import NodeletChanges, NodeletPorts
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.manager.host import Crash, HostReport
from dyknow.manager.store import Store
from dyknow.manager.suspects import MEMORY, Suspects
from dyknow.model.graph import NodeletKind, State
from dyknow.ros.hosting import fixed_nodelets
from dyknow.ros.hosting import launcher as launcher_module
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.external import External
from dyknow.ros.hosting.fixed_nodelets import FixedNodelets
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.host import RosHost
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.process.os_process import LogTail, ProcessId
from dyknow.ros.wire.master import Master


@pytest.fixture
def host():
    """A host with one node, whose process is gone."""
    with small_graph() as graph:
        graph.nodes["/n"] = SmallManager("node")
        graph.nodes["/n"].nodelets = ["/n"]
        context = PeerContext(Master("/test", graph.uri))
        registrar, launcher = cast(Any, SimpleNamespace()), cast(Any, SimpleNamespace())
        host = RosHost(context, Children(context, launcher, "/", Store()), registrar)
        host.look_for_nodes(["/n"])
        yield host
        host.close()


def test_what_is_kept_of_a_process_goes_with_it(host):
    report = host.poll()
    assert report.processes["/n"].kind is NodeletKind.NODE
    assert report.nodelets == {"/n": frozenset(["/n"])}
    host.grant(lambda: ({"/topic": "/n"}, ["/n"]))
    (node,) = host._peers()
    stuck = NodeletPorts("/n", True, [], "a callback has been running for 12 s", "")
    changes = NodeletChanges(node.presence.process, 2, [stuck], "node")
    host._hear("/n", changes)
    assert host.counts({"/n": ["/n"]}) == {"/n": None}
    assert host.reported("/n", "/n").detail and host.may_publish("/n")
    host._external._drop(cast(External, node))
    assert host.poll() == HostReport({}, {}, {})
    assert host.counts({"/n": ["/n"]}) == {"/n": None}
    host._hear("/n", changes)
    assert host.reported("/n", "/n") is None
    node.loop.close(PATIENCE)
    assert not node.loop.running


@pytest.mark.parametrize("kind", ["guards", "producers"])
def test_an_older_state_never_replaces_a_newer_one(host, kind):
    """Or a nodelet would be unprotected, or a producer silent, until the next look."""
    has_read, may_go_on = threading.Event(), threading.Event()
    context = host._context
    nodelets = {"/n": ["/n"]}
    producers = {"/topic": "/n"}
    older, newer, hand_over, result = {
        "guards": ({}, nodelets, host.hand_over, lambda: context.protected == nodelets),
        "producers": (
            ({}, []),
            (producers, ["/n"]),
            host.grant,
            lambda: context.producers == producers,
        ),
    }[kind]

    def slowly():
        has_read.set()
        wait_for(may_go_on)
        return older

    first = in_thread(lambda: hand_over(slowly))
    wait_for(has_read)
    second = in_thread(lambda: hand_over(lambda: newer))
    second.join(0.2)  # it would be done, were it not for the other one
    may_go_on.set()
    join(first, second)
    assert result()


def test_fixed_nodelets_have_services_until_the_end(monkeypatch):
    """A publication of the model that is late must not offer them once more."""
    offered: Set[str] = set()

    def services(proxy):
        offered.add(proxy.name)
        return SimpleNamespace(close=lambda: offered.discard(proxy.name))

    monkeypatch.setattr(fixed_nodelets, "ProxyServices", services)
    record = SimpleNamespace(name="/n", is_fixed=True, is_spawned=True, state=State.STARTING)
    records = [record, SimpleNamespace(is_fixed=False)]
    manager: Any = SimpleNamespace(graph=SimpleNamespace(all=lambda: records))
    fixed = FixedNodelets(manager)
    for state, expected in (
        (State.STARTING, set()),
        (State.RUNNING, {"/n"}),
        (State.LOST, {"/n"}),
    ):
        record.state = state
        fixed.follow()
        assert offered == expected
    fixed.close()
    fixed.follow()
    assert offered == set()


def test_old_accusations_take_no_memory():
    now = [0.0]
    suspects = Suspects(lambda: now[0])
    for number in range(50):
        now[0] += MEMORY
        suspects.accuse(Crash("/manager", "SIGSEGV", frozenset([2 * number])), [])
    assert len(suspects._accounts) <= 2


@pytest.fixture
def launched(tmp_path, monkeypatch):
    written = {}

    def start(command, output, *rest):
        file = written[Path(output).name] = open(output, "w")  # noqa: SIM115 - until its end
        fcntl.flock(file, fcntl.LOCK_SH)
        file.write("it runs\n")
        file.flush()
        Path(output + ".owner").touch()
        return ProcessId(1, 1)

    monkeypatch.setattr(launcher_module.os_process, "start", start)
    monkeypatch.setattr(launcher_module.rospkg, "get_log_dir", lambda: str(tmp_path))
    master: Any = SimpleNamespace(
        uri="http://here:1", caller="/test", ask=lambda *args: "", node=lambda name: ""
    )
    owner: Any = SimpleNamespace(path="lock")
    launcher = Launcher(master, owner, 0.0, {})

    def end(record):
        written[f"{record.name[1:]}-output.log"].close()
        launcher.clean_up(record)

    yield launcher, end
    for file in written.values():
        file.close()


def test_outputs_of_the_last_processes_are_kept(launched, tmp_path):
    launcher, end = launched

    def launch(name):
        record = ChildRecord(name, NodeletKind.PYTHON)
        assert isinstance(launcher.launch(record)[1], LogTail)
        return record

    for number in range(30):
        again = launch("/again")
        other = launch(f"/n{number}")
        if number != 3:
            end(other)
        assert launcher.last_line("/again") == "it runs"
        end(again)
    (folder,) = tmp_path.iterdir()
    left = sorted(each for each in os.listdir(folder) if each.endswith(".log"))
    assert "n3-output.log" in left, "it runs"
    assert "n29-output.log" in left
    assert len(left) == 1 + launcher_module._OUTPUTS
    assert len(os.listdir(folder)) == 2 * len(left)


def test_outputs_are_bounded_in_all_and_those_of_an_earlier_life_go_first(
    launched, tmp_path, monkeypatch
):
    monkeypatch.setattr(launcher_module, "_OUTPUT_SIZE", 100)
    launcher, end = launched
    (folder,) = tmp_path.iterdir()
    earlier = folder / "earlier-output.log"
    earlier.write_bytes(bytes(60))
    os.utime(earlier, (1.0, 1.0))
    first, second = (ChildRecord(name, NodeletKind.PYTHON) for name in ("/first", "/second"))
    launcher.launch(first)
    end(first)
    assert earlier.exists()
    launcher.launch(second)
    (folder / "second-output.log").write_bytes(bytes(50))
    end(second)
    assert not earlier.exists()
    assert {each.name for each in folder.glob("*.log")} == {
        "first-output.log",
        "second-output.log",
    }
