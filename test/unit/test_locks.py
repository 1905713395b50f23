# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The two kinds of locks, and the debug mode that asserts their order."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import pytest

from dyknow import locks
from dyknow.locks import CheckedLock, Checker, LockViolation


@pytest.fixture
def report(tmp_path: Path) -> Path:
    return tmp_path / "violations"


@pytest.fixture
def checker(report: Path) -> Checker:
    return Checker(str(report))


def test_the_locks_of_unit_tests_are_checked() -> None:
    assert isinstance(locks.state_lock("bus"), CheckedLock)


def test_locks_are_those_of_threading_unless_they_are_checked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(locks, "_checker", None)
    assert type(locks.state_lock("bus")) is type(threading.Lock())
    assert type(locks.turn_lock("reconfiguration")) is type(threading.Lock())
    assert type(locks.reentrant_state_lock("messages")) is type(threading.RLock())
    assert type(locks.state_condition("x")) is threading.Condition
    locks.assert_no_state_lock("a call")


def test_every_lock_is_named_once_and_turns_come_first() -> None:
    with pytest.raises(ValueError, match="a new one"):
        locks.turn_lock("a new one")
    assert len(set(locks.ORDER)) == len(locks.ORDER)
    assert locks.ORDER[: len(locks.TURNS)] == tuple(locks.TURNS)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("messages", "bus"),  # out of order
        ("bus", "reconfiguration"),  # a turn under a state lock
        ("bus", "bus"),  # two of the same kind: two threads may take them crosswise
        ("one of many", "another"),  # locks that are not in the order do not nest
    ],
)
def test_a_lock_taken_out_of_order_is_reported_and_refused(
    checker: Checker, report: Path, first: str, second: str
) -> None:
    outer, inner = CheckedLock(checker, first), CheckedLock(checker, second)
    with outer:
        with pytest.raises(LockViolation, match=f"'{second}' is taken while .* '{first}' is held"):
            inner.acquire()
        assert checker.held == [outer]
    assert f"'{second}' is taken" in report.read_text()
    assert __file__ in report.read_text()


def test_a_holder_may_take_a_reentrant_lock_again_and_no_other(checker: Checker) -> None:
    lock = CheckedLock(checker, "messages", reentrant=True)
    with lock, lock:
        pass
    plain = CheckedLock(checker, "bus")
    with plain, pytest.raises(LockViolation, match="the thread that holds it"):
        plain.acquire()
    assert checker.held == []


def test_calling_out_is_allowed_in_turns_and_not_under_state_locks(checker: Checker) -> None:
    with CheckedLock(checker, "service client"):
        checker.check_calling_out("a call")
        with CheckedLock(checker, "graph"), pytest.raises(LockViolation, match="a call while"):
            checker.check_calling_out("a call")


def test_waiting_gives_up_the_own_lock_and_must_not_hold_another(checker: Checker) -> None:
    condition = threading.Condition(CheckedLock(checker, "quiet", reentrant=True))  # type: ignore[arg-type]
    with condition, condition:
        assert not condition.wait(0.001)
        assert len(checker.held) == 2
    waiting = pytest.raises(LockViolation, match="waiting for 'quiet'")
    with CheckedLock(checker, "bus"), condition, waiting:
        condition.wait(0.001)
    assert checker.held == []


def test_every_lock_is_made_here() -> None:
    root = Path(__file__).parents[2]
    made = re.compile(r"\bthreading\.(R?Lock|Condition)\(")
    elsewhere = [
        str(file.relative_to(root))
        for package in ("dyknow", "dyknow_benchmark", "dyknow_demo", "dyknow_rqt")
        for file in sorted((root / package).rglob("*.py"))
        if made.search(file.read_text()) and file.name != "locks.py"
    ]
    assert elsewhere == []
