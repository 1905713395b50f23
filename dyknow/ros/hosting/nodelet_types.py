# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet types that packages declare, in Python and in C++.

Python classes are exported as ``<dyknow plugin=…>``, C++ ones as ``<nodelet plugin=…>``.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Dict, Iterable, Iterator, Mapping, Set

from lxml import etree

from dyknow.errors import HostError
from dyknow.model.graph import NodeletKind
from dyknow.nodelet.plugins import Plugins
from dyknow.ros.nodelets.packages import exported_files, plugin_files
from dyknow.similar import did_you_mean

_BASE_CLASS = "nodelet::Nodelet"

_log = logging.getLogger("rosout.dyknow")


def cpp_classes() -> Iterator[str]:
    """List the C++ nodelets that packages declare; broken descriptions are logged and left out."""
    for plugin_file in exported_files("nodelet"):
        try:
            yield from _read(plugin_file.file)
        except (OSError, etree.XMLSyntaxError) as error:
            _log.warning("plugin description '%s': %s", plugin_file.file, error)


class NodeletTypes:
    """The declared types; packages are read for the first request of an unknown type."""

    def __init__(self) -> None:
        """Read the packages at the first request."""
        self._plugins = Plugins(plugin_files)
        self._kinds: Mapping[str, NodeletKind] = {}

    def kind_of(self, source: str) -> NodeletKind:
        """Return the kind of a type; one that is declared in both languages is Python.

        Raises:
            HostError: no package declares it.
        """
        declared = self._declared({source})
        if source not in declared:
            raise HostError(_explanation(source, declared))
        return declared[source]

    def undeclared(self, sources: Iterable[str]) -> Dict[str, str]:
        """Return the sources that no package declares, each with an explanation."""
        wanted = set(sources)
        declared = self._declared(wanted)
        return {each: _explanation(each, declared) for each in sorted(wanted - declared.keys())}

    def _declared(self, wanted: Set[str]) -> Mapping[str, NodeletKind]:
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
        "<nodelet plugin> export of a package on ROS_PACKAGE_PATH" + did_you_mean(source, declared)
    )


def _read(file: Path) -> Iterator[str]:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, recover=True)
    root = etree.fromstring(file.read_bytes(), parser)
    if root is None:
        return
    for element in root.iter("class"):
        name = element.get("name") or element.get("type")
        if name and element.get("base_class_type") == _BASE_CLASS:
            yield name
