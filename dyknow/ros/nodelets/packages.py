# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds the plugin descriptions that installed packages export."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator

import rospkg
from lxml import etree

from dyknow.nodelet.plugins import PluginFile


def plugin_files() -> Iterator[PluginFile]:
    """List every ``<export><dyknow plugin="…"/>`` of the packages on ROS_PACKAGE_PATH."""
    return exported_files("dyknow")


def exported_files(tag: str) -> Iterator[PluginFile]:
    """List the files that packages name in ``<export><TAG plugin="…"/>``."""
    rospack = rospkg.RosPack()
    for package in rospack.list():
        directory = Path(rospack.get_path(package))
        try:
            manifest = (directory / "package.xml").read_bytes()
        except OSError:
            continue
        if b"<" + tag.encode() not in manifest:  # most packages: no need to parse them
            continue
        parser = etree.XMLParser(resolve_entities=False, no_network=True, recover=True)
        root = etree.fromstring(manifest, parser)
        if root is None:
            continue
        for export in root.iterfind(f"export/{tag}"):
            plugin = export.get("plugin")
            if plugin:
                file = Path(plugin.replace("${prefix}", str(directory)))
                yield PluginFile(package, directory, directory / file)
