# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Look-up of nodelet classes by the names that packages declare.

A package exports ``<dyknow plugin="${prefix}/FILE.xml"/>``; the file lists ``<library>`` elements
with ``<class name= type= base_class_type="dyknow.Nodelet">`` in them, as nodelet and rqt plugins
do. Only what is declared can be loaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, Iterable, List, Tuple

from lxml import etree

from dyknow.errors import BrokenPlugin, UnknownNodeletType
from dyknow.locks import state_lock

BASE_CLASS = "dyknow.Nodelet"


@dataclass(frozen=True)
class PluginFile:
    """A description that a package exports.

    Attributes:
        package: name of the package.
        directory: where the package is; ``path`` of a library is relative to it.
        file: the XML file.
    """

    package: str
    directory: Path
    file: Path


@dataclass(frozen=True)
class PluginClass:
    """One declared class.

    Attributes:
        name: what ``source`` and load requests say, ``package/Class``.
        type: dotted path of the Python class.
        description: one line for people, may be empty.
        library: directory that the module is searched in first, used if it exists.
        file: where it is declared.
    """

    name: str
    type: str
    description: str
    library: Path
    file: Path


def read(plugin_file: PluginFile) -> List[PluginClass]:
    """Read one description.

    Raises:
        BrokenPlugin: the file cannot be read, is not XML, or lacks something.
    """
    what = f"plugin description '{plugin_file.file}' of package '{plugin_file.package}'"
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        root = etree.fromstring(plugin_file.file.read_bytes(), parser)
    except OSError as error:
        raise BrokenPlugin(what, f"cannot be read: {error.strerror}") from error
    except etree.XMLSyntaxError as error:
        raise BrokenPlugin(what, f"is not well-formed XML: {error.msg}") from error
    if root.tag not in ("library", "class_libraries"):
        raise BrokenPlugin(what, f"expected <library> at the root, found <{root.tag}>")
    classes = []
    for library in root.iter("library"):
        directory = plugin_file.directory / (library.get("path") or ".")
        for element in library.iter("class"):
            name, type_name = element.get("name"), element.get("type")
            where = f"{what}, line {element.sourceline}"
            if not name or not type_name:
                raise BrokenPlugin(where, "expected <class name=… type=…>")
            base = element.get("base_class_type")
            if base != BASE_CLASS:
                raise BrokenPlugin(
                    where, f"expected base_class_type='{BASE_CLASS}' for '{name}', found {base!r}"
                )
            description = " ".join((element.findtext("description") or "").split())
            classes.append(PluginClass(name, type_name, description, directory, plugin_file.file))
    return classes


class Plugins:
    """The declared nodelet classes of all packages, read when first needed.

    Args:
        find: lists the plugin descriptions that packages export now.
    """

    def __init__(self, find: Callable[[], Iterable[PluginFile]]) -> None:
        self._find = find
        self._lock = state_lock("plug-ins")
        self._classes: Dict[str, PluginClass] = {}
        self._broken: Tuple[str, ...] = ()

    def refresh(self) -> None:
        """Read the descriptions again; a broken one is remembered and hides no other."""
        classes: Dict[str, PluginClass] = {}
        broken: List[str] = []
        for plugin_file in sorted(self._find(), key=lambda each: (each.package, str(each.file))):
            try:
                for declared in read(plugin_file):
                    classes.setdefault(declared.name, declared)
            except BrokenPlugin as error:
                broken.append(str(error))
        with self._lock:
            self._classes, self._broken = classes, tuple(broken)

    def declared(self) -> List[PluginClass]:
        """All declared classes, by name."""
        self.refresh()
        with self._lock:
            return [self._classes[name] for name in sorted(self._classes)]

    def find(self, name: str) -> PluginClass:
        """Return what is declared as ``name``; one refresh if it is not known yet.

        Raises:
            UnknownNodeletType: no package declares it.
        """
        if name not in self._classes:
            self.refresh()
        with self._lock:
            declared = self._classes.get(name)
            if declared is None:
                raise UnknownNodeletType(name, self._classes, self._broken)
        return declared
