# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The processes that a DyKnow manager started, on disk, so that the next one finds them."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import Iterable, List, Optional

from dyknow.model.graph import NodeletKind
from dyknow.ros.os_process import ProcessId


@dataclass(frozen=True)
class ChildRecord:
    """One nodelet manager, or a node.

    Attributes:
        name: global node name.
        kind: what it hosts, or is.
        isolated_for: the nodelet that has it alone; empty for shared ones. A node has itself.
        process: the process; None before its start.
    """

    name: str
    kind: NodeletKind
    isolated_for: str = ""
    process: Optional[ProcessId] = None


def read(path: str) -> List[ChildRecord]:
    """Read the records of processes that still run; none if there is no file.

    Raises:
        ValueError: the file is damaged.
    """
    try:
        with open(path) as file:
            entries = json.load(file)
    except FileNotFoundError:
        return []
    try:
        records = [
            ChildRecord(
                each["name"],
                NodeletKind(each["kind"]),
                each["isolated_for"],
                ProcessId(each["pid"], each["started"]),
            )
            for each in entries
        ]
    except (KeyError, TypeError) as error:
        raise ValueError(f"unexpected content: {error!r}") from error
    return [each for each in records if each.process is not None and each.process.alive]


def write(path: str, records: Iterable[ChildRecord]) -> None:
    """Replace the file atomically."""
    entries = [
        {
            "name": each.name,
            "kind": each.kind.value,
            "isolated_for": each.isolated_for,
            "pid": each.process.pid,
            "started": each.process.started,
        }
        for each in records
        if each.process is not None
    ]
    with open(path + ".new", "w") as file:
        json.dump(entries, file, indent=1)
    os.replace(path + ".new", path)
