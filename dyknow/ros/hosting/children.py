# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Child processes: started, adopted, restarted when they die, and ended.

They are nodelet managers, and nodes, each of which is there for itself alone.

Who owns what: ``Children`` owns a table of names and a thread for each child. That thread alone
starts the process and waits for its end. A child has a session of its own, so it outlives a
manager that is killed; the next one finds it in a file (``child_records``), else by its name.
"""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time
from dataclasses import dataclass, field, replace
from functools import partial
from typing import AbstractSet, Callable, Dict, FrozenSet, List, Optional, Tuple

from dyknow import names
from dyknow.backoff import Backoff
from dyknow.errors import HostError, NameTaken, PeerTimeout
from dyknow.locks import state_condition, turn_lock
from dyknow.manager.host import Crash
from dyknow.model.graph import NodeletKind
from dyknow.periodic import in_background
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.log_tail import LogTail
from dyknow.ros.os_process import ProcessId

#: Seconds that a child may take to offer its services.
START_TIMEOUT = 20.0
#: Seconds that a child has to end when it is asked to.
PATIENCE = 3.0
#: Seconds before a nodelet manager that died twice is started again.
_FIRST_PAUSE = 0.25
_STEP = 0.02
#: Seconds to wait for a child of an earlier manager, which may just have been started.
_ADOPTION_TIMEOUT = 5.0
_BASES = {
    NodeletKind.PYTHON: "dyknow_nodelet_manager",
    NodeletKind.CPP: "dyknow_cpp_nodelet_manager",
}

NO_NAMES: FrozenSet[str] = frozenset()

_log = logging.getLogger("rosout.dyknow")


@dataclass
class Child:
    """One nodelet manager or node; its thread writes, others read.

    Attributes:
        record: what is known of it on disk.
        adopted: whether an earlier manager started its process.
        up: whether it offers its services.
        wanted: whether it is to be started again when it dies.
        gone: set when its name is free again.
        trouble: why it did not come up; empty if it did.
        stale: address of a dead predecessor at the master; empty if there is none.
        log: what it prints.
        rewirable: whether what it hosts has ports that can be connected elsewhere.
        command: program and arguments of a node; empty for a nodelet manager.
        start_timeout: seconds that it may take to offer its services.
    """

    record: ChildRecord
    adopted: bool = False
    up: bool = False
    wanted: bool = True
    gone: threading.Event = field(default_factory=threading.Event)
    trouble: str = ""
    stale: str = ""
    log: Optional[LogTail] = None
    rewirable: bool = True
    command: Tuple[str, ...] = ()
    start_timeout: float = START_TIMEOUT

    @property
    def title(self) -> str:
        """What it is, with its name."""
        what = "node" if self.record.kind.is_node else "nodelet manager"
        return f"{what} {self.record.name}"

    @property
    def incarnation(self) -> str:
        """Differs for each process; empty while none is up."""
        found = self.record.process
        return f"{found.pid}@{found.started}" if found is not None and self.up else ""


class Children:
    """The processes of one DyKnow manager; every method is safe from any thread."""

    def __init__(
        self,
        launcher: Launcher,
        namespace: str,
        path: str,
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        """Begin without children.

        Args:
            launcher: starts them.
            namespace: that of the DyKnow manager, and of its shared children.
            path: file of the records.
            on_change: called when a child is up or has ended.
        """
        self._launcher = launcher
        self._namespace = namespace
        self._path = path
        self._on_change = on_change
        self._changed = state_condition("children")
        self._writing_turn = turn_lock("records of children")
        self._children: Dict[str, Child] = {}
        self._crashes: List[Crash] = []
        self._ending = False
        self._unwritten = False  # the disk did not take the records

    def adopt(self) -> List[str]:
        """Take over the children of an earlier manager that still run, and return their names."""
        try:
            records = child_records.read(self._path)
        except (OSError, ValueError) as error:
            _log.warning("'%s': %s; looking for nodelet managers by name", self._path, error)
            records = []
        known = {record.name for record in records}
        for kind, base in _BASES.items():
            name = names.join(self._namespace, base)
            found = None if name in known else self._launcher.living(name)
            if found is not None and self._launcher.is_ours(name):
                records.append(ChildRecord(name, kind, process=found))
        children = [self._add(Child(record, adopted=True)) for record in records]
        self._write()  # those that were found by name
        deadline = time.monotonic() + _ADOPTION_TIMEOUT
        for child in children:
            try:
                self._wait_up(child, deadline)
            except HostError as error:
                _log.warning("%s", error)
        return [record.name for record in records]

    def all(self) -> List[Child]:
        """Return every child, by name."""
        with self._changed:
            return [self._children[name] for name in sorted(self._children)]

    def want(self, kind: NodeletKind, count: int) -> None:
        """Have so many shared children; they come up in the background."""
        have = [c for c in self.all() if c.record.kind is kind and not c.record.isolated_for]
        for _ in range(count - len(have)):
            self._add(Child(ChildRecord(self._free_name(kind), kind)))

    def ensure(
        self, kind: NodeletKind, isolated_for: str, without: AbstractSet[str] = NO_NAMES
    ) -> str:
        """Return the name of a child that is up, starting one if there is none.

        Args:
            kind: what it must be able to host.
            isolated_for: the nodelet that is to have it alone; empty for a shared one.
            without: children that hang, and are left out.

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
            fitting = [each for each in same if each.wanted and each.record.name not in without]
        up = [child for child in fitting if child.up]
        if up:
            return min(child.record.name for child in up)
        if not fitting:
            if isolated_for:
                for child in (each for each in same if not each.wanted):
                    child.gone.wait(deadline - time.monotonic())  # then its name is free again
            name = self._free_name(kind, isolated_for)
            fitting = [self._add(Child(ChildRecord(name, kind, isolated_for)))]
        return self._wait_up(fitting[0], deadline)

    def check_free(self, node: str) -> None:
        """Check that no node bears a name.

        Raises:
            NameTaken: one does.
        """
        with self._changed:
            child = self._children.get(node)
        if child is not None and not child.wanted:
            child.gone.wait(START_TIMEOUT)
        elif child is not None:
            raise NameTaken(node)
        if self._launcher.living(node) is not None:
            raise NameTaken(node)

    def start_node(
        self, kind: NodeletKind, name: str, command: Tuple[str, ...], timeout: float
    ) -> None:
        """Start a node, and wait until it offers its ports. It is not started again.

        Args:
            kind: what it is.
            name: of the node.
            command: program and arguments.
            timeout: seconds that it may take.

        Raises:
            HostError: it did not come up, and was ended.
        """
        record = ChildRecord(name, kind, name)
        child = self._add(Child(record, command=command, start_timeout=timeout))
        try:
            self._wait_up(child, time.monotonic() + timeout)
        except HostError as error:
            self.end(name)
            last = self._launcher.last_line(name)
            printed = f"; the last that it printed: {last}" if last else ""
            raise HostError(f"{error}{printed}") from error

    def await_up(self, name: str, timeout: float) -> None:
        """Wait for a child that is being started; return at once for any other name."""
        with self._changed:
            child = self._children.get(name)
        if child is not None and not child.up:
            self._wait_up(child, time.monotonic() + timeout)

    def crashes(self) -> List[Crash]:
        """Return the crashes since the last call."""
        with self._changed:
            crashes, self._crashes = self._crashes, []
        return crashes

    def await_end(self, name: str, incarnation: str, timeout: float) -> None:
        """Wait until a process has ended, and is known to have."""
        with self._changed:
            child = self._children.get(name)
            self._changed.wait_for(
                lambda: child is None or child.incarnation != incarnation, timeout
            )

    def end(self, name: str) -> None:
        """End a child for good, by force if need be."""
        with self._changed:
            child = self._children.get(name)
            if child is not None:
                child.wanted, child.up = False, False
                self._changed.notify_all()
        if child is not None:
            self._end([child])

    def end_all(self) -> None:
        """End all children for good, by force if need be."""
        with self._changed:
            self._ending = True
            children = list(self._children.values())
            for child in children:
                child.wanted, child.up = False, False
            self._changed.notify_all()
        self._end(children)

    def echo(self) -> None:
        """Print what the children printed since the last call; retry to write their records."""
        if self._unwritten:
            self._write()
        for child in self.all():
            if child.log is not None:
                child.log.copy(sys.stdout)

    # Starting

    def _add(self, child: Child) -> Child:
        name = child.record.name
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
        number, name = 1, base
        while True:
            with self._changed:
                taken = name in self._children
            if not taken and self._launcher.living(name) is None:
                return name
            number += 1
            name = f"{base}_{number}"

    def _wait_up(self, child: Child, deadline: float) -> str:
        with self._changed:
            while not child.up and not child.gone.is_set():
                if not self._changed.wait(deadline - time.monotonic()):
                    break
            if child.up:
                return child.record.name
        reason = child.trouble or "it does not come up"
        raise HostError(f"{child.title}: {reason}")

    # One thread for each child

    def _keep(self, child: Child) -> None:
        """Run a child, and start it again when it dies."""
        deaths = Backoff(time.monotonic, _FIRST_PAUSE, tolerated=2)
        while child.wanted:
            begin = time.monotonic()
            try:
                self._live(child)
            except (OSError, HostError, PeerTimeout, LookupError) as error:
                child.trouble = str(error)
                _log.error("%s: %s", child.title, error)
            except Exception as error:  # the boundary of the thread: the next start may succeed
                child.trouble = str(error)
                _log.exception("%s", child.title)
            if not child.wanted:
                break
            deaths.served(child.record.name, time.monotonic() - begin)
            deaths.failed(child.record.name)
            pause = deaths.remaining(child.record.name)
            with self._changed:
                self._changed.wait_for(lambda: not child.wanted, pause)
        try:
            self._launcher.clean_up(child.record)  # before its name is free
        finally:
            with self._changed:
                self._children.pop(child.record.name, None)
                child.gone.set()
                self._changed.notify_all()
        self._write()
        self._on_change()

    def _live(self, child: Child) -> None:
        name = child.record.name
        try:
            if child.record.process is None:
                self._launch(child)
            found = child.record.process
            assert found is not None
            self._follow_until_up(child, found)
            if not child.wanted:
                _end(child.record)
            status = found.wait_for_rest()
            if child.wanted:
                _log.warning("%s (process %d) has died", child.title, found.pid)
                self._note(self._launcher.examine(child.record.kind, name, found.pid, status))
        finally:
            with self._changed:
                child.up, child.adopted = False, False
                child.wanted &= (
                    not child.record.isolated_for
                )  # an isolated one is not started again
                child.record = replace(child.record, process=None)
                self._changed.notify_all()
        self.echo()
        self._on_change()

    def _note(self, crash: Optional[Crash]) -> None:
        """Note a crash, before the child is shown as dead."""
        if crash is not None:
            with self._changed:
                self._crashes.append(crash)

    def _launch(self, child: Child) -> None:
        name = child.record.name
        living = self._launcher.living(name)
        if living is not None:
            self._take_over(child, living)
            return
        child.stale = self._launcher.registered(name)
        found, child.log = self._launcher.launch(child.record.kind, name, child.command)
        with self._changed:
            child.record = replace(child.record, process=found)
        self._write()

    def _take_over(self, child: Child, living: ProcessId) -> None:
        """Adopt a process that an earlier manager started but did not record."""
        is_node = child.record.kind.is_node
        if living.pid < 0 or is_node or not self._launcher.is_ours(child.record.name):
            raise HostError("another node has that name")
        with self._changed:
            child.adopted, child.stale = True, ""
            child.record = replace(child.record, process=living)
        self._write()

    def _follow_until_up(self, child: Child, found: ProcessId) -> None:
        """Wait until its services are offered; end a process that is late and lost."""
        name = child.record.name
        if child.adopted:
            child.log = self._launcher.follow(name)
        deadline = time.monotonic() + child.start_timeout
        kind = child.record.kind
        uri = self._launcher.address(kind, name, child.stale)
        while not uri:
            if not found.alive or not child.wanted:
                child.trouble = "it ended at its start"
                return
            if time.monotonic() > deadline and self._is_lost(child):
                _end(child.record)
                what = "offered no ports" if kind.is_node else "not come up"
                raise HostError(f"it has {what} within {child.start_timeout:g} s")
            time.sleep(_STEP)
            uri = self._launcher.address(kind, name, child.stale)
        rewirable = self._launcher.is_rewirable(kind, name)
        with self._changed:
            child.rewirable = rewirable
            child.up = child.wanted
            self._changed.notify_all()
        self._on_change()

    def _is_lost(self, child: Child) -> bool:
        """Whether a process that is late will never come up.

        An adopted one may be suspended, and go on later. One that the master does not know belongs
        to an earlier master, and is lost.
        """
        try:
            return not child.adopted or not self._launcher.registered(child.record.name)
        except PeerTimeout:
            return False

    # Ending

    def _end(self, children: List[Child]) -> None:
        records = [child.record for child in children]
        enders = [in_background(f"ending {each.name}", partial(_end, each)) for each in records]
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


def _end(record: ChildRecord) -> None:
    """End a process; nodes take leave of the master on SIGINT, as roslaunch sends it."""
    signals = (signal.SIGINT, signal.SIGTERM) if record.kind.is_node else (signal.SIGTERM,)
    if record.process is not None:
        record.process.end(PATIENCE, signals)
