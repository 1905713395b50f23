# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Children of a DyKnow manager: their table answers at once, whatever the disk does."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Iterable, List, cast

import pytest

from dyknow.errors import HostError
from dyknow.model.graph import NodeletKind
from dyknow.periodic import in_background
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.process.os_process import ProcessId
from dyknow.ros.wire.master import Master

PATIENCE = 10.0
CONTEXT = PeerContext(Master("/manager"))


class SlowDisk:
    """A disk that accepts records only when allowed; keeps the last one."""

    def __init__(self) -> None:
        self.writing = threading.Event()
        self.go_on = threading.Event()
        self.writers = 0
        self.most_writers = 0
        self.fails = False

    def write(self, path: str, records: Iterable[ChildRecord]) -> None:
        self.writers += 1
        self.most_writers = max(self.most_writers, self.writers)
        self.writing.set()
        assert self.go_on.wait(PATIENCE)
        self.writers -= 1
        if self.fails:
            raise OSError("the disk is full")


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    disk = SlowDisk()
    monkeypatch.setattr(child_records, "write", disk.write)
    return disk


@pytest.fixture
def children(tmp_path: Path) -> Children:
    launcher: Any = SimpleNamespace(is_free=lambda name: True, running=list)
    return Children(CONTEXT, launcher, "/", str(tmp_path / "children.json"))


def test_a_slow_disk_holds_up_nobody_who_looks(children: Children, disk: SlowDisk) -> None:
    writer = in_background("adopting", children.adopt)
    assert disk.writing.wait(PATIENCE)
    looks: List[object] = []
    looker = in_background("looking", lambda: looks.extend([children.all(), children.crashes()]))
    looker.join(PATIENCE / 2)
    assert looks == [[], []]
    disk.go_on.set()
    writer.join(PATIENCE)
    assert not writer.is_alive()


def test_records_are_written_one_after_the_other(children: Children, disk: SlowDisk) -> None:
    writers = [in_background("adopting", children.adopt) for _ in range(4)]
    assert disk.writing.wait(PATIENCE)
    disk.go_on.set()
    for writer in writers:
        writer.join(PATIENCE)
    assert disk.most_writers == 1


def test_what_the_disk_did_not_take_is_written_later_and_told_once(
    children: Children, disk: SlowDisk, caplog: pytest.LogCaptureFixture
) -> None:
    disk.fails = True
    disk.go_on.set()
    children.adopt()
    children.echo()
    assert caplog.text.count("the disk is full") == 1
    disk.fails = False
    disk.writing.clear()
    children.echo()
    assert disk.writing.is_set()
    disk.writing.clear()
    children.echo()
    assert not disk.writing.is_set()


def test_no_child_is_begun_once_all_are_ended(children: Children, disk: SlowDisk) -> None:
    disk.go_on.set()
    children.end_all()
    with pytest.raises(HostError, match="being ended"):
        children.want(NodeletKind.PYTHON, 1)


class FakeLauncher:
    """Notes what is done, in order; its processes never come up."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.found: List[ChildRecord] = []
        self.cleaned: List[str] = []
        self.at_launch: List[ChildRecord] = []
        self.launched = threading.Event()

    def living(self, name: str) -> None:
        return None

    def is_free(self, name: str) -> bool:
        return True

    def registered(self, name: str) -> str:
        return ""

    def running(self) -> List[ChildRecord]:
        return self.found

    def follow(self, name: str) -> None:
        return None

    def is_up(self, kind: NodeletKind, name: str, stale: str) -> bool:
        return True

    def is_rewirable(self, kind: NodeletKind, name: str) -> bool:
        return True

    def clean_up(self, child: ChildRecord) -> None:
        self.cleaned.append(child.name)

    def launch(self, child: ChildRecord, command: object) -> object:
        self.at_launch = child_records.read(self.path)
        self.launched.set()
        raise OSError("no process")


@pytest.fixture
def launcher(tmp_path: Path) -> FakeLauncher:
    return FakeLauncher(str(tmp_path / "children.json"))


def test_what_died_while_there_was_no_manager_is_cleaned_up_after(launcher: FakeLauncher) -> None:
    here = ProcessId.of(os.getpid())
    assert here is not None
    gone = ProcessId(here.pid, here.started + 1)
    records = [
        ChildRecord("/dead", NodeletKind.CPP, "", gone),
        ChildRecord("/lives", NodeletKind.PYTHON, "", here),
        ChildRecord("/node", NodeletKind.SCRIPT, "/node", gone),
        ChildRecord("/was_to_be_started", NodeletKind.PYTHON, "/n"),
    ]
    child_records.write(launcher.path, records)
    children = Children(CONTEXT, cast(Any, launcher), "/", launcher.path)
    assert children.adopt() == ["/lives"]
    assert launcher.cleaned == ["/dead", "/node", "/was_to_be_started"]
    assert child_records.read(launcher.path) == records[1:2]


@pytest.mark.parametrize("text", ["", "[]", '[{"name": "/lives"}]'])
def test_what_runs_is_taken_over_without_a_record(launcher: FakeLauncher, text: str) -> None:
    launcher.found = [ChildRecord("/lives", NodeletKind.CPP, "", ProcessId.of(os.getpid()))]
    Path(launcher.path).write_text(text)
    assert Children(CONTEXT, cast(Any, launcher), "/", launcher.path).adopt() == ["/lives"]
    assert child_records.read(launcher.path) == launcher.found


def test_a_record_is_there_before_the_process(launcher: FakeLauncher) -> None:
    children = Children(CONTEXT, cast(Any, launcher), "/", launcher.path)
    children.want(NodeletKind.PYTHON, 1)
    assert launcher.launched.wait(PATIENCE)
    assert [each.name for each in launcher.at_launch] == ["/dyknow_nodelet_manager"]
    children.end_all()
