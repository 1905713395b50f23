# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Records of the processes that a DyKnow manager starts, in its store for its next life.

A record is written before its process starts, and before anything is left at the ROS master.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from dyknow.model.graph import NodeletKind
from dyknow.ros.process import os_process
from dyknow.ros.process.os_process import ProcessId

#: Variable in the environment of each of these processes.
TAG = "DYKNOW_CHILD"
#: Their table in the store.
TABLE = "children"


@dataclass(frozen=True)
class ChildRecord:
    """One nodelet manager, or a node.

    Attributes:
        isolated_for: its only nodelet, a node itself; empty for shared ones.
        process: the process; None before its start, and if it ended with a reboot.
    """

    name: str
    kind: NodeletKind
    isolated_for: str = ""
    process: ProcessId | None = None

    def body(self) -> str:
        """Write what ``from_body`` reads."""
        process = asdict(self.process or ProcessId(0, 0))
        rest = {"kind": self.kind.value, "isolated_for": self.isolated_for}
        return json.dumps({**rest, **process, "boot": os_process.boot()})

    @classmethod
    def from_body(cls, name: str, text: str) -> ChildRecord:
        """Read a record, also of an ended process; raises an error that ``Store.read`` expects."""
        body = json.loads(text)
        is_of_this_boot = body["pid"] and body["boot"] == os_process.boot()
        process = ProcessId(body["pid"], body["started"]) if is_of_this_boot else None
        return cls(name, NodeletKind(body["kind"]), body["isolated_for"], process)


def to_tag(record: ChildRecord, owner: str) -> str:
    """Return the text for the environment of a process: its owner's lock, and its record."""
    return json.dumps([owner, record.name, record.kind.value, record.isolated_for])


def running(owner: str) -> list[ChildRecord]:
    """Return the running processes of an owner, found by their environments, by name."""
    found: dict[str, ChildRecord] = {}
    for process, tag, command in os_process.started_with(TAG):
        try:
            of, name, kind, isolated_for = json.loads(tag)
            record = ChildRecord(name, NodeletKind(kind), isolated_for, process)
        except (ValueError, TypeError):
            continue
        # A nodelet may have started other programs, which have its environment too.
        if of == owner and f"__name:={name.rpartition('/')[2]}" in command:
            found.setdefault(name, record)
    return [found[name] for name in sorted(found)]
