# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`tags`: the streams that can be asked for."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Dict, List, Set

from dyknow.cli.command import Command
from dyknow.cli.shell import Shell
from dyknow.cli.tables import columns
from dyknow.model.transformation import OUT

if TYPE_CHECKING:
    from dyknow.model.graph import Model


@dataclass
class _Supply:
    """The suppliers of a tag: labels of transformations, running nodelets, and ROS types."""

    transformations: Set[str] = field(default_factory=set)
    nodelets: Set[str] = field(default_factory=set)
    datatypes: Set[str] = field(default_factory=set)


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "text", nargs="?", default="", help="list only tags that contain this, in any case"
    )


def _tags(arguments: argparse.Namespace, shell: Shell) -> None:
    supplied = _supplied(shell.client.get_model())
    chosen = {
        tag: supply
        for tag, supply in sorted(supplied.items())
        if arguments.text.lower() in tag.lower()
    }
    rows = [("TAG", "TYPE", "SUPPLIED BY")]
    for tag, supply in chosen.items():
        running = [f"{name} (runs)" for name in sorted(supply.nodelets)]
        suppliers = [*sorted(supply.transformations), *running]
        rows.append((tag, ", ".join(sorted(supply.datatypes)) or "-", ", ".join(suppliers)))
    result = [
        {
            "tag": tag,
            "datatypes": sorted(supply.datatypes),
            "transformations": sorted(supply.transformations),
            "nodelets": sorted(supply.nodelets),
        }
        for tag, supply in chosen.items()
    ]
    shell.show({"tags": result}, columns(rows))


def _supplied(model: Model) -> Dict[str, _Supply]:
    found: Dict[str, _Supply] = {}

    def note(tags: List[str], datatype: str) -> List[_Supply]:
        supplies = [found.setdefault(tag, _Supply()) for tag in tags]
        for supply in supplies if datatype else ():
            supply.datatypes.add(datatype)
        return supplies

    for transformation in model.transformations:
        for port in transformation.ports:
            if port.direction == OUT:
                for supply in note(list(port.tags), port.datatype):
                    supply.transformations.add(transformation.label)
    for nodelet in model.nodelets:
        for shown in nodelet.ports:
            if shown.direction == OUT:
                for supply in note(list(shown.tags), shown.datatype):
                    supply.nodelets.add(nodelet.name)
    return found


COMMANDS = (
    Command(
        "tags",
        "list the tags of streams",
        "List the tags of out-ports: their types, the transformations and the running nodelets "
        "that supply them.",
        "dyknow tags\ndyknow tags ball\ndyknow tags --json | jq -r '.tags[].tag'",
        _arguments,
        _tags,
    ),
)
