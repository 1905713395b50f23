"""Nodelet managers as child processes: started, adopted, restarted when they die, and ended.

Who owns what: ``Children`` owns a table of names and one thread for each child, which alone
starts the process and waits for its end. A child has a session of its own and outlives a manager
that is killed; the next life finds it in a file (``child_records``) or, failing that, by its name.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import threading
import time
from dataclasses import dataclass, field, replace
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

import rosgraph.network
import rospkg
from roslib.packages import find_node

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import Kind
from dyknow.ros import child_records, process
from dyknow.ros.child_records import ChildRecord
from dyknow.ros.master import Master
from dyknow.ros.output import Follower
from dyknow.ros.owner import OwnerLock
from dyknow.ros.process import ProcessId

#: Seconds that a child may take to offer its services.
START_TIMEOUT = 20.0
#: Seconds that a child has to end when it is asked to.
PATIENCE = 3.0
_STEP = 0.02
#: A child that lived for less is started again after a pause, doubling each time.
_SHORT_LIFE = 10.0
_LONGEST_PAUSE = 30.0
_ANSWER_TIMEOUT = 1.0
#: Seconds that a child of an earlier life may take to show itself: it may have just been started.
_ADOPTION_TIMEOUT = 5.0
_BASES = {Kind.PYTHON: "dyknow_nodelet_manager", Kind.CPP: "dyknow_cpp_nodelet_manager"}

_log = logging.getLogger("rosout.dyknow")


@dataclass
class Child:
    """One nodelet manager; its thread writes, others read."""

    record: ChildRecord
    adopted: bool = False
    up: bool = False
    wanted: bool = True
    gone: threading.Event = field(default_factory=threading.Event)
    trouble: str = ""
    uri: str = ""
    follower: Optional[Follower] = None

    @property
    def incarnation(self) -> str:
        """Differs for each process; empty while none is up."""
        found = self.record.process
        return f"{found.pid}@{found.started}" if found is not None and self.up else ""


class Children:
    """The nodelet managers of one DyKnow manager."""

    def __init__(
        self,
        master: Master,
        path: str,
        owner: OwnerLock,
        orphan_timeout: float,
        parameters: Mapping[str, Any],
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        """Start without children.

        Args:
            master: also says whose children they are.
            path: file of the records.
            owner: lock that tells the children that we live.
            orphan_timeout: seconds after which they end without us; 0 for never.
            parameters: further private parameters of each.
            on_change: called when a child is up or has ended.
        """
        self._master = master
        self._path = path
        self._owner = owner
        self._orphan_timeout = orphan_timeout
        self._parameters = {
            "owner": master.caller,
            "owner_lock": owner.path,
            "orphan_timeout": orphan_timeout,
            **parameters,
        }
        self._on_change = on_change
        self._namespace = names.parent(master.caller)
        self._lock = threading.Condition()
        self._children: Dict[str, Child] = {}
        self._ending = False
        self._log_folder = rospkg.get_log_dir()
        os.makedirs(self._log_folder, exist_ok=True)

    def adopt(self) -> List[str]:
        """Take over the children of an earlier life that still run, and return their names."""
        try:
            records = child_records.read(self._path)
        except (OSError, ValueError) as error:
            _log.warning("'%s': %s; looking for nodelet managers by name", self._path, error)
            records = []
        known = {record.name for record in records}
        for kind in Kind:
            name = names.join(self._namespace, _BASES[kind])
            found = None if name in known else self._living(name)
            if found is not None and self._is_ours(name):
                records.append(ChildRecord(name, kind, process=found))
        children = [self._add(Child(record, adopted=True)) for record in records]
        deadline = time.monotonic() + _ADOPTION_TIMEOUT
        for child in children:
            try:
                self._wait_up(child, deadline)
            except HostError as error:
                _log.warning("%s", error)
        return [record.name for record in records]

    def all(self) -> List[Child]:
        """Return every child, by name."""
        with self._lock:
            return [self._children[name] for name in sorted(self._children)]

    def want(self, kind: Kind, count: int) -> None:
        """See to it that there are so many shared children; they come up in the background."""
        have = [c for c in self.all() if c.record.kind is kind and not c.record.isolated_for]
        for _ in range(count - len(have)):
            self._add(Child(ChildRecord(self._free_name(kind), kind)))

    def ensure(self, kind: Kind, isolated_for: str) -> str:
        """Return the name of a child that is up, starting one if there is none.

        Raises:
            HostError: it does not come up.
        """
        deadline = time.monotonic() + START_TIMEOUT
        with self._lock:
            fitting = [
                child
                for child in self._children.values()
                if child.record.kind is kind
                and child.record.isolated_for == isolated_for
                and child.wanted
            ]
        up = [child for child in fitting if child.up]
        if up:
            return min(child.record.name for child in up)
        if not fitting:
            name = self._isolated_name(isolated_for) if isolated_for else self._free_name(kind)
            fitting = [self._add(Child(ChildRecord(name, kind, isolated_for)))]
        return self._wait_up(fitting[0], deadline)

    def await_up(self, name: str, timeout: float) -> None:
        """Wait for a child that is being started; for others there is nothing to wait for."""
        with self._lock:
            child = self._children.get(name)
        if child is not None and not child.up:
            self._wait_up(child, time.monotonic() + timeout)

    def end(self, name: str) -> None:
        """End a child for good, by force if need be."""
        with self._lock:
            child = self._children.get(name)
            if child is not None:
                child.wanted, child.up = False, False
                self._lock.notify_all()
        if child is not None:
            self._end([child])

    def end_all(self) -> None:
        """End all children for good, by force if need be."""
        with self._lock:
            self._ending = True
            children = list(self._children.values())
            for child in children:
                child.wanted, child.up = False, False
            self._lock.notify_all()
        self._end(children)

    def echo(self) -> None:
        """Show what the children printed since the last call."""
        for child in self.all():
            if child.follower is not None:
                child.follower.copy(sys.stdout)

    # Starting

    def _add(self, child: Child) -> Child:
        name = child.record.name
        with self._lock:
            if self._ending:
                raise HostError("the manager is being ended")
            present = self._children.get(name)
            if present is not None:
                return present
            self._children[name] = child
        threading.Thread(target=self._keep, args=(child,), name=f"child {name}", daemon=True).start()
        return child

    def _free_name(self, kind: Kind) -> str:
        """First name, counted from 2, that no child and no living node of others has."""
        base = names.join(self._namespace, _BASES[kind])
        number, name = 1, base
        while True:
            with self._lock:
                taken = name in self._children
            if not taken and self._living(name) is None:
                return name
            number += 1
            name = f"{base}_{number}"

    def _isolated_name(self, nodelet: str) -> str:
        return f"{nodelet}_nodelet_manager"

    def _wait_up(self, child: Child, deadline: float) -> str:
        with self._lock:
            while not child.up and child.wanted and not child.gone.is_set():
                if not self._lock.wait(deadline - time.monotonic()):
                    break
            if child.up:
                return child.record.name
        reason = child.trouble or "it does not come up"
        raise HostError(f"nodelet manager '{child.record.name}': {reason}")

    # One thread for each child

    def _keep(self, child: Child) -> None:
        """Run one child, life after life; an isolated one has only one."""
        pause = 0.0
        while child.wanted:
            begin = time.monotonic()
            try:
                self._live(child)
            except (OSError, HostError, PeerTimeout) as error:
                child.trouble = str(error)
                _log.error("nodelet manager %s: %s", child.record.name, error)
            if not child.wanted or child.record.isolated_for:
                break
            long_life = time.monotonic() - begin > _SHORT_LIFE
            pause = 0.0 if long_life else min(_LONGEST_PAUSE, max(0.25, 2 * pause))
            with self._lock:
                self._lock.wait_for(lambda: not child.wanted, pause)
        with self._lock:
            self._children.pop(child.record.name, None)
            child.gone.set()
            self._lock.notify_all()
        self._write()
        self._on_change()

    def _live(self, child: Child) -> None:
        name = child.record.name
        if child.record.process is None:
            self._launch(child)
        found = child.record.process
        assert found is not None
        try:
            self._follow_until_up(child, found)
            if not child.wanted:
                found.end(PATIENCE)
            found.wait()
        finally:
            with self._lock:
                child.up, child.adopted = False, False
                child.record = replace(child.record, process=None)
        if child.wanted:
            _log.warning("nodelet manager %s (process %d) has died", name, found.pid)
        self.echo()
        self._purge(name, child.uri)
        self._on_change()

    def _launch(self, child: Child) -> None:
        name, kind = child.record.name, child.record.kind
        living = self._living(name)
        if living is not None:
            self._take_over(child, living)
            return
        self._purge(name, self._master.node(name))
        for key, value in self._parameters.items():
            self._master.ask("setParam", names.join(name, key), value)
        output = self._output(name)
        found = process.start(_command(kind, name), output, rospkg.get_ros_home())
        child.follower = Follower(output)
        with self._lock:
            child.record = replace(child.record, process=found)
        self._write()
        if kind is Kind.CPP and self._orphan_timeout > 0:
            _watch(found, self._owner.path, self._orphan_timeout, output + ".owner")

    def _take_over(self, child: Child, living: ProcessId) -> None:
        """Adopt a process that an earlier life started, but could not write down any more."""
        if living.pid < 0 or not self._is_ours(child.record.name):
            raise HostError("another node has that name")
        with self._lock:
            child.adopted = True
            child.record = replace(child.record, process=living)
        self._write()

    def _follow_until_up(self, child: Child, found: ProcessId) -> None:
        """Wait until the services are there; a late one that we started is given up."""
        name = child.record.name
        if child.adopted:
            child.follower = Follower(self._output(name), at_end=True)
        deadline = time.monotonic() + START_TIMEOUT
        while not self._is_offered(f"{name}/list"):
            if not found.alive or not child.wanted:
                child.trouble = "it ended at its start"
                return
            if time.monotonic() > deadline and not child.adopted:
                found.end(PATIENCE)
                raise HostError(f"it has not come up within {START_TIMEOUT:g} s")
            time.sleep(_STEP)
        child.uri = self._master.node(name)
        with self._lock:
            child.up = True
            self._lock.notify_all()
        self._on_change()

    # Ending

    def _end(self, children: List[Child]) -> None:
        enders = []
        for child in children:
            found = child.record.process
            if found is not None:
                ender = threading.Thread(target=found.end, args=(PATIENCE,), daemon=True)
                ender.start()
                enders.append(ender)
        for ender in enders:
            ender.join(2 * PATIENCE)
        for child in children:
            child.gone.wait(PATIENCE)
            for key in self._parameters:
                try:
                    self._master.ask("deleteParam", names.join(child.record.name, key))
                except (LookupError, PeerTimeout):
                    continue

    def _purge(self, name: str, uri: str) -> None:
        if not uri:
            return
        try:
            self._master.purge(name, uri)
        except (LookupError, PeerTimeout) as error:
            _log.warning("what nodelet manager %s left at the master: %s", name, error)

    # Looking

    def _living(self, name: str) -> Optional[ProcessId]:
        """The process of a node that answers; an id of -1 if it runs on another machine."""
        uri = self._master.node(name)
        if not uri:
            return None
        try:
            pid = self._master.pid(name, uri, _ANSWER_TIMEOUT)
        except (PeerTimeout, LookupError):
            return None
        host, _ = rosgraph.network.parse_http_host_and_port(uri)
        here = rosgraph.network.is_local_address(host)
        return ProcessId.of(pid) if here else ProcessId(-1, -1)

    def _is_ours(self, name: str) -> bool:
        try:
            return bool(self._master.ask("getParam", f"{name}/owner") == self._master.caller)
        except LookupError:
            return False

    def _is_offered(self, service: str) -> bool:
        try:
            return bool(self._master.ask("lookupService", service))
        except (LookupError, PeerTimeout):
            return False

    def _output(self, name: str) -> str:
        return os.path.join(self._log_folder, re.sub(r"\W+", "-", name).strip("-") + "-output.log")

    def _write(self) -> None:
        with self._lock:
            records = [self._children[name].record for name in sorted(self._children)]
            try:
                child_records.write(self._path, records)
            except OSError as error:
                _log.error("'%s' cannot be written: %s", self._path, error)


def _command(kind: Kind, name: str) -> Tuple[str, ...]:
    node = (f"__name:={name.rpartition('/')[2]}", f"__ns:={names.parent(name)}")
    if kind is Kind.PYTHON:
        return (sys.executable, "-m", "dyknow.cli.nodelet", "manager", *node)
    found = find_node("nodelet", "nodelet")
    if not found:
        raise HostError("C++ nodelets need the package 'nodelet', which is not installed")
    return (found[0], "manager", *node)


def _watch(found: ProcessId, lock: str, timeout: float, output: str) -> None:
    command = (sys.executable, "-m", "dyknow.ros.owner", lock, str(timeout), str(found.pid))
    process.start(command, output, rospkg.get_ros_home())
