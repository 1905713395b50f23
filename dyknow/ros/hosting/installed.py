# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet types, programs and message types that the packages on this machine have.

Python classes are exported as ``<dyknow plugin=…>``, C++ ones as ``<nodelet plugin=…>``. A missing
one is a warning, not an error: a nodelet manager on another machine may have it, or the package
may be built later.
"""

from __future__ import annotations

import logging
from typing import Iterable, Iterator, Mapping, Sequence

from lxml import etree

from dyknow.errors import HostError, Problem
from dyknow.model.graph import NodeletKind
from dyknow.model.transformation import NODE, TOPIC, Program, Transformation
from dyknow.nodelet.loading.plugins import Plugins, plugin_files
from dyknow.ros.process import programs
from dyknow.ros.wire.message_classes import message_class
from dyknow.similar import did_you_mean

_BASE_CLASS = "nodelet::Nodelet"

_log = logging.getLogger("rosout.dyknow")


class NodeletTypes:
    """The declared types; packages are read for the first request of an unknown type."""

    def __init__(self) -> None:
        self._plugins = Plugins(plugin_files)
        self._kinds: Mapping[str, NodeletKind] = {}

    def kind_of(self, source: str) -> NodeletKind:
        """Return the kind of a type; raises ``HostError`` if no package declares it.

        One that is declared in both languages is Python.
        """
        declared = self._declared({source})
        if source not in declared:
            raise HostError(_explanation(source, declared))
        return declared[source]

    def undeclared(self, sources: Iterable[str]) -> dict[str, str]:
        """Return the sources that no package declares, each with an explanation."""
        wanted = set(sources)
        declared = self._declared(wanted)
        return {each: _explanation(each, declared) for each in sorted(wanted - declared.keys())}

    def _declared(self, wanted: set[str]) -> Mapping[str, NodeletKind]:
        if not self._kinds.keys() >= wanted:
            python = [each.name for each in self._plugins.declared()]
            self._kinds = {
                **dict.fromkeys(cpp_classes(), NodeletKind.CPP),
                **dict.fromkeys(python, NodeletKind.PYTHON),
            }
        return self._kinds


def _explanation(source: str, declared: Iterable[str]) -> str:
    return (
        f"no package declares a nodelet type '{source}': expected it in a <dyknow plugin> or a "
        "<nodelet plugin> export of a package on the ROS_PACKAGE_PATH of the DyKnow manager, for "
        "nodelets on other hosts too" + did_you_mean(source, declared)
    )


def cpp_classes() -> Iterator[str]:
    """List the C++ nodelets that packages declare."""
    for root in cpp_descriptions():
        for element in root.iter("class"):
            name = element.get("name") or element.get("type")
            if name and element.get("base_class_type") == _BASE_CLASS:
                yield name


def cpp_descriptions() -> Iterator[etree._Element]:
    """Read the descriptions of C++ nodelets; broken ones are logged and left out."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, recover=True)
    for plugin_file in plugin_files("nodelet"):
        try:
            root = etree.fromstring(plugin_file.file.read_bytes(), parser)
        except (OSError, etree.XMLSyntaxError) as error:
            _log.warning("plugin description '%s': %s", plugin_file.file, error)
            continue
        if root is not None:
            yield root


def missing_here(file: str, transformations: Sequence[Transformation]) -> Iterator[Problem]:
    """List the nodelet types, programs and message types that this machine does not have.

    Each is reported once, at the first transformation that needs it; problems name ``file``.
    """
    made = [each for each in transformations if each.type != TOPIC and not each.is_described]
    missing = NodeletTypes().undeclared(each.source for each in made if each.type != NODE)
    for source in {each.source for each in made if each.type == NODE}:
        try:
            programs.kind_of(Program.of(source))
        except HostError as error:
            missing[source] = str(error)
    datatypes = _missing_types({port.datatype for each in transformations for port in each.ports})
    for each in transformations:
        words = [missing.pop(each.source, "")] if each in made else []
        words += [datatypes.pop(port.datatype, "") for port in each.ports]
        for text in filter(None, words):
            yield Problem(file, 0, f"transformation '{each.label}': {text}")


def _missing_types(datatypes: set[str]) -> dict[str, str]:
    found = {}
    for datatype in datatypes - {"", "*"}:
        if message_class(datatype) is None:
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
    chosen = [package] if package in packages else packages
    return [each for name in chosen for each in rosmsg.list_msgs(name, rospack)]
