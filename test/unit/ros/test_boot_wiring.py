# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The wiring of a start: when it is loaded, again, and not."""

from __future__ import annotations

from pathlib import Path
from typing import List

import pytest
from clocks import HandClock

from dyknow.errors import BadParameter, DyKnowError, Problem, SpecificationError
from dyknow.manager.store import Store
from dyknow.ros.manager.boot_wiring import BootWiring


class Boot:
    """A state, a file, and its loaded versions."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.store = Store(":memory:")
        self.clock = HandClock()
        self.loaded: List[bytes] = []
        self.trouble = ""

    def start(self) -> BootWiring:
        return BootWiring(str(self.file), self.store, self.check, self.load, self.clock.now)

    def check(self, data: bytes, file: str) -> None:
        if data == b"wrong":
            raise SpecificationError([Problem(file, 3, "expected <wiring>")])

    def load(self, data: bytes, file: str) -> None:
        if self.trouble:
            raise DyKnowError(self.trouble)
        self.loaded.append(data)


@pytest.fixture
def boot(tmp_path: Path) -> Boot:
    file = tmp_path / "robot.xml"
    file.write_bytes(b"one")
    return Boot(file)


def test_a_file_is_loaded_once_for_each_of_its_versions(boot: Boot) -> None:
    wiring = BootWiring("", boot.store, boot.check, boot.load)
    assert not wiring.is_due and wiring.work() is None, "no file is nothing to load"
    for _ in range(2):
        wiring = boot.start()
        assert wiring.work() is None and wiring.work() is None
    assert boot.loaded == [b"one"]
    boot.file.write_bytes(b"two")
    boot.start().work()
    assert boot.loaded == [b"one", b"two"]
    boot.start().forget()
    boot.start().work()
    assert boot.loaded == [b"one", b"two", b"two"]


def test_what_cannot_be_loaded_now_is_tried_again(
    boot: Boot, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "rosout")
    wiring = boot.start()
    boot.trouble = "no camera"
    pauses = []
    for _ in range(4):
        pause = wiring.work()
        assert pause is not None
        pauses.append(pause)
        boot.clock.time += pause
    assert pauses == sorted(pauses) and pauses[0] == 1.0 and pauses[-1] > 4.0
    assert boot.start().is_due, "the next life tries it too"
    boot.trouble = ""
    assert wiring.work() is None
    assert boot.loaded == [b"one"]
    levels = [record.levelname for record in caplog.records]
    assert levels == ["WARNING", "INFO"], "a boot that ends well has no error"


@pytest.mark.parametrize("is_there", [False, True])
def test_a_missing_or_wrong_file_is_refused_unless_one_was_loaded(
    boot: Boot, is_there: bool
) -> None:
    words = "line 3|:3: expected <wiring>" if is_there else "No such file"
    boot.file.write_bytes(b"wrong") if is_there else boot.file.unlink()
    with pytest.raises(BadParameter, match=rf"~wiring.*robot.xml.*({words})"):
        boot.start()
    boot.file.write_bytes(b"one")
    boot.start().work()
    boot.file.write_bytes(b"wrong") if is_there else boot.file.unlink()
    wiring = boot.start()
    assert wiring.work() is None
    assert boot.loaded == [b"one"]
