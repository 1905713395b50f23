# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Child processes: started, adopted, restarted when they die, and ended.

They are nodelet managers, and nodes, each of which hosts itself alone.

Ownership: ``Children`` owns a table of names. A round of a child's loop is one life of its
process: it alone starts the process and waits for its end. A child has a session of its own, so it
outlives a manager that is killed; the next one finds it in the store (``child_records``), else by
its environment.
"""

from __future__ import annotations

import collections
import itertools
import logging
import math
import time
from dataclasses import replace
from functools import partial

from dyknow import names
from dyknow.backoff import Backoff
from dyknow.errors import HostError, NameTaken, PeerTimeout
from dyknow.locks import state_condition
from dyknow.manager.host import Crash
from dyknow.manager.store import Store
from dyknow.model.graph import NodeletKind
from dyknow.periodic import in_background
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child import NOT_UP, PATIENCE, START_TIMEOUT, STEP, Child, incarnation_of
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.process.os_process import ProcessId

#: Crashes that are remembered.
_CRASHES = 100
#: Seconds to wait for a child of an earlier manager, which may just have been started.
_ADOPTION_TIMEOUT = 5.0
#: Seconds before a nodelet manager that died twice is started again.
_FIRST_PAUSE = 0.25
_TAKEN = "another node has that name"
_BASES = {
    NodeletKind.PYTHON: "dyknow_nodelet_manager",
    NodeletKind.CPP: "dyknow_cpp_nodelet_manager",
}

_log = logging.getLogger("rosout.dyknow")


class Children:
    """The processes of one DyKnow manager; every method is safe from any thread."""

    def __init__(
        self, context: PeerContext, launcher: Launcher, namespace: str, store: Store
    ) -> None:
        """Prepare; ``namespace`` is that of shared children, ``store`` has the records."""
        self._context = context
        self._launcher = launcher
        self._namespace = namespace
        self._store = store
        #: Held while a child is changed, and notified of it.
        self._changed = state_condition("children")
        self._children: dict[str, Child] = {}
        self._crashes: collections.deque[Crash] = collections.deque(maxlen=_CRASHES)
        self._deaths = Backoff(time.monotonic, _FIRST_PAUSE, tolerated=2)
        self._ending = False

    def adopt(self) -> list[str]:
        """Take over the running children of an earlier manager, and return their names.

        What dead ones left is cleaned up.
        """
        records = self._store.read(child_records.TABLE, ChildRecord.from_body)
        living = {each.name: each for each in self._launcher.running()}
        for name, record in records.items():
            if record.process is not None and record.process.alive:
                living[name] = record
            elif name not in living:
                if record.process is not None:
                    record.process.wait_for_rest()  # processes that it forked run on
                self._launcher.clean_up(record)
                self._store.write({(child_records.TABLE, name): None})
        children = [self._add(Child(self._context, living[name], True)) for name in sorted(living)]
        for child in children:
            self._write(child)
        deadline = time.monotonic() + _ADOPTION_TIMEOUT
        for child in children:
            try:
                self._wait_up(child, deadline)
            except HostError as error:
                _log.warning("%s", error)
        return sorted(living)

    def all(self) -> list[Child]:
        """Return every child, by name."""
        with self._changed:
            return [self._children[name] for name in sorted(self._children)]

    def find(self, name: str) -> Child | None:
        return self._children.get(name)

    def want(self, kind: NodeletKind, count: int) -> None:
        """Have so many shared children; they come up in the background."""
        for _ in range(count - len(self._hosts(kind, ""))):
            self._add(Child(self._context, ChildRecord(self._free_name(kind), kind)))

    def widen(self, kind: NodeletKind) -> None:
        """Have one more shared child; it comes up in the background."""
        self.want(kind, len(self._hosts(kind, "")) + 1)

    def ensure(self, kind: NodeletKind, isolated_for: str) -> str:
        """Return the name of a child that is up, starting one if there is none that answers.

        Raises ``HostError`` if it does not come up. A shared one has an empty ``isolated_for``.
        """
        deadline = time.monotonic() + START_TIMEOUT
        hosts = self._hosts(kind, isolated_for)
        fitting = [each for each in hosts if each.wanted and each.state.responsive]
        up = [child for child in fitting if child.up]
        if up:
            return min(child.name for child in up)
        if not fitting:
            if isolated_for:
                for child in (each for each in hosts if not each.wanted):
                    child.gone.wait(deadline - time.monotonic())  # then its name is free again
            name = self._free_name(kind, isolated_for)
            fitting = [self._add(Child(self._context, ChildRecord(name, kind, isolated_for)))]
        return self._wait_up(fitting[0], deadline)

    def check_free(self, node: str) -> None:
        """Raise `NameTaken` if a node bears a name."""
        child = self.find(node)
        if child is not None and not child.wanted:
            child.gone.wait(START_TIMEOUT)
        elif child is not None:
            raise NameTaken(node)
        if self._launcher.is_living(node):
            raise NameTaken(node, "running", "another node")

    def start_node(
        self, kind: NodeletKind, name: str, command: tuple[str, ...], timeout: float
    ) -> None:
        """Start a node, and wait ``timeout`` seconds for its ports; it is not started again.

        Raises ``HostError`` if it did not come up, after ending it.
        """
        record = ChildRecord(name, kind, name)
        child = self._add(Child(self._context, record, command=command, start_timeout=timeout))
        try:
            # One that is late is ended, which says why.
            self._wait_up(child, time.monotonic() + timeout + 2 * PATIENCE)
        except HostError as error:
            self.end(name)
            last = self._launcher.last_line(name)
            printed = f"; the last that it printed: {last}" if last else ""
            raise HostError(f"{error}{printed}") from error

    def await_up(self, name: str, timeout: float) -> None:
        """Wait for a child that is being started; return at once for any other name."""
        child = self.find(name)
        if child is not None and not child.up:
            self._wait_up(child, time.monotonic() + timeout)

    def crashes(self) -> list[Crash]:
        """Return the last crashes, the oldest first."""
        with self._changed:
            return list(self._crashes)

    def await_end(self, name: str, incarnation: str, timeout: float) -> None:
        """Wait until a process has ended, and is known to have."""
        child = self.find(name)
        if child is not None:
            with self._changed:
                self._changed.wait_for(lambda: child.state.incarnation != incarnation, timeout)

    def end(self, name: str) -> None:
        """End a child for good, by force if need be."""
        child = self.find(name)
        if child is not None:
            self._end([child])

    def renew(self, name: str) -> None:
        """End a nodelet manager, and return when the one that follows it is up.

        Raises ``HostError`` if none comes up.
        """
        child = self.find(name)
        if child is None:
            raise HostError(f"nodelet manager '{name}' is not running")
        before = child.state.incarnation
        self._deaths.forgive(name)
        with self._changed:
            child.is_renewed = child.record.process is not None
        child.live_on()
        child.end()
        with self._changed:
            self._changed.wait_for(
                lambda: child.gone.is_set() or child.state.incarnation not in ("", before),
                START_TIMEOUT,
            )
            if child.state.incarnation not in ("", before):
                return
        raise HostError(f"{child.title}: {child.presence.trouble}")

    def end_all(self) -> None:
        """End all children for good, by force if need be."""
        with self._changed:
            self._ending = True
        self._end(self.all())

    def echo(self) -> None:
        """Print new output of the children."""
        for child in self.all():
            child.echo()

    # Inside

    def _hosts(self, kind: NodeletKind, isolated_for: str) -> list[Child]:
        of = (kind, isolated_for)
        return [each for each in self.all() if (each.record.kind, each.record.isolated_for) == of]

    def _add(self, child: Child) -> Child:
        with self._changed:
            present = None if self._ending else self._children.setdefault(child.name, child)
        if present is child:
            child.on_up = self._notify
            child.live(partial(self._run, child))
            return child
        child.close()
        if present is None:
            raise HostError("the manager is being ended")
        return present

    def _free_name(self, kind: NodeletKind, isolated_for: str = "") -> str:
        """Return the first free name: `base`, `base_2`, and so on."""
        if isolated_for:
            base = f"{isolated_for}_nodelet_manager"
        else:
            base = names.join(self._namespace, _BASES[kind])
        further = (f"{base}_{number}" for number in itertools.count(2))
        return next(
            name
            for name in itertools.chain([base], further)
            if name not in self._children and self._launcher.is_free(name)
        )

    def _wait_up(self, child: Child, deadline: float) -> str:
        with self._changed:
            left = deadline - time.monotonic()
            self._changed.wait_for(
                lambda: child.up or child.gone.is_set() or child.presence.trouble == _TAKEN, left
            )
            if child.up:
                return child.name
        raise HostError(f"{child.title}: {child.presence.trouble}")

    def _end(self, children: list[Child]) -> None:
        for child in children:
            child.end_soon()
        self._notify()
        enders = [in_background(f"ending {each.name}", each.end) for each in children]
        for ender in enders:
            ender.join(2 * PATIENCE)
        for child in children:
            child.gone.wait(PATIENCE)

    def _write(self, child: Child) -> None:
        self._store.write({(child_records.TABLE, child.name): child.record.body()})

    # In the loop of a child

    def _run(self, child: Child) -> float | None:
        """Run a child until its process ends; returns the pause before it is started again."""
        served = 0.0
        if child.wanted:
            try:
                served = self._live(child)
            except (OSError, HostError, PeerTimeout, LookupError) as error:
                child.went_down(str(error))
                _log.error("%s: %s", child.title, error)
            except Exception as error:  # the boundary of the thread: the next start may succeed
                child.went_down(str(error))
                _log.exception("%s", child.title)
        if child.wanted:
            self._deaths.served(child.name, served)
            self._deaths.failed(child.name, served)
            return self._deaths.remaining(child.name)
        self._drop(child)
        return None

    def _drop(self, child: Child) -> None:
        try:
            self._launcher.clean_up(child.record)
        finally:
            self._store.write({(child_records.TABLE, child.name): None})
            self._deaths.forgive(child.name)
            child.close()
            with self._changed:
                self._children.pop(child.name, None)
                child.gone.set()
                self._changed.notify_all()
        self._context.on_change()

    def _live(self, child: Child) -> float:
        """Run a process to its end; returns the seconds for which it offered its services."""
        up = math.inf
        try:
            if child.record.process is None:
                self._launch(child)
            found = child.record.process
            assert found is not None
            self._await_services(child, found)
            up = time.monotonic() if child.up else math.inf
            if not child.wanted:
                child.end()
            status = found.wait_for_rest()
            if child.is_renewed:
                _log.info("%s (process %d) is restarted", child.title, found.pid)
            elif child.wanted:
                _log.warning("%s (process %d) has died", child.title, found.pid)
                crash = self._launcher.examine(child.record.kind, child.name, found.pid, status)
                if crash is not None:  # it is known before its child is shown as dead
                    with self._changed:
                        self._crashes.append(replace(crash, incarnation=incarnation_of(found)))
        finally:
            with self._changed:
                child.adopted = child.is_renewed = False
                child.wanted &= not child.record.isolated_for  # that one is not started again
                child.record = replace(child.record, process=None)
            child.went_down()
            self._notify()
        child.echo()
        self._context.on_change()
        return max(0.0, time.monotonic() - up)

    def _launch(self, child: Child) -> None:
        is_taken = self._launcher.is_living(child.name)
        child.went_down(_TAKEN if is_taken else NOT_UP)
        self._notify()
        if is_taken:
            raise HostError(_TAKEN)
        child.stale = self._launcher.registered(child.name)
        self._write(child)  # before it is there: nothing of it is left if we are killed
        found, child.log = self._launcher.launch(child.record, child.command)
        with self._changed:
            child.record = replace(child.record, process=found)
        self._write(child)

    def _await_services(self, child: Child, found: ProcessId) -> None:
        """Wait until its services are offered; end a process that is late and lost."""
        if child.adopted:
            child.log = self._launcher.follow(child.name)
        deadline = time.monotonic() + child.start_timeout
        child.wake()
        while not child.up:
            if not found.alive or not child.wanted:
                child.went_down("it ended at its start")
                return
            if time.monotonic() > deadline and self._is_lost(child):
                child.wanted &= not child.is_node  # or it could come up while it is ended
                child.end()
                what = "offered no ports" if child.is_node else "not come up"
                raise HostError(f"it has {what} within {child.start_timeout:g} s")
            with self._changed:
                self._changed.wait_for(lambda: child.up or not child.wanted, STEP)
        self._notify()
        self._context.on_change()

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _is_lost(self, child: Child) -> bool:
        """Whether a process that is late will never come up.

        An adopted one may be suspended, and go on later. One that the master does not know belongs
        to an earlier master, and is lost.
        """
        try:
            return not child.adopted or not self._launcher.registered(child.name)
        except PeerTimeout:
            return False
