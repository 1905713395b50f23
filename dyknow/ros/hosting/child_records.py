# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Records of the processes that a DyKnow manager starts, on disk for its next life.

A record is written before its process starts, and before anything is left at the ROS master.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from typing import Iterable

from dyknow.model.graph import NodeletKind
from dyknow.ros.process import os_process
from dyknow.ros.process.os_process import ProcessId, only_for_owner

#: Variable in the environment of each of these processes.
TAG = "DYKNOW_CHILD"


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


def read(path: str) -> list[ChildRecord]:
    """Read the records, also of ended processes; raises ``ValueError`` for a damaged file."""
    try:
        with open(path) as file:
            entries = json.load(file)
    except FileNotFoundError:
        return []
    boot = os_process.boot()
    try:
        return [
            ChildRecord(
                each["name"],
                NodeletKind(each["kind"]),
                each["isolated_for"],
                ProcessId(each["pid"], each["started"])
                if each["pid"] and each.get("boot", boot) == boot
                else None,
            )
            for each in entries
        ]
    except (KeyError, TypeError) as error:
        raise ValueError(f"unexpected content: {error!r}") from error


def write(path: str, records: Iterable[ChildRecord]) -> None:
    """Replace the file atomically."""
    boot = os_process.boot()
    entries = [
        {
            "name": each.name,
            "kind": each.kind.value,
            "isolated_for": each.isolated_for,
            **asdict(each.process or ProcessId(0, 0)),
            "boot": boot,
        }
        for each in records
    ]
    with open(path + ".new", "w", opener=only_for_owner) as file:
        json.dump(entries, file, indent=1)
    os.replace(path + ".new", path)


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
