# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Every unit test runs with locks that assert their order, and fails where it is not kept.

Property tests have the profile that the environment asks for. With ``DYKNOW_DELAYS`` set there,
threads are delayed at random.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import tempfile
import threading
from pathlib import Path
from typing import Iterator

import delays
import pytest
from property_tests import register_profiles

_directory = tempfile.TemporaryDirectory()
_report = Path(_directory.name, "violations")
# Before dyknow is imported: the locks of modules are made then. Children report here as well.
os.environ["DYKNOW_LOCK_REPORT"] = str(_report)
# Qt aborts the process where there is no screen.
os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

register_profiles()
if "DYKNOW_DELAYS" in os.environ:
    delays.install()


@pytest.fixture(autouse=True)
def no_lock_violations() -> Iterator[None]:
    before = _violations()
    yield
    found = _violations()[len(before) :]
    assert not found, f"the policy of doc/locks.rst was not kept:\n{found}"


@pytest.fixture(autouse=True)
def only_own_records(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Leave out of ``caplog`` the records of threads that an earlier test has left."""
    earlier = {*threading.enumerate()} - {threading.current_thread()}

    def is_own(record: object) -> bool:
        return threading.current_thread() not in earlier

    caplog.handler.addFilter(is_own)
    yield
    caplog.handler.removeFilter(is_own)


@pytest.fixture
def heeded_signals() -> Iterator[None]:
    """Signals do what they do by default, also under nohup or in the background of a shell."""
    both = (signal.SIGINT, signal.SIGHUP)
    ignored = [each for each in both if signal.getsignal(each) is signal.SIG_IGN]
    for each in ignored:
        signal.signal(each, signal.SIG_DFL)
    yield
    for each in ignored:
        signal.signal(each, signal.SIG_IGN)


@pytest.fixture
def impatient_interpreter() -> Iterator[None]:
    """Threads take turns as often as they can, so in the middle of everything."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


class ThreadLimit:
    """Refuses the threads of a name, after the first ``spared`` ones, as long as it is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.name, self.spared = "", 0
        start = threading.Thread.start

        def limited(thread: threading.Thread) -> None:
            if self.name and self.name in thread.name:
                self.spared -= 1
                if self.spared < 0:
                    raise RuntimeError("can't start new thread")
            start(thread)

        monkeypatch.setattr(threading.Thread, "start", limited)

    def refuse(self, name: str) -> None:
        self.name = name

    @contextlib.contextmanager
    def reaches(self, name: str, spared: int = 0) -> Iterator[None]:
        """Within, a thread of that name is refused, as the caller learns."""
        self.name, self.spared = name, spared
        with pytest.raises(RuntimeError, match="can't start new thread"):
            yield
        self.name, self.spared = "", 0


@pytest.fixture
def limit(monkeypatch: pytest.MonkeyPatch) -> ThreadLimit:
    return ThreadLimit(monkeypatch)


def _violations() -> str:
    return _report.read_text() if _report.exists() else ""
