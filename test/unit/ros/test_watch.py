# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Looks at the nodelet managers: a manager with a reported change is looked at closely, once."""

from __future__ import annotations

import threading
from typing import Any, Iterator

import pytest

from dyknow.errors import DyKnowError
from dyknow.ros.manager import loops as watching
from dyknow.ros.manager.loops import Watch


class FakeManager:
    """Records requests for a close look; the first of them fails."""

    def __init__(self) -> None:
        self.graph = self
        self.busy: set[str] = set()
        self.looks: list[set[str]] = []
        self.after = 0
        self.done = threading.Condition()

    def is_busy(self, name: str) -> bool:
        return name in self.busy

    def look(self, changed: set[str]) -> None:
        self.looks.append(set(changed))
        if changed and sum(map(bool, self.looks)) == 1:
            raise DyKnowError("the first look fails")

    def note_after(self) -> None:
        with self.done:
            self.after += 1
            self.done.notify_all()

    def closely(self) -> list[set[str]]:
        return [each for each in self.looks if each]

    def await_close_looks(self, count: int) -> bool:
        with self.done:
            return self.done.wait_for(lambda: len(self.closely()) >= count, 10.0)


@pytest.fixture
def manager() -> FakeManager:
    return FakeManager()


@pytest.fixture
def watch(manager: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Watch]:
    monkeypatch.setattr(watching, "PERIOD", 0.01)
    made = Watch(manager, manager.note_after)
    made.start()
    yield made
    made.close(5.0)
    assert not made._worker.running


def test_what_is_named_is_looked_at_at_once(manager: FakeManager, watch: Watch) -> None:
    watch.refresh("/a")
    assert manager.await_close_looks(1)
    watch.refresh("/b")
    assert manager.await_close_looks(2)
    assert manager.closely() == [{"/a"}, {"/b"}]
    assert manager.after == len(manager.looks), "also after a look that failed"


def test_what_somebody_works_on_is_looked_at_again(manager: FakeManager, watch: Watch) -> None:
    manager.busy.add("/a")
    watch.refresh("/a")
    assert manager.await_close_looks(3)
    manager.busy.clear()

    def over() -> bool:
        return not manager.looks[-1]

    with manager.done:
        assert manager.done.wait_for(over, 10.0), "it is free, and looked at no more"
    assert set().union(*manager.looks) == {"/a"}
