# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`tags`: the streams that can be asked for."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Dict, List, Optional, Set

from dyknow.cli.command import Command
from dyknow.cli.shell import Shell
from dyknow.cli.tables import columns
from dyknow.errors import Refused
from dyknow.manager.specifications.tags import read_tags
from dyknow.model.transformation import OUT

if TYPE_CHECKING:
    from dyknow.model.graph import Model

#: Tags for which it is asked what their variables can stand for, and bindings shown of each.
_MOST_ASKED = 100
_MOST_SHOWN = 8


@dataclass
class _Supply:
    """The suppliers of a tag: labels of transformations, running nodelets, and ROS types.

    ``bindings`` is what the variables of the tag can stand for now; None if it was not asked for.
    """

    transformations: Set[str] = field(default_factory=set)
    nodelets: Set[str] = field(default_factory=set)
    datatypes: Set[str] = field(default_factory=set)
    bindings: Optional[List[Dict[str, str]]] = None


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
    with_variables = [tag for tag in chosen if "?" in tag]
    for tag in with_variables[:_MOST_ASKED]:
        chosen[tag].bindings = _bindings(shell, tag)
    if len(with_variables) > _MOST_ASKED:
        shell.warn(
            f"{len(with_variables)} tags have variables; only for {_MOST_ASKED} of them it was "
            "asked what these can stand for: list fewer, by a part of their text"
        )
    rows = [("TAG", "FOR", "TYPE", "SUPPLIED BY")]
    for tag, supply in chosen.items():
        running = [f"{name} (runs)" for name in sorted(supply.nodelets)]
        suppliers = [*sorted(supply.transformations), *running]
        types = ", ".join(sorted(supply.datatypes)) or "-"
        rows.append((tag, _written(supply.bindings), types, ", ".join(suppliers)))
    result = [
        {
            "tag": tag,
            "datatypes": sorted(supply.datatypes),
            "transformations": sorted(supply.transformations),
            "nodelets": sorted(supply.nodelets),
            "bindings": supply.bindings,
        }
        for tag, supply in chosen.items()
    ]
    shell.show({"tags": result}, columns(rows))


def _bindings(shell: Shell, tag: str) -> Optional[List[Dict[str, str]]]:
    try:
        found = shell.client.find_bindings(tag)
    except Refused:  # the tag is no term, so nobody can ask for it
        return None
    pairs = [[each.partition("=")[::2] for each in way.split(", ")] for way in found]
    return [dict(each) for each in pairs]


def _written(bindings: Optional[List[Dict[str, str]]]) -> str:
    """Write ``?camera=left|right``; several variables in turn, ``?a=x ?b=y, ?a=x ?b=z``."""
    if bindings is None:
        return "-"
    shown = bindings[:_MOST_SHOWN]
    more = f" and {len(bindings) - len(shown)} more" if len(bindings) > len(shown) else ""
    if not shown:
        return "nothing now"
    if len(shown[0]) == 1:
        (variable,) = shown[0]
        return f"{variable}={'|'.join(each[variable] for each in shown)}{more}"
    return ", ".join(" ".join(f"{x}={name}" for x, name in each.items()) for each in shown) + more


def _supplied(model: Model) -> Dict[str, _Supply]:
    found: Dict[str, _Supply] = {}
    written: Dict[str, str] = {}

    def note(tags: List[str], datatype: str) -> List[_Supply]:
        supplies = []
        for tag in tags:
            key = _numbered(tag)
            supplies.append(found.setdefault(key, _Supply()))
            written[key] = min(tag, written.get(key, tag))
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
    return {written[key]: supply for key, supply in found.items()}


def _numbered(tag: str) -> str:
    """Number the variables of a tag, whose names do not matter."""
    for term in read_tags((tag,)):
        names = {variable: f"?{number}" for number, variable in enumerate(term.variables)}
        return str(term._replace(args=tuple(names.get(each, each) for each in term.args)))
    return tag


COMMANDS = (
    Command(
        "tags",
        "list the tags of streams",
        "List the tags of out-ports: for which names the variables in them can stand now, their "
        "types, the transformations and the running nodelets that supply them.",
        "dyknow tags\ndyknow tags ball\ndyknow tags --json | jq -r '.tags[].tag'",
        _arguments,
        _tags,
    ),
)
