# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet classes: which ones packages declare, and their import as the code on disk at the load.

A package exports ``<dyknow plugin="${prefix}/FILE.xml"/>``; the file lists ``<library>`` elements
with ``<class name= type= base_class_type="dyknow.Nodelet">`` in them, as nodelet and rqt plugins
do. Only declared classes can be loaded.

Nodelets of a package share its modules. When a file of it has changed since they were imported,
the next load begins a new *generation*, with modules of its own; running nodelets keep theirs.
The modules of a package that uses libraries of the middleware are not shared: those act in the
name of one nodelet.
"""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import dataclass
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Callable, Iterable, Iterator, Mapping

from lxml import etree

from dyknow.errors import BrokenPlugin, UnknownNodeletType, described
from dyknow.locks import state_lock
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.loading.importer import Importer, Module
from dyknow.nodelet.loading.module_files import (
    CatkinFinder,
    Stamp,
    forget_bytecode,
    package_spec,
    source_files,
    stamps,
)

_BASE_CLASS = "dyknow.Nodelet"
_OURS = "dyknow"  # the runtime's own package, which is never loaded again


@dataclass(frozen=True)
class PluginFile:
    """A description (an XML file) that a package exports, of folders in ``directory``."""

    package: str
    directory: Path
    file: Path


def plugin_files(tag: str = "dyknow") -> Iterator[PluginFile]:
    """List every ``<export><TAG plugin="…"/>`` of the packages on ROS_PACKAGE_PATH."""
    return (found for attribute, found in exports(tag) if attribute == "plugin")


def exports(tag: str) -> Iterator[tuple[str, PluginFile]]:
    """List all attributes of ``<export><TAG …/>`` of packages that name files, with these."""
    import rospkg  # here: declared classes are known without ROS's packages too

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
            for attribute, text in export.items():
                if text:
                    file = Path(text.replace("${prefix}", str(directory)))
                    yield attribute, PluginFile(package, directory, directory / file)


@dataclass(frozen=True)
class PluginClass:
    """One class that a file declares."""

    name: str  # ``package/Class``, in ``source`` and in load requests
    type: str  # dotted path
    description: str  # one line for people, may be empty
    library: Path  # the module is searched there first, if it exists
    file: Path


def read(plugin_file: PluginFile) -> list[PluginClass]:
    """Read one description; raises BrokenPlugin if it is not there, not XML, or not complete."""
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
            if base != _BASE_CLASS:
                raise BrokenPlugin(
                    where, f"expected base_class_type='{_BASE_CLASS}' for '{name}', found {base!r}"
                )
            description = " ".join((element.findtext("description") or "").split())
            classes.append(PluginClass(name, type_name, description, directory, plugin_file.file))
    return classes


class Plugins:
    """The declared nodelet classes of all packages; ``find`` lists their descriptions."""

    def __init__(self, find: Callable[[], Iterable[PluginFile]]) -> None:
        self._find = find
        self._lock = state_lock("plug-ins")
        self._classes: dict[str, PluginClass] = {}
        self._broken: tuple[str, ...] = ()
        #: Of each description, as it was read.
        self._stamps: Mapping[Path, Mapping[str, Stamp]] = {}

    def refresh(self) -> None:
        """Read the descriptions again; a broken one is remembered and hides no other."""
        classes: dict[str, PluginClass] = {}
        broken: list[str] = []
        found = sorted(self._find(), key=lambda each: (each.package, str(each.file)))
        present = {each.file: stamps([str(each.file)]) for each in found}
        for plugin_file in found:
            try:
                for declared in read(plugin_file):
                    classes.setdefault(declared.name, declared)
            except BrokenPlugin as error:
                broken.append(str(error))
        with self._lock:
            self._classes, self._broken, self._stamps = classes, tuple(broken), present

    def declared(self) -> list[PluginClass]:
        """All declared classes, by name."""
        self.refresh()
        with self._lock:
            return [self._classes[name] for name in sorted(self._classes)]

    def find(self, name: str) -> PluginClass:
        """Return the class declared as ``name``, or raise UnknownNodeletType.

        Refreshes once, if the name is not known or its description has changed.
        """
        known = self._classes.get(name)
        if known is None or self._stamps.get(known.file) != stamps([str(known.file)]):
            self.refresh()
        with self._lock:
            declared = self._classes.get(name)
            if declared is None:
                raise UnknownNodeletType(name, self._classes, self._broken)
        return declared


@dataclass(frozen=True)
class Package:
    """The modules that a declared class comes with."""

    tops: frozenset[str]  # their top-level names
    folders: list[str]  # of plug-ins, not on ``sys.path``
    files: Mapping[str, str]  # source files by module name

    @classmethod
    def find(cls, top: str, library: str) -> Package:
        """Find the package of a top-level module; ``library`` is searched first."""
        if not os.path.isdir(library) or PathFinder.find_spec(top, [library]) is None:
            return cls(frozenset((top,)), [], source_files(top))
        tops = {each.stem for each in Path(library).glob("*.py")}
        tops.add(top)
        if not os.path.isdir(os.path.join(library, top)):  # else its modules are in a package
            tops |= {each.parent.name for each in Path(library).glob("*/__init__.py")}
        files = {n: f for each in sorted(tops) for n, f in source_files(each, [library]).items()}
        return cls(frozenset(tops), [library], files)

    def is_hidden(self) -> bool:
        """Whether the process has other modules of these names, or finds them first."""
        if not self.folders:
            return False
        found = [package_spec(top, sys.path) for top in self.tops]
        files = [spec.origin for spec in found if spec is not None]
        files += [getattr(sys.modules.get(top), "__file__", None) for top in self.tops]
        ours = set(map(os.path.realpath, self.files.values()))
        return any(file and os.path.realpath(file) not in ours for file in files)


class ClassImports:
    """Imports classes for nodelets.

    ``library_importer`` returns an importer of a nodelet's own if the module of that name in the
    package uses libraries of the middleware, else None.
    """

    def __init__(
        self,
        library_importer: Callable[[Context, str, Package], Importer | None] = lambda *_: None,
    ) -> None:
        self._library_importer = library_importer
        #: Held where loads at the same time would meet: Python's caches, and the generations.
        self._lock = state_lock("modules of packages")
        #: By package: stamps of its files, and its modules; None for the process's own.
        self._generations: dict[tuple[str, ...], tuple[Mapping[str, Stamp], Importer | None]] = {}
        CatkinFinder.install()

    def load(self, declared: PluginClass, context: Context) -> type[Nodelet]:
        """Import a declared class; raises BrokenPlugin if that fails, or it is not a Nodelet."""
        what = f"nodelet type '{declared.name}' ({declared.type}, declared in '{declared.file}')"
        module_name, _, class_name = declared.type.rpartition(".")
        if not module_name:
            raise BrokenPlugin(what, "expected a dotted path 'module.Class'")
        try:
            module = self._module(module_name, str(declared.library.resolve()), context)
        except (Exception, SystemExit) as error:  # an import runs the author's code
            raise BrokenPlugin(
                what, f"cannot import '{module_name}': {described(error)}"
            ) from error
        found = getattr(module, class_name, None)
        if found is None:
            raise BrokenPlugin(what, f"module '{module_name}' has no class '{class_name}'")
        if not isinstance(found, type) or not issubclass(found, Nodelet):
            raise BrokenPlugin(what, f"'{declared.type}' does not derive from {_BASE_CLASS}")
        return found

    def _module(self, name: str, library: str, context: Context) -> Module:
        top = name.partition(".")[0]
        if top == _OURS:
            return importlib.import_module(name)
        with self._lock:  # two callers at once may get a KeyError
            importlib.invalidate_caches()  # files may be new
        package = Package.find(top, library)
        forget_bytecode(package.files.values())
        importer = self._library_importer(context, name, package)
        if importer is None:
            with self._lock:
                importer = self._generation(top, package)
        return importlib.import_module(name) if importer is None else importer.import_module(name)

    def _generation(self, top: str, package: Package) -> Importer | None:
        now, key = stamps(package.files.values()), (top, *package.folders)
        if key not in self._generations and not package.is_hidden():
            self._generations[key] = now, None
            sys.path[:0] = [each for each in package.folders if each not in sys.path]
        elif key not in self._generations or self._generations[key][0] != now:
            importer = Importer(package.tops.__contains__, search=package.folders)
            self._generations[key] = now, importer
        return self._generations[key][1]
