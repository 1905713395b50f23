# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Locks of two kinds, in one order, which a debug mode asserts.

A *state lock* guards memory and is held for microseconds, never over a call or a wait. A
*turn* is held over such calls, each of which has a time limit, so waiting for a turn ends too.
A thread that holds locks takes only locks that come later in ``ORDER``. ``doc/locks.rst`` has the
policy with its reasons.

The functions below return the locks of ``threading``. Where the environment variable
``DYKNOW_LOCK_REPORT`` names a file, they return locks that check the policy: a violation is
appended to that file, with the stack, and raised where it happens.
"""

from __future__ import annotations

import os
import threading
import traceback
from typing import Any, cast

#: Stands in ``ORDER`` for all state locks that are not named there; they never nest.
OTHER_STATE_LOCKS = "every other state lock"

#: Every turn, the outermost first.
TURNS: dict[str, str] = {
    "black box": "one bag at a time",
    "end of a script": "the node of a script in a process of its own, until it is withdrawn",
    "simulated manager": "one call at a time to the simulated manager",
    "claim request": "one request for a stream at a time",
    "claim work": "making and mending claims: requests and the reconciler's rounds take turns",
    "look at nodelet managers": "one look of the observer at all nodelet managers at a time",
    "model on its topic": "which model was published last",
    "counts of messages": "one count of all nodelets' messages at a time",
    "services of fixed nodelets": "the services of the manager for nodelets with fixed topics",
    "opening of a stream session": "a session with one manager, from its first stream to its last",
    "library": "changes of the library reach the disk in the order of the memory",
    "nodelets on disk": "changes of nodelets, and the revision, reach the disk in that order",
    "claims on disk": "changes of claims reach the disk in the order of the memory",
    "parts of model messages": "what is kept of one message of the model for the next",
    "bonds of claims": "changes of claims are followed one after the other",
    "grants to processes": "guards and producers of claims: older ones never replace newer",
    "reconfiguration": "one change of a nodelet's ports at a time: declared, connected elsewhere",
    "messages of bonds": "what is sent on a bond's topic, until it is withdrawn",
    "output of a child": "how far a file was read that a process prints into",
    "service client": "the one connection of a persistent service client",
    "backup of the state file": "the copy of the manager's database that is being made",
    "state file": "the manager's database",
}

#: State locks that are held while others are taken, the outermost first.
STATE_LOCKS: dict[str, str] = {
    "port": "the handles that share an out-port",
    "bus": "topics of the process, and who publishes and receives on them",
    OTHER_STATE_LOCKS: "one object each; none of them is held while another one is taken",
    "running clock": "the time for which the process has run",
    "event queue": "events on their way to a listener, in the order in which they were added",
    "control loop": "the times of its keys; woken under the locks of what changed",
    "messages": "queues and routes; every message passes under it",
}

ORDER: tuple[str, ...] = (*TURNS, *STATE_LOCKS)


class LockViolation(AssertionError):
    """The policy of locks was not kept."""


def turn_lock(name: str) -> threading.Lock:
    """Make a lock, of ``TURNS``, that is held over remote calls, disk writes and waits."""
    if name not in TURNS:
        raise ValueError(f"'{name}' is not in the order of turns")
    return threading.Lock() if _checker is None else _checked(_checker, name)


def state_lock(name: str) -> threading.Lock:
    """Make a lock for memory, of ``STATE_LOCKS`` if other locks are taken under it."""
    return threading.Lock() if _checker is None else _checked(_checker, name)


def reentrant_state_lock(name: str) -> Any:
    """Make a state lock that its holder may take again."""
    return threading.RLock() if _checker is None else CheckedLock(_checker, name, reentrant=True)


def state_condition(name: str, lock: Any = None) -> threading.Condition:
    """Make a condition on a state lock, reentrant as that of ``threading``; it may share one.

    A wait gives up the lock of the condition, so it may be the only state lock that is held.
    """
    return threading.Condition(lock or reentrant_state_lock(name))


def flag_lock() -> threading.Lock:
    """Make a lock that guards nothing: a flag that one thread takes and another one releases.

    To wait for it costs half of what waiting for a condition does.
    """
    return threading.Lock()


def assert_no_state_lock(what: str) -> None:
    """Assert, in debug mode, that the thread may make the call ``what`` now."""
    if _checker is not None:
        _checker.check_calling_out(what)


class Checker:
    """Knows which locks each thread holds; appends violations to the file at ``path``, if any."""

    def __init__(self, path: str = "") -> None:
        self._path = path
        self._threads = threading.local()

    @property
    def held(self) -> list[CheckedLock]:
        locks: list[CheckedLock] | None = getattr(self._threads, "locks", None)
        if locks is None:
            locks = self._threads.locks = []
        return locks

    def check_taking(self, lock: CheckedLock) -> None:
        """Report a lock that is taken out of order."""
        held = self.held
        if lock in held:
            if not lock.reentrant:
                self._violated(f"{lock} is taken by the thread that holds it")
            return
        for other in held:
            if lock.rank <= other.rank:
                self._violated(f"{lock} is taken while {other} is held")

    def check_calling_out(self, what: str, but: CheckedLock | None = None) -> None:
        """Report a call or a wait while a state lock is held, ``but`` the one it gives up."""
        for lock in self.held:
            if lock.is_state and lock is not but:
                self._violated(f"{what} while {lock} is held")

    def _violated(self, message: str) -> None:
        if self._path:
            stack = "".join(traceback.format_stack()[:-2])
            with open(self._path, "a") as file:
                file.write(f"{message} (thread '{threading.current_thread().name}')\n{stack}\n")
        raise LockViolation(message)


class CheckedLock:
    """A lock of ``threading`` that reports its holder to a checker."""

    def __init__(self, checker: Checker, name: str, reentrant: bool = False) -> None:
        self.name = name
        self.reentrant = reentrant
        self.is_state = name not in TURNS
        self.rank = ORDER.index(name if name in ORDER else OTHER_STATE_LOCKS)
        self._checker = checker
        self._lock: Any = threading.RLock() if reentrant else threading.Lock()
        self._holder: list[CheckedLock] = []

    def __str__(self) -> str:
        return f"{'state lock' if self.is_state else 'turn'} '{self.name}'"

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        self._checker.check_taking(self)
        taken: bool = self._lock.acquire(blocking, timeout)
        if taken:
            self._holder = self._checker.held
            self._holder.append(self)
        return taken

    def release(self) -> None:
        self._holder.remove(self)
        self._lock.release()

    def locked(self) -> bool:
        return bool(self._lock.locked())

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *unused: object) -> None:
        self.release()

    # What threading.Condition asks of its lock.

    def _release_save(self) -> int:
        self._checker.check_calling_out(f"waiting for '{self.name}'", but=self)
        depth = self._checker.held.count(self)
        for _ in range(depth):
            self.release()
        return depth

    def _acquire_restore(self, depth: int) -> None:
        for _ in range(depth):
            self.acquire()

    def _is_owned(self) -> bool:
        return self in self._checker.held


def _checked(checker: Checker, name: str) -> threading.Lock:
    return cast("threading.Lock", CheckedLock(checker, name))


_report = os.environ.get("DYKNOW_LOCK_REPORT", "")
_checker: Checker | None = Checker(_report) if _report else None
