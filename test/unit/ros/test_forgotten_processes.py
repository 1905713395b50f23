# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Processes that come and go leave nothing with the manager: no entry, no connection, no file."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Iterator, List, Tuple

import pytest
from unit.ros.small_graph import SmallMaster

from dyknow.manager.host import Crash, ManagerState
from dyknow.manager.suspects import MEMORY, Suspects
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting import launcher as launcher_module
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.host import RosHost, _Failure
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.log_tail import LogTail
from dyknow.ros.master import Master
from dyknow.ros.os_process import ProcessId

NODE = ManagerState("/n", NodeletKind.NODE, "first", own=False)


class Children:
    """None."""

    def all(self) -> List[Any]:
        return []


@pytest.fixture
def host() -> Iterator[RosHost]:
    with contextlib.closing(SmallMaster()) as graph:
        registrar: Any = SimpleNamespace()
        children: Any = Children()
        made = RosHost(Master("/test", graph.uri), children, registrar)
        yield made
        made.close()


def tables(host: RosHost) -> List[Tuple[str, Any]]:
    """What is kept by process."""
    owners = [host, host._guards, host._collector, host._list_clients, host._nodes]
    return [
        (f"{type(owner).__name__}.{name}", value)
        for owner in owners
        for name, value in vars(owner).items()
        if isinstance(value, dict)
    ]


def test_a_process_that_is_gone_is_forgotten(
    host: RosHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    present = [NODE]
    monkeypatch.setattr(host._nodes, "all", lambda: list(present))
    host.managers()
    host.counts({NODE.name: ["/n"]})
    client = host._list_clients.of(NODE.name, NODE.incarnation, NODE.kind)
    host._failures[NODE.name, "/n"] = _Failure.LATE
    host.note_detail(NODE.name, "/n", "a callback has been running for 12 s")
    kept = [name for name, table in tables(host) if table]
    assert len(kept) >= 5, kept
    host.managers()
    assert host._list_clients.of(NODE.name, NODE.incarnation, NODE.kind) is client
    present.clear()
    host.managers()
    assert [name for name, table in tables(host) if table] == []


def test_old_accusations_are_forgotten() -> None:
    now = [0.0]
    suspects = Suspects(lambda: now[0])
    for number in range(50):
        now[0] += MEMORY
        suspects.accuse(Crash("/manager", "SIGSEGV", frozenset([2 * number])), [])
    assert len(suspects._accounts) <= 2


@pytest.fixture
def launcher(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Launcher:
    def start(command: Any, output: str, *rest: Any) -> ProcessId:
        Path(output).write_text("it runs\n")
        Path(output + ".owner").touch()
        return ProcessId(1, 1)

    monkeypatch.setattr(launcher_module.os_process, "start", start)
    monkeypatch.setattr(launcher_module.rospkg, "get_log_dir", lambda: str(tmp_path))
    master: Any = SimpleNamespace(
        uri="http://here:1", caller="/test", ask=lambda *args: "", node=lambda name: ""
    )
    owner: Any = SimpleNamespace(path="lock")
    return Launcher(master, owner, 0.0, {})


def test_outputs_of_the_last_processes_are_kept(launcher: Launcher, tmp_path: Path) -> None:
    tails = []
    for number in range(30):
        name = f"/n{number}"
        _, tail = launcher.launch(ChildRecord(name, NodeletKind.PYTHON))
        tails.append(tail)
        if number != 3:
            launcher.clean_up(ChildRecord(name, NodeletKind.PYTHON))
    (folder,) = tmp_path.iterdir()
    left = sorted(each for each in os.listdir(folder) if each.endswith(".log"))
    assert "n3-output.log" in left, "it runs"
    assert "n29-output.log" in left
    assert len(left) == 1 + launcher_module._OUTPUTS
    assert len(os.listdir(folder)) == 2 * len(left)
    assert all(isinstance(tail, LogTail) for tail in tails)


def test_the_output_of_a_process_that_runs_again_is_kept(launcher: Launcher) -> None:
    for number in range(30):
        launcher.launch(ChildRecord("/again", NodeletKind.PYTHON))
        launcher.launch(ChildRecord(f"/n{number}", NodeletKind.PYTHON))
        launcher.clean_up(ChildRecord(f"/n{number}", NodeletKind.PYTHON))
        assert launcher.last_line("/again") == "it runs"
        launcher.clean_up(ChildRecord("/again", NodeletKind.PYTHON))
