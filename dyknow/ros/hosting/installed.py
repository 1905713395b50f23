# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Compares transformations with the packages on this machine.

A missing nodelet type, program or message type is a warning, not an error: a nodelet manager on
another machine may have it, or the package may be built later.
"""

from __future__ import annotations

from typing import Dict, Iterable, Iterator, Sequence, Set

from dyknow.errors import HostError, Problem
from dyknow.model.transformation import NODE, TOPIC, Program, Transformation
from dyknow.ros.hosting.nodelet_types import NodeletTypes
from dyknow.ros.process import programs
from dyknow.similar import did_you_mean


def missing_here(file: str, transformations: Sequence[Transformation]) -> Iterator[Problem]:
    """List the nodelet types, programs and message types that this machine does not have.

    Each of them is reported once, at the first transformation that needs it.

    Args:
        file: named in the problems.
        transformations: compared with the installed packages.
    """
    made = [each for each in transformations if each.type != TOPIC and not each.is_described]
    nodelets = {each.source for each in made if each.type != NODE}
    missing = NodeletTypes().undeclared(nodelets)
    missing.update(_missing_programs({each.source for each in made if each.type == NODE}))
    datatypes = _missing_types({port.datatype for each in transformations for port in each.ports})
    for each in transformations:
        words = [missing.pop(each.source, "")] if each in made else []
        words += [datatypes.pop(port.datatype, "") for port in each.ports]
        for text in filter(None, words):
            yield Problem(file, 0, f"transformation '{each.label}': {text}")


def _missing_programs(sources: Iterable[str]) -> Dict[str, str]:
    found = {}
    for source in sources:
        try:
            programs.kind_of(Program.of(source))
        except HostError as error:
            found[source] = str(error)
    return found


def _missing_types(datatypes: Set[str]) -> Dict[str, str]:
    import roslib.message  # here: what only asks for nodelet types does not wait for it

    found = {}
    for datatype in datatypes - {"", "*"}:
        try:
            known = roslib.message.get_message_class(datatype)
        except (ValueError, ImportError):
            known = None
        if known is None:
            hint = did_you_mean(datatype, _types_beside(datatype))
            found[datatype] = f"no message type '{datatype}' is installed{hint}"
    return found


def _types_beside(datatype: str) -> Sequence[str]:
    """List the message types of the package that a type names, or of those with similar names."""
    import rosmsg
    import rospkg

    rospack = rospkg.RosPack()
    package = datatype.partition("/")[0]
    packages = [name for name, _ in rosmsg.iterate_packages(rospack, rosmsg.MODE_MSG)]
    return [
        each
        for name in packages
        if name == package or package not in packages
        for each in rosmsg.list_msgs(name, rospack)
    ]
