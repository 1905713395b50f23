# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Children, and their traces: records on disk, names, outputs, guards in order."""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, List, Set, cast
from unittest import mock

import pytest
from clocks import PATIENCE, eventually, in_thread, join, wait_for
from dyknow_msgs.msg import NodeletChanges, NodeletPorts
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.backoff import Backoff
from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import Crash, HostReport, LoadRequest
from dyknow.manager.store import Store
from dyknow.manager.supervision.suspects import MEMORY, Suspects
from dyknow.model.graph import NodeletKind, State
from dyknow.model.transformation import FORMULA_CLASS, Parameter
from dyknow.ros.hosting import child_records, fixed_nodelets
from dyknow.ros.hosting import children as children_module
from dyknow.ros.hosting import host as host_module
from dyknow.ros.hosting import launcher as launcher_module
from dyknow.ros.hosting.child import Child
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.external import External
from dyknow.ros.hosting.fixed_nodelets import FixedNodelets
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.host import RosHost
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.process import os_process
from dyknow.ros.process.os_process import LogTail, ProcessId
from dyknow.ros.wire.master import Master


class FakeLauncher:
    """Notes clean-ups and launches; its processes are up at once, and cannot be started."""

    def __init__(self):
        self.store = Store()
        self.found: List[ChildRecord] = []
        self.cleaned: List[str] = []
        self.at_launch: List[ChildRecord] = []
        self.launched = threading.Event()
        self.is_living = lambda name: False
        self.follow = lambda name: None
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
    children = Children(PeerContext(nowhere), launcher, "/", launcher.store)
    yield children
    children.end_all()


def test_a_record_is_there_before_the_process_and_none_after_the_end(children, launcher):
    earlier = {*threading.enumerate()}
    children.want(NodeletKind.PYTHON, 1)
    wait_for(launcher.launched)
    assert [each.name for each in launcher.at_launch] == ["/dyknow_nodelet_manager"]
    children.end_all()
    with pytest.raises(HostError, match="being ended"):
        children.want(NodeletKind.PYTHON, 1)
    eventually(lambda: not any("nodelet_manager" in each.name for each in new_threads(earlier)))


def new_threads(earlier: Set[threading.Thread]) -> Set[threading.Thread]:
    return {*threading.enumerate()} - earlier


def test_a_name_that_another_node_bears_is_told_at_once(children, launcher, monkeypatch):
    """The child is started as soon as its name is free; until then no call waits for it."""
    monkeypatch.setattr(children_module, "START_TIMEOUT", 3600.0)
    launcher.is_living = lambda name: True
    answers = []

    def ensure() -> None:
        with pytest.raises(HostError) as error:
            children.ensure(NodeletKind.PYTHON, "")
        answers.append(str(error.value))

    join(in_thread(ensure))
    assert answers == ["nodelet manager '/dyknow_nodelet_manager': another node has that name"]
    launcher.is_living = lambda name: False
    wait_for(launcher.launched)


def test_a_restart_ends_the_pause_of_a_process_that_cannot_be_started(
    children, launcher, monkeypatch
):
    """The process that is started then has not been ended for another one."""
    monkeypatch.setattr(children_module, "START_TIMEOUT", 0.0)
    children._deaths = Backoff(time.monotonic, 3600.0, 3600.0, tolerated=0)
    renewed = []

    def launch(child, command):
        renewed.append(children.find(child.name).is_renewed)
        raise OSError("no process")

    launcher.launch = launch
    children.want(NodeletKind.PYTHON, 1)
    eventually(lambda: children._deaths.paused)
    with pytest.raises(HostError):
        children.renew("/dyknow_nodelet_manager")
    eventually(lambda: len(renewed) == 2)
    assert renewed == [False, False]


@contextlib.contextmanager
def sleeping():
    with subprocess.Popen(["sleep", "1000"], start_new_session=True) as process:
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):  # on Python 3.8, if it was reaped
                process.kill()


def test_a_node_that_is_late_is_refused_with_its_limit(children, launcher, monkeypatch):
    monkeypatch.setattr(children_module, "PATIENCE", 3600.0)
    monkeypatch.setattr(Child, "_find", lambda child: None)
    launcher.last_line = lambda name: "loading"
    with sleeping() as process:
        found = ProcessId.of(process.pid)
        launcher.launch = lambda child, command: (found, None)
        with pytest.raises(HostError) as error:
            children.start_node(NodeletKind.CPP_NODE, "/n", ("true",), 0.1)
    why = "node '/n': it has offered no ports within 0.1 s; the last that it printed: loading"
    assert str(error.value) == why


def test_a_node_is_up_when_it_offers_its_ports():
    """It answers polls before: one in C++ registers three services between."""
    with small_graph() as graph, sleeping() as process:
        context, launcher = PeerContext(Master("/test", graph.uri)), cast(Any, FakeLauncher())
        node = graph.nodes["/n"] = SmallManager("cpp_node")
        launcher.launch = lambda child, command: (ProcessId.of(process.pid), None)
        children = Children(context, launcher, "/", launcher.store)
        try:
            start = ("/n", ("true",), PATIENCE)
            starting = in_thread(lambda: children.start_node(NodeletKind.CPP_NODE, *start))
            eventually(lambda: len(node.requests) > 2 or not starting.is_alive())
            assert starting.is_alive()
            node.nodelets.append("/n")
            join(starting)
            child = children.find("/n")
            assert child is not None and child.up and "/n" in child.presence.nodelets
        finally:
            children.end_all()


def test_children_without_a_manager_are_cleaned_up_or_taken_over(children, launcher):
    with sleeping() as process:
        living = ProcessId.of(process.pid)
        assert living is not None
        gone = ProcessId(living.pid, living.started + 1)
        records = [
            ChildRecord("/dead", NodeletKind.CPP, "", gone),
            ChildRecord("/lives", NodeletKind.PYTHON, "", living),
            ChildRecord("/node", NodeletKind.SCRIPT, "/node", gone),
            ChildRecord("/was_to_be_started", NodeletKind.PYTHON, "/n"),
        ]
        write(launcher.store, records)
        launcher.found = [replace(records[1], name="/without_record")]
        assert children.adopt() == ["/lives", "/without_record"]
        assert launcher.cleaned == ["/dead", "/node", "/was_to_be_started"]
        assert read(launcher.store) == [records[1], *launcher.found]
        children.end_all()


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


# Processes that come and go leave nothing with the manager


@pytest.fixture
def host():
    """A host with one node, whose process is gone."""
    with small_graph() as graph:
        graph.nodes["/n"] = SmallManager("node", ["/n"])
        context = PeerContext(Master("/test", graph.uri))
        host: Any = RosHost(context, Children(context, mock.Mock(), "/", Store()), mock.Mock())
        host.graph = graph
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


class Calls:
    """Services of a nodelet manager: their calls, and the errors of the next ones."""

    def __init__(self):
        self.made: List[str] = []
        self.errors: List[Exception] = []

    def __call__(self, master, service, kind):
        def call(timeout, *name, **fields):
            self.made.append(f"{service} {fields.get('name') or name[0]}")
            if self.errors:
                raise self.errors.pop(0)

        return SimpleNamespace(call=call)


@pytest.fixture
def calls(host, monkeypatch):
    """Of the nodelet manager `/m`, in which a load of `/late` has just been given up."""
    graph = host.graph
    graph.nodes["/m"] = SmallManager()
    (peer,) = host._external._expect(["/m"], False)
    eventually(lambda: peer.state.responsive)
    calls = Calls()
    monkeypatch.setattr(host_module, "ServiceClient", calls)
    calls.errors.append(PeerTimeout("/m/load_nodelet", 0.1))
    with pytest.raises(HostError, match="was not up within 0.1 s"):
        host.load("/m", LoadRequest("/late", "pkg/Slow", ()), 0.1)
    graph.nodes["/m"].nodelets = ["/late"]
    return calls


def test_a_nodelet_whose_load_was_given_up_is_unloaded_until_that_succeeds(host, calls):
    del calls.made[:]
    calls.errors.append(PeerTimeout("/m/unload_nodelet", 4.0))
    with pytest.raises(HostError):
        host.list("/m")
    for _ in range(2):
        host.list("/m")
    assert calls.made == 2 * ["/m/unload_nodelet /late"]


def test_a_formula_asks_the_manager_that_loads_it_for_individuals(host, calls, monkeypatch):
    server: Dict[str, object] = {}

    def delete(node, parameters):
        for each in parameters:
            del server[f"{node}/{each}"]

    monkeypatch.setattr(host_module, "_REPORT_TIMEOUT", 0.0)
    monkeypatch.setattr(host._master, "ask", lambda set_param, *given: server.update([given]))
    monkeypatch.setattr(host._master, "delete_parameters", delete)
    formula, tags = Parameter("formula", "string", "p"), Parameter("individuals", "yaml", "{}")
    host.unload("/m", "/late")
    host.load("/m", LoadRequest("/plain", FORMULA_CLASS, (formula,)), 1.0)
    host.load("/m", LoadRequest("/every", FORMULA_CLASS, (formula, tags)), 1.0)
    managers = {name: value for name, value in server.items() if name.endswith("/manager")}
    assert managers == {"/every/manager": "/test"}
    host.forget("/plain", ["formula"])
    host.forget("/every", ["formula", "individuals"])
    assert server == {}


def test_one_of_that_name_that_another_client_loads_later_is_left_alone(host, calls):
    host.unload("/m", "/late")
    del calls.made[:]
    assert host.list("/m") == ["/late"] and calls.made == []


def test_one_of_that_name_in_another_process_is_left_alone(host, calls):
    elder = host.graph.nodes["/m"]
    host.graph.nodes["/m"] = SmallManager(nodelets=["/late"])
    elder.close()
    with pytest.raises(HostError):
        host.list("/m")
    eventually(lambda: host.states()["/m"].incarnation.startswith(host.graph.nodes["/m"].uri))
    del calls.made[:]
    assert host.list("/m") == ["/late"] and calls.made == []


@pytest.mark.parametrize("kind", ["guards", "producers"])
def test_an_older_state_never_replaces_a_newer_one(host, kind):
    """Or a nodelet would be unprotected, or a producer silent, until the next look."""
    has_read, may_go_on = threading.Event(), threading.Event()
    context, nodelets, producers = host._context, {"/n": ["/n"]}, {"/topic": "/n"}
    hand_over, older, newer = {
        "guards": (host.hand_over, {}, nodelets),
        "producers": (host.grant, ({}, []), (producers, ["/n"])),
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
    handed = context.protected if kind == "guards" else context.producers
    assert handed == (nodelets if kind == "guards" else producers)


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
    for record.state in (State.STARTING, State.RUNNING, State.LOST):
        fixed.follow()
        assert offered == ({"/n"} if record.state is not State.STARTING else set())
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
    master = mock.Mock(uri="http://here:1", caller="/test", node=lambda name: "")
    launcher = Launcher(master, mock.Mock(path="lock"), 0.0, {})

    def end(record):
        written[f"{record.name[1:]}-output.log"].close()
        launcher.clean_up(record)

    yield launcher, end
    for file in written.values():
        file.close()


def test_outputs_of_the_last_processes_are_kept(launched, tmp_path):
    launcher, end = launched
    (folder,) = tmp_path.iterdir()
    folder.rmdir()  # as rosclean does

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
    (folder / "x-output.log").symlink_to("removed")  # just now, by another thread
    first, second = (ChildRecord(name, NodeletKind.PYTHON) for name in ("/first", "/second"))
    launcher.launch(first)
    end(first)
    name, parameters = launcher._master.delete_parameters.call_args[0]
    assert name == "/first" and "owner" in parameters
    assert earlier.exists()
    launcher.launch(second)
    (folder / "second-output.log").write_bytes(bytes(50))
    end(second)
    assert not earlier.exists()
    left = {each.name for each in folder.glob("*.log")}
    assert left == {"first-output.log", "second-output.log", "x-output.log"}


def test_a_process_whose_watchdog_cannot_be_started_is_ended(launched, monkeypatch):
    """No record has it yet, so it would keep its name from the next one for ever."""
    launcher, _ = launched
    launcher._orphan_timeout = 1.0
    start = mock.Mock(side_effect=[ProcessId(1, 1), OSError("too many open files")])
    end = mock.Mock()
    monkeypatch.setattr(os_process, "start", start)
    monkeypatch.setattr(ProcessId, "end", end)
    with pytest.raises(OSError, match="too many open files"):
        launcher.launch(ChildRecord("/node", NodeletKind.SCRIPT), ("true",))
    end.assert_called_once_with(0.0)


def test_lines_are_in_the_output_when_they_are_printed(launched, tmp_path, monkeypatch):
    launcher, _ = launched
    start = mock.Mock(return_value=ProcessId(1, 1))
    monkeypatch.setattr(os_process, "start", start)
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    launcher.launch(ChildRecord("/node", NodeletKind.SCRIPT), ("true",))
    environment = start.call_args[0][3]
    assert environment["ROSCONSOLE_STDOUT_LINE_BUFFERED"] == "1"
    output, command = tmp_path / "output", "import sys; print('up'); sys.stdin.read()"
    with output.open("w") as file, subprocess.Popen(
        [sys.executable, "-c", command],
        stdin=subprocess.PIPE,
        stdout=file,
        env={**os.environ, **environment},
    ):
        eventually(lambda: output.read_text() == "up\n")
