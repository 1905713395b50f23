# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Children of a DyKnow manager: their table answers at once, whatever the disk does."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Iterable, List

import pytest

from dyknow.errors import HostError
from dyknow.model.graph import NodeletKind
from dyknow.periodic import in_background
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.children import Children

PATIENCE = 10.0


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
    launcher: Any = SimpleNamespace(living=lambda name: None)
    return Children(launcher, "/", str(tmp_path / "children.json"))


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
