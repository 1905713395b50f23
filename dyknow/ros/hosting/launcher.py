# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Starts a nodelet manager or a node as a process, finds one that runs, cleans up after it."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import re
import signal
import sys
from pathlib import Path
from typing import Any, Mapping, Sequence

import rosgraph
import rospkg
from roslib.packages import find_node

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import Crash
from dyknow.model.graph import NodeletKind
from dyknow.nodelet import crash_record
from dyknow.periodic import in_background
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.external import may_be_there
from dyknow.ros.nodelets.owner import OwnerLock
from dyknow.ros.nodelets.process_guards import SPAWNED
from dyknow.ros.process import os_process
from dyknow.ros.process.os_process import LogTail, ProcessId
from dyknow.ros.wire.master import Master

_ANSWER_TIMEOUT = 1.0
#: Signals that mean a fault of the process itself.
_FAULTS = (signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT)
#: Private parameter of a nodelet manager: the file in which it notes whose code is running.
_CRASH_RECORD = "crash_record"

#: Makes a node re-wirable; a program and its arguments follow.
_REWIRABLE = ("env", f"{SPAWNED}=1", sys.executable, "-m", "dyknow.cli.rewirable")
#: Lines are in an output when they are printed: those of Python, and the log of roscpp.
_BY_LINES = {"PYTHONUNBUFFERED": "1", "ROSCONSOLE_STDOUT_LINE_BUFFERED": "1"}
#: Bytes at the end of an output in which its last line is looked for.
_LAST_WORDS = 2000
#: Outputs of ended processes that are kept, at most so many, of so many bytes in all, for all the
#: managers of one master.
_OUTPUTS = 10
_OUTPUT_SIZE = 50_000_000

_log = logging.getLogger("rosout.dyknow")


class Launcher:
    """Starts the nodelet managers and nodes of one DyKnow manager, its children."""

    def __init__(
        self,
        master: Master,
        owner: OwnerLock,
        orphan_timeout: float,
        guards: Mapping[str, str],
        shared_memory: bool = True,
    ) -> None:
        """Make the folders for logs and files; raises ``HostError`` if they cannot be written.

        The caller of the ``master`` owns the children. They end ``orphan_timeout`` seconds after
        the owner, 0 for never; ``guards`` is their environment, with their guards from the start.
        """
        self._master = master
        self._owner = owner
        self._orphan_timeout = orphan_timeout
        #: Private parameters on the command line of Python ones, which need them even while there
        #: is no master.
        self._care = {"owner_lock": owner.path, "orphan_timeout": orphan_timeout}
        self._shared_memory = shared_memory
        self._guards = guards
        host, port = rosgraph.network.parse_http_host_and_port(master.uri)
        self._log_folder = os.path.join(rospkg.get_log_dir(), f"dyknow-{host}-{port}")
        for folder, variable in (
            (self._log_folder, "ROS_LOG_DIR"),
            (rospkg.get_ros_home() or ".", "ROS_HOME"),
        ):
            _check_writable(folder, variable)

    def launch(self, child: ChildRecord, command: Sequence[str] = ()) -> tuple[ProcessId, LogTail]:
        """Start a nodelet manager, or a node with a ``command``.

        Its registration replaces that of a dead predecessor at the master. Raises ``OSError``,
        ``HostError`` or ``RuntimeError`` if it, or its watchdog, cannot be started.
        """
        kind, name = child.kind, child.name
        for key, value in self._parameters_of(kind, name).items():
            self._master.ask("setParam", names.join(name, key), value)
        output = self._output(name)
        os.makedirs(self._log_folder, exist_ok=True)  # rosclean may have removed it
        program = (*_REWIRABLE, *command) if kind.is_node else self._command(kind)
        node = (f"__name:={name.rpartition('/')[2]}", f"__ns:={names.parent(name)}")
        tag = {child_records.TAG: child_records.to_tag(child, self._owner.path)}
        environment = {**_BY_LINES, **tag, **self._guards}
        found = os_process.start((*program, *node), output, rospkg.get_ros_home(), environment)
        if kind is not NodeletKind.PYTHON and self._orphan_timeout > 0:
            try:
                self._watch(found, output + ".owner")
            except BaseException:
                found.end(0.0)
                raise
        return found, LogTail(output)

    def follow(self, name: str) -> LogTail:
        """Return the tail of the output of one that runs already."""
        return LogTail(self._output(name), at_end=True)

    def last_line(self, name: str) -> str:
        """Return the last line that one printed; empty if it printed nothing."""
        try:
            with open(self._output(name), "rb") as file:
                file.seek(max(0, os.path.getsize(file.name) - _LAST_WORDS))
                lines = file.read().decode("utf-8", "replace").split("\n")
        except OSError:
            return ""
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def examine(self, kind: NodeletKind, name: str, pid: int, status: int | None) -> Crash | None:
        """Return the crash of a process; None if it ended without a fault of its own.

        ``status`` is its exit code, or the negative number of a signal; None if unknown.
        """
        if status is None or (status < 0 and -status not in _FAULTS):
            return None
        cause = signal.Signals(-status).name if status < 0 else f"exit code {status}"
        if kind is not NodeletKind.PYTHON:
            return Crash(name, cause) if status else None
        try:
            found = crash_record.read(self._crash_record(name), pid)
        except (OSError, ValueError) as error:
            _log.debug("what was running in %s is not known: %s", name, error)
            found = crash_record.AtWork()
        # With an exit code, and no nodelet at work, it ended in order or at its start.
        if status >= 0 and not found.running:
            return None
        return Crash(name, cause, found.running, found.unloading)

    def clean_up(self, child: ChildRecord) -> None:
        """Remove the registrations, parameters and crash record of a child that ended.

        If another process bears its name by now, nothing is removed. Its output stays until newer
        ones of ended processes are too many or too large.
        """
        kind, name = child.kind, child.name
        self._limit_outputs()
        try:
            uri = self._master.node(name)
            if self.is_living(name):
                return
            with contextlib.suppress(OSError):
                os.remove(self._crash_record(name))
            if uri:
                self._master.purge(name, uri)
            care = () if kind.is_node else self._care
            self._master.delete_parameters(name, (*self._parameters_of(kind, name), *care))
        except (LookupError, PeerTimeout) as error:
            _log.warning("what %s left at the master: %s", name, error)

    def is_living(self, name: str) -> bool:
        """Whether a node of that name answers; raises `PeerTimeout` if the master does not."""
        uri = self._master.node(name)
        return bool(uri) and self._master.pid_at(name, uri, _ANSWER_TIMEOUT) > 0

    def is_free(self, name: str) -> bool:
        """Whether no node bears a name, nor may do so on a host that does not answer."""
        uri = self._master.node(name)
        if not uri:
            return True
        try:
            self._master.pid(name, uri, _ANSWER_TIMEOUT)
        except (PeerTimeout, LookupError) as error:
            return not may_be_there(error)
        return False

    def running(self) -> list[ChildRecord]:
        """Return the running processes that our owner started, in this life or an earlier one."""
        return child_records.running(self._owner.path)

    def registered(self, name: str) -> str:
        """Return the address that the master has of a node, dead or alive; else empty."""
        return self._master.node(name)

    def _watch(self, found: ProcessId, output: str) -> None:
        """Start a watchdog that ends a process without such a thread when it is orphaned."""
        program = (sys.executable, "-m", "dyknow.ros.nodelets.owner")
        arguments = (self._owner.path, str(self._orphan_timeout), str(found.pid))
        watcher = os_process.start((*program, *arguments), output, rospkg.get_ros_home())
        in_background(f"watcher of {found.pid}", watcher.wait)

    def _parameters_of(self, kind: NodeletKind, name: str) -> Mapping[str, Any]:
        found: dict[str, Any] = {}
        if kind is NodeletKind.PYTHON or not self._shared_memory:  # a node's namespace is its own
            found["shared_memory"] = self._shared_memory
        if not kind.is_node:
            found.update({"owner": self._master.caller, _CRASH_RECORD: self._crash_record(name)})
        return found

    def _command(self, kind: NodeletKind) -> tuple[str, ...]:
        """Return the command of a nodelet manager, without its name."""
        if kind is NodeletKind.PYTHON:
            program = (sys.executable, "-m", "dyknow.cli.nodelet", "manager")
            care = (f"_{key}:={json.dumps(value)}" for key, value in self._care.items())
            return (*program, *care)
        found = find_node("dyknow", "cpp_nodelet_manager")
        if found:
            return (found[0],)
        found = find_node("nodelet", "nodelet")
        if not found:
            raise HostError("C++ nodelets need the package 'nodelet', which is not installed")
        return (found[0], "manager")

    def _limit_outputs(self) -> None:
        """Remove the oldest outputs of processes that have ended, of earlier lives too."""
        count = size = 0
        outputs = []
        for file in Path(self._log_folder).glob("*-output.log"):
            with contextlib.suppress(OSError):  # another thread has just removed it
                outputs.append((file.stat(), file))
        for found, file in sorted(outputs, key=lambda each: each[0].st_mtime_ns, reverse=True):
            if os_process.is_locked(file):
                continue
            count, size = count + 1, size + found.st_size
            if count > _OUTPUTS or size > _OUTPUT_SIZE:
                for each in (str(file), f"{file}.owner"):
                    with contextlib.suppress(OSError):
                        os.remove(each)

    def _crash_record(self, name: str) -> str:
        return self._file(name, "running")

    def _output(self, name: str) -> str:
        return self._file(name, "output.log")

    def _file(self, name: str, what: str) -> str:
        return os.path.join(self._log_folder, re.sub(r"\W+", "-", name).strip("-") + "-" + what)


def _check_writable(folder: str, variable: str) -> None:
    """Make a folder, or raise ``HostError`` if it cannot be written."""
    try:
        os.makedirs(folder, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise HostError(
            f"folder '{folder}' cannot be written ({error.strerror}); set the environment "
            f"variable {variable} to one that can be"
        ) from error
