# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Child processes: started, adopted, restarted when they die, and ended.

They are nodelet managers, and nodes, each of which hosts itself alone.

Ownership: ``Children`` owns a table of names and a thread for each child. That thread alone
starts the process and waits for its end. A child has a session of its own, so it outlives a
manager that is killed; the next one finds it in a file (``child_records``), else by its
environment.
"""

from __future__ import annotations

import collections
import itertools
import logging
import time
from functools import partial
from typing import Deque, Dict, List, Optional, Tuple

from dyknow import names
from dyknow.errors import HostError, NameTaken
from dyknow.locks import state_condition, turn_lock
from dyknow.manager.host import Crash
from dyknow.model.graph import NodeletKind
from dyknow.periodic import in_background
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child import PATIENCE, START_TIMEOUT, Child, ChildKeeper
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.launcher import Launcher

#: Crashes that are remembered.
_CRASHES = 100
#: Seconds to wait for a child of an earlier manager, which may just have been started.
_ADOPTION_TIMEOUT = 5.0
_BASES = {
    NodeletKind.PYTHON: "dyknow_nodelet_manager",
    NodeletKind.CPP: "dyknow_cpp_nodelet_manager",
}

_log = logging.getLogger("rosout.dyknow")


class Children:
    """The processes of one DyKnow manager; every method is safe from any thread."""

    def __init__(
        self, context: PeerContext, launcher: Launcher, namespace: str, path: str
    ) -> None:
        """Prepare; there are no children yet.

        Args:
            context: shared by all peers.
            launcher: starts the children.
            namespace: that of the DyKnow manager, and of its shared children.
            path: file of the records.
        """
        self._context = context
        self._launcher = launcher
        self._namespace = namespace
        self._path = path
        self._changed = state_condition("children")
        self._writing_turn = turn_lock("records of children")
        self._keeper = ChildKeeper(launcher, self._changed, self._write, self._note)
        self._children: Dict[str, Child] = {}
        self._crashes: Deque[Crash] = collections.deque(maxlen=_CRASHES)
        self._ending = False
        self._unwritten = False  # the disk did not take the records

    def adopt(self) -> List[str]:
        """Take over the running children of an earlier manager; clean up after the dead ones.

        Returns:
            Names of the running ones.
        """
        try:
            records = child_records.read(self._path)
        except (OSError, ValueError) as error:
            _log.warning("'%s': %s; looking at the processes that run", self._path, error)
            records = []
        living = {each.name: each for each in records if each.process and each.process.alive}
        living = {**{each.name: each for each in self._launcher.running()}, **living}
        for record in records:
            if record.name not in living:
                if record.process is not None:
                    record.process.wait_for_rest()  # processes that it forked run on
                self._launcher.clean_up(record)
        children = [self._add(Child(self._context, living[name], True)) for name in sorted(living)]
        self._write()
        deadline = time.monotonic() + _ADOPTION_TIMEOUT
        for child in children:
            try:
                self._wait_up(child, deadline)
            except HostError as error:
                _log.warning("%s", error)
        return sorted(living)

    def all(self) -> List[Child]:
        """Return every child, by name."""
        with self._changed:
            return [self._children[name] for name in sorted(self._children)]

    def want(self, kind: NodeletKind, count: int) -> None:
        """Have so many shared children; they come up in the background."""
        have = [c for c in self.all() if c.record.kind is kind and not c.record.isolated_for]
        for _ in range(count - len(have)):
            self._add(Child(self._context, ChildRecord(self._free_name(kind), kind)))

    def find(self, name: str) -> Optional[Child]:
        """Return the child of that name, if there is one."""
        return self._children.get(name)

    def ensure(self, kind: NodeletKind, isolated_for: str) -> str:
        """Return the name of a child that is up, starting one if there is none that answers.

        Args:
            kind: kind of nodelets that it must be able to host.
            isolated_for: its only nodelet; empty for a shared one.

        Raises:
            HostError: it does not come up.
        """
        deadline = time.monotonic() + START_TIMEOUT
        with self._changed:
            same = [
                child
                for child in self._children.values()
                if child.record.kind is kind and child.record.isolated_for == isolated_for
            ]
            fitting = [each for each in same if each.wanted and each.responsive]
        up = [child for child in fitting if child.up]
        if up:
            return min(child.name for child in up)
        if not fitting:
            if isolated_for:
                for child in (each for each in same if not each.wanted):
                    child.gone.wait(deadline - time.monotonic())  # then its name is free again
            name = self._free_name(kind, isolated_for)
            fitting = [self._add(Child(self._context, ChildRecord(name, kind, isolated_for)))]
        return self._wait_up(fitting[0], deadline)

    def check_free(self, node: str) -> None:
        """Check that no node bears a name; raises ``NameTaken`` if one does."""
        child = self.find(node)
        if child is not None and not child.wanted:
            child.gone.wait(START_TIMEOUT)
        elif child is not None:
            raise NameTaken(node)
        if self._launcher.living(node) is not None:
            raise NameTaken(node)

    def start_node(
        self, kind: NodeletKind, name: str, command: Tuple[str, ...], timeout: float
    ) -> None:
        """Start a node, and wait ``timeout`` seconds for its ports. It is not started again.

        Raises:
            HostError: it did not come up, and was ended.
        """
        record = ChildRecord(name, kind, name)
        child = self._add(Child(self._context, record, command=command, start_timeout=timeout))
        try:
            self._wait_up(child, time.monotonic() + timeout)
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

    def crashes(self) -> List[Crash]:
        """Return the last crashes, the oldest first."""
        with self._changed:
            return list(self._crashes)

    def await_end(self, name: str, incarnation: str, timeout: float) -> None:
        """Wait until a process has ended, and is known to have."""
        child = self.find(name)
        if child is not None:
            with self._changed:
                self._changed.wait_for(lambda: child.incarnation != incarnation, timeout)

    def end(self, name: str) -> None:
        """End a child for good, by force if need be."""
        child = self.find(name)
        if child is not None:
            self._end([child])

    def end_all(self) -> None:
        """End all children for good, by force if need be."""
        with self._changed:
            self._ending = True
        self._end(self.all())

    def echo(self) -> None:
        """Print new output of the children; retry to write their records."""
        if self._unwritten:
            self._write()
        for child in self.all():
            child.echo()

    # Starting

    def _add(self, child: Child) -> Child:
        name = child.name
        with self._changed:
            if self._ending:
                raise HostError("the manager is being ended")
            present = self._children.get(name)
            if present is not None:
                return present
            self._children[name] = child
        in_background(f"child {name}", partial(self._keep, child))
        return child

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
            self._changed.wait_for(lambda: child.up or child.gone.is_set(), left)
            if child.up:
                return child.name
        reason = child.trouble or "it does not come up"
        raise HostError(f"{child.title}: {reason}")

    # Keeping, on a thread for each child

    def _keep(self, child: Child) -> None:
        try:
            self._keeper.keep(child)
        finally:
            with self._changed:
                self._children.pop(child.name, None)
                child.gone.set()
                self._changed.notify_all()
        child.close()
        self._write()
        self._context.on_change()

    def _note(self, crash: Crash) -> None:
        with self._changed:
            self._crashes.append(crash)

    # Ending

    def _end(self, children: List[Child]) -> None:
        with self._changed:
            for child in children:
                child.wanted, child.up = False, False
            self._changed.notify_all()
        enders = [in_background(f"ending {each.name}", each.end) for each in children]
        for ender in enders:
            ender.join(2 * PATIENCE)
        for child in children:
            child.gone.wait(PATIENCE)

    def _write(self) -> None:
        with self._writing_turn:  # the disk has the records in the order of the memory
            with self._changed:
                records = [self._children[name].record for name in sorted(self._children)]
            try:
                child_records.write(self._path, records)
            except OSError as error:
                if not self._unwritten:
                    _log.error("'%s' cannot be written: %s", self._path, error)
                self._unwritten = True
            else:
                self._unwritten = False
