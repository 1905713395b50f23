# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Processes end with their owner, and an owner whose process has ended is told how."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import psutil
import pytest

from dyknow.ros.process import owned
from dyknow.ros.process.owned import Processes, ProcessFailed

STUBBORN = (
    "import signal; [signal.signal(each, signal.SIG_IGN) for each in (2, 15)]; print('up', "
    "flush=True); signal.pause()"
)


def is_up(processes: Processes, number: int) -> bool:
    return processes.output(number).startswith("up")


def test_all_end_with_their_owner_however_stubborn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(owned, "END_TIMEOUT", 0.2)
    with Processes("test") as processes:
        for number in range(2):
            command = [sys.executable, "-c", STUBBORN]
            processes.start("it", command, ready=lambda: is_up(processes, number))  # noqa: B023
        pids, folder = [each.pid for each in processes.started], processes.folder
        processes.check()
    assert not [pid for pid in pids if psutil.pid_exists(pid)]
    assert not Path(folder).exists()


def test_one_that_ends_or_is_not_ready_is_named_with_its_output(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(owned, "START_TIMEOUT", 0.2)
    with Processes("test") as processes:
        with pytest.raises(ProcessFailed, match=r"late was not ready .* printed:\n\(nothing\)"):
            processes.start("late", ["sleep", "1000"], ready=lambda: False)
        processes.start("brief", [sys.executable, "-c", "print('why'); raise SystemExit(3)"])
        with pytest.raises(ProcessFailed, match=r"(?s)brief ended with exit code 3; .*why"):
            while True:
                processes.check(0.01)
                time.sleep(0.01)
