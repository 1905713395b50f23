# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Processes by id and start time, and those that end with their owner or without their name."""

from __future__ import annotations

import _thread
import fcntl
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
from clocks import PATIENCE, eventually, in_thread, join, patch_here
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import StoreError
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.nodelets import owner as owner_module
from dyknow.ros.nodelets import peer_services
from dyknow.ros.nodelets.owner import OwnerLock, wait_until_orphaned
from dyknow.ros.nodelets.peer_services import watch_name
from dyknow.ros.process import os_process, owned, signals
from dyknow.ros.process.os_process import LogTail, ProcessId
from dyknow.ros.process.owned import Processes, ProcessFailed


def python(code):
    return (sys.executable, "-c", code)


SLEEP = python("import time; print('up', flush=True); time.sleep(1000)")
EXITS = python("import os; os._exit(3)")
STUBBORN = python("""
import signal, time
for each in (signal.SIGINT, signal.SIGTERM):
    signal.signal(each, signal.SIG_IGN)
print("up", flush=True)
time.sleep(1000)
""")
FORKS = python("""
import os, signal, sys, time
pid = os.fork()
if not pid and "stubborn" in sys.argv:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
if not pid:
    print("up", os.getpid(), flush=True)
time.sleep(1000)
""")
#: Sends SIGTERM to its forked process first, then to itself.
HANDLES = """
import os, queue, signal, threading, time
from dyknow.ros.process.signals import on_signals
told = queue.SimpleQueue()
on_signals([signal.SIGTERM], lambda: told.put("to end"))
readable, writable = os.pipe()
pid = os.fork()
if not pid:
    os.write(writable, b"up")
    time.sleep(1000)
os.read(readable, 2)
os.kill(pid, signal.SIGTERM)
_, status = os.waitpid(pid, 0)
print("forked:", -os.WTERMSIG(status), flush=True)
assert told.empty()
os.kill(os.getpid(), signal.SIGTERM)
print(told.get(), flush=True)
"""


def start(tmp_path, command=SLEEP):
    """Start a process and wait until it is up: until its first line is whole."""
    output = tmp_path / "output"
    found = os_process.start(command, str(output), str(tmp_path))
    while "\n" not in output.read_text():
        assert found.alive
        time.sleep(0.01)
    return found


def test_the_end_of_a_child_is_noticed_and_how_it_ended(tmp_path):
    found = start(tmp_path)
    found.signal(signal.SIGSTOP)
    assert found.alive, "a stopped process is"
    assert not found.wait(0.05)
    found.signal(signal.SIGSEGV)
    found.signal(signal.SIGCONT)
    assert found.wait_for_rest() == -signal.SIGSEGV
    assert not found.alive
    found.signal(signal.SIGKILL)  # no process is there to get it
    assert found.wait(PATIENCE)
    assert found.wait_for_rest() is None  # it was returned already, or this is not a child
    assert os_process.start(EXITS, str(tmp_path / "o"), str(tmp_path)).wait_for_rest() == 3


@pytest.mark.parametrize("stubborn", [False, True])
def test_what_a_child_forked_ends_with_it(tmp_path, stubborn, monkeypatch):
    monkeypatch.setattr(os_process, "_REST_PATIENCE", 0.05)
    found = start(tmp_path, (*FORKS, "stubborn") if stubborn else FORKS)
    forked = ProcessId.of(int((tmp_path / "output").read_text().split()[1]))
    assert forked is not None
    found.signal(signal.SIGKILL)
    try:
        assert found.wait_for_rest() == -signal.SIGKILL
        assert not forked.alive
    finally:
        forked.signal(signal.SIGKILL)


def test_a_forked_process_has_signals_of_its_own():
    process = subprocess.run(python(HANDLES), timeout=PATIENCE, stdout=subprocess.PIPE, text=True)
    assert process.stdout == f"forked: {-signal.SIGTERM}\nto end\n"


@pytest.mark.parametrize("has_pidfd", [True, False])
def test_the_end_of_another_process_is_noticed(has_pidfd, monkeypatch):
    if not has_pidfd:
        monkeypatch.setattr(os_process, "_pidfd", lambda pid: None)
    with subprocess.Popen(SLEEP, stdout=subprocess.DEVNULL) as child:
        found = ProcessId.of(child.pid)
        assert found is not None
        assert not ProcessId(found.pid, found.started + 1).alive
        assert not found.wait(0.05)
        threading.Timer(0.1, child.kill).start()
        assert found.wait(PATIENCE)


def test_a_process_that_has_begun_lately_is_found_by_its_words(tmp_path, monkeypatch):
    monkeypatch.setenv("MINE", "one")
    found = start(tmp_path, (*SLEEP, "/lib/dyknow/manager"))
    wanted, other = re.compile(rb"/dyknow/manager(\0|$)"), re.compile(rb"dyknow/manage(\0|$)")
    try:
        assert os_process.has_begun(wanted, "MINE", 1000.0)
        assert not os_process.has_begun(other, "MINE", 1000.0)
        assert not os_process.has_begun(wanted, "MINE", 0.0)
        monkeypatch.setenv("MINE", "another")
        assert not os_process.has_begun(wanted, "MINE", 1000.0)
    finally:
        found.end(1.0)


@pytest.mark.parametrize("command", [SLEEP, STUBBORN])
def test_end_asks_and_then_forces(tmp_path, command):
    found = start(tmp_path, command)
    found.end(0.2)
    assert not found.alive


def test_processes_are_known_by_their_environment(tmp_path):
    name = ChildRecord("/robot/n", NodeletKind.CPP, "/robot/x")
    lock = str(tmp_path / "lock")  # other processes may run this test at the same time
    tag = {child_records.TAG: child_records.to_tag(name, lock)}
    output = str(tmp_path / "output")
    found = os_process.start((*SLEEP, "__name:=n"), output, str(tmp_path), tag)
    other = os_process.start(SLEEP, output, str(tmp_path), tag)  # a program that it started
    try:
        expected = [replace(name, process=found)]
        # Linux shows the environment a bit late.
        eventually(lambda: child_records.running(lock) == expected)
        assert child_records.running(f"another {lock}") == []
        found.end(1.0)
        assert child_records.running(lock) == []
    finally:
        found.end(1.0)
        other.end(1.0)


def test_an_owner_that_returns_in_time_is_an_owner(tmp_path, monkeypatch):
    """Also if it goes again: its time is counted from then on."""
    asleep, awake, looks = queue.SimpleQueue(), queue.SimpleQueue(), queue.SimpleQueue()
    lock, path = owner_module._lock, str(tmp_path / "lock")

    def sleep(seconds):
        asleep.put(seconds)
        awake.get(timeout=PATIENCE)

    def look(file, operation):
        taken = lock(file, operation)
        if threading.current_thread() is not threading.main_thread() and operation & fcntl.LOCK_NB:
            looks.put(taken)
        return taken

    owner = OwnerLock(path)
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=sleep)
    monkeypatch.setattr(owner_module, "time", clock)
    monkeypatch.setattr(owner_module, "_lock", look)
    waiter = in_thread(lambda: wait_until_orphaned(path, 3.0))
    owner.release()
    for returns in (False, True, False, False, False):
        assert asleep.get(timeout=PATIENCE) == 1.0
        if returns:
            owner = OwnerLock(path)
        awake.put(None)
        assert looks.get(timeout=PATIENCE) is not returns
        owner.release()
    join(waiter)
    with open(path) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # no process holds it


def test_there_is_one_owner_also_while_a_stopped_process_keeps_the_lock(tmp_path, monkeypatch):
    monkeypatch.setattr(owner_module, "_CONTENTION", 0.05)
    path = str(tmp_path / "folder" / "lock")
    wait_until_orphaned(path, 0.01)  # a file that is not there has no owner
    OwnerLock(path).release()
    with open(path) as waiting:
        fcntl.flock(waiting, fcntl.LOCK_SH)  # as it is between the owner's end and its noticing
        owner = OwnerLock(path)
        with pytest.raises(StoreError, match="another manager"):
            OwnerLock(path)
    eventually(lambda: not _is_free(path))  # it gave way: now the owner has the lock
    owner.release()


def _is_free(path):
    with open(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


@pytest.mark.parametrize("at_end", [False, True])
def test_an_output_is_followed_and_cut_once_it_is_copied(tmp_path, capsys, monkeypatch, at_end):
    monkeypatch.setattr(os_process, "_LONGEST", 10)
    path = tmp_path / "output"
    path.write_text("old\n")
    tail = LogTail(str(path), at_end=at_end)
    tail.copy(sys.stdout)
    assert capsys.readouterr().out == ("" if at_end else "old\n")
    with path.open("a") as file:
        for line in ("a long line\n", "short\n", "another\n", "last\n"):
            file.write(line)
            file.flush()
            for said in (line, ""):
                tail.copy(sys.stdout)
                assert capsys.readouterr().out == said
    assert path.read_text() == "last\n"


@pytest.mark.parametrize("after", [0, 3])
def test_an_output_in_parts_of_characters_is_copied(tmp_path, capsys, monkeypatch, after):
    monkeypatch.setattr(os_process, "_CHUNK", 3)
    path, text = tmp_path / "output", "größer"
    tail = LogTail(str(path))
    with path.open("ab", buffering=0) as file:
        for part in (text.encode()[:after], text.encode()[after:]):
            file.write(part)
            tail.copy(sys.stdout)
    assert capsys.readouterr().out == text


def test_an_output_is_locked_while_its_process_runs(tmp_path):
    output = tmp_path / "output"
    assert not os_process.is_locked(output), "it is not there"
    output.write_text("of an earlier life\n")
    found = os_process.start(("sh", "-c", "echo new; exec sleep 1000"), str(output), str(tmp_path))
    try:
        eventually(lambda: output.read_text() == "new\n")
        assert os_process.is_locked(output)
    finally:
        found.end(0.0)
    eventually(lambda: not os_process.is_locked(output))


# Processes that end with their owner, which learns how one has ended


def test_all_end_with_their_owner_however_stubborn(monkeypatch):
    monkeypatch.setattr(owned, "END_TIMEOUT", 0.2)
    with Processes("test") as processes:
        for number in range(2):
            is_up = lambda n=number: processes.output(n).startswith("up")  # noqa: E731
            processes.start("it", [*STUBBORN], ready=is_up)
        pids, folder = [each.pid for each in processes.started], processes.folder
        processes.check()
    assert not [pid for pid in pids if psutil.pid_exists(pid)]
    assert not Path(folder).exists()


def test_one_that_ends_or_is_not_ready_is_named_with_its_output(monkeypatch):
    monkeypatch.setattr(owned, "START_TIMEOUT", 0.2)
    with Processes("test") as processes:
        with pytest.raises(ProcessFailed, match=r"late was not ready .* printed:\n\(nothing\)"):
            processes.start("late", ["sleep", "1000"], ready=lambda: False)
        processes.start("brief", [*python("print('why'); raise SystemExit(3)")])
        with pytest.raises(ProcessFailed, match=r"(?s)brief ended with exit code 3; .*why"):
            while True:
                processes.check(0.01)
                time.sleep(0.01)


# A node that lost its name to another one ends, however late it learns of it


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
    watch_name("/twin", elder.uri, reasons.put, lambda: None)
    assert goes_on(reasons)
    del graph.nodes["/twin"]  # a new master has no registrations
    assert goes_on(reasons)
    graph.nodes["/twin"] = SmallManager()
    assert "another node bears the name /twin" in reasons.get(timeout=PATIENCE)


def test_a_node_goes_on_while_the_master_is_away(graph):
    graph.nodes["/twin"] = elder = SmallManager()
    reasons = queue.Queue()
    graph.close()
    watch_name("/twin", elder.uri, reasons.put, lambda: None)
    assert goes_on(reasons, 0.3)


def test_a_new_master_that_does_not_get_to_know_it_is_told_once(graph):
    graph.nodes["/twin"] = elder = SmallManager()
    told = queue.Queue()
    watch_name("/twin", elder.uri, told.put, lambda: told.put("forgotten"))
    assert goes_on(told)
    del graph.nodes["/twin"]
    assert told.get(timeout=PATIENCE) == "forgotten"
    assert goes_on(told)


@pytest.mark.parametrize(("before", "is_step"), [(110.0, True), (100.05, False), (90.0, False)])
def test_threads_reckon_their_waits_anew_when_the_clock_was_set_back(monkeypatch, before, is_step):
    """By a signal, before Python 3.9. One that others have begun may have ended, and gets none."""
    is_over, nudged, foreign = threading.Event(), [], []

    def be_foreign():
        threading.current_thread()
        foreign.append(threading.get_ident())
        is_over.wait()

    clock = SimpleNamespace(time=lambda: 100.0, monotonic=lambda: 0.0)
    monkeypatch.setattr(signals, "time", clock)
    patch_here(monkeypatch, signal, "pthread_kill", lambda *call: nudged.append(call))
    waiting = in_thread(is_over.wait)
    _thread.start_new_thread(be_foreign, ())
    eventually(lambda: foreign)
    try:
        assert signals.nudge_after_step(before) == 100.0
    finally:
        is_over.set()
        join(waiting)
        known: Any = threading
        del known._active[foreign[0]]  # nothing else does
    assert ((waiting.ident, signal.SIGURG) in nudged) is is_step
    assert not {(foreign[0], signal.SIGURG)} & {*nudged}
