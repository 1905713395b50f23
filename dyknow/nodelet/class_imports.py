# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Imports the classes of nodelets: the code that is on disk at the load.

Nodelets of a package share its modules. When a file of it has changed since they were imported,
the next load begins a new *generation*, with modules of its own; nodelets that run keep theirs.
The modules of a package that uses libraries of the middleware are not shared: those act in the
name of one nodelet.
"""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import dataclass
from importlib.machinery import PathFinder
from typing import Callable, Dict, FrozenSet, List, Mapping, Optional, Type

from dyknow.errors import BrokenPlugin
from dyknow.nodelet.context import Context
from dyknow.nodelet.importer import Importer, Module
from dyknow.nodelet.module_files import CatkinFinder, Stamp, source_files, stamps
from dyknow.nodelet.nodelet import Nodelet
from dyknow.nodelet.plugins import BASE_CLASS, PluginClass

#: The runtime's own package, which is never loaded again.
_OURS = "dyknow"


@dataclass(frozen=True)
class Package:
    """The modules that a declared class comes with.

    Attributes:
        tops: their top-level names.
        folders: where they are, if that is a folder of plug-ins and not on ``sys.path``.
        files: their source files, by module name.
    """

    tops: FrozenSet[str]
    folders: List[str]
    files: Mapping[str, str]


@dataclass(frozen=True)
class _Generation:
    """Modules of a package, and the files that they were made of.

    Attributes:
        stamps: of all files of the package, when it began.
        importer: has the modules; None for the process's own.
    """

    stamps: Mapping[str, Stamp]
    importer: Optional[Importer]


class ClassImports:
    """Imports classes for nodelets.

    Args:
        library_importer: returns an importer of a nodelet's own if the module of that name in the
            package uses libraries of the middleware, else None.
    """

    def __init__(
        self,
        library_importer: Callable[[Context, str, Package], Optional[Importer]] = lambda *_: None,
    ) -> None:
        self._library_importer = library_importer
        self._generations: Dict[str, _Generation] = {}
        CatkinFinder.install()

    def load(self, declared: PluginClass, context: Context) -> Type[Nodelet]:
        """Import a declared class.

        Raises:
            BrokenPlugin: it does not import, or is no Nodelet.
        """
        what = f"nodelet type '{declared.name}' ({declared.type}, declared in '{declared.file}')"
        module_name, _, class_name = declared.type.rpartition(".")
        if not module_name:
            raise BrokenPlugin(what, "expected a dotted path 'module.Class'")
        try:
            module = self._module(module_name, str(declared.library.resolve()), context)
        except (Exception, SystemExit) as error:  # an import runs the author's code
            raise BrokenPlugin(
                what, f"cannot import '{module_name}': {type(error).__name__}: {error}"
            ) from error
        found = getattr(module, class_name, None)
        if found is None:
            raise BrokenPlugin(what, f"module '{module_name}' has no class '{class_name}'")
        if not isinstance(found, type) or not issubclass(found, Nodelet):
            raise BrokenPlugin(what, f"'{declared.type}' does not derive from {BASE_CLASS}")
        return found

    def _module(self, name: str, library: str, context: Context) -> Module:
        top = name.partition(".")[0]
        if top == _OURS:
            return importlib.import_module(name)
        importlib.invalidate_caches()  # files may be new
        package = _package(top, library)
        importer = self._library_importer(context, name, package)
        if importer is not None:
            return importer.import_module(name)
        return self._current(top, package, name)

    def _current(self, top: str, package: Package, name: str) -> Module:
        now = stamps(package.files.values())
        generation = self._generations.get(top)
        if generation is None or generation.stamps != now:
            is_first = generation is None
            importer = (
                None if is_first else Importer(package.tops.__contains__, search=package.folders)
            )
            for folder in package.folders if is_first else ():
                _make_importable(folder)
            generation = self._generations[top] = _Generation(now, importer)
        if generation.importer is None:
            return importlib.import_module(name)
        return generation.importer.import_module(name)


def _package(top: str, library: str) -> Package:
    if os.path.isdir(library) and PathFinder.find_spec(top, [library]) is not None:
        tops = {each.partition(".")[0] for each in os.listdir(library) if each.endswith(".py")}
        tops = {top, *tops}
        files = {n: f for each in sorted(tops) for n, f in source_files(each, [library]).items()}
        return Package(frozenset(tops), [library], files)
    return Package(frozenset((top,)), [], source_files(top))


def _make_importable(folder: str) -> None:
    if folder not in sys.path:
        sys.path.insert(0, folder)
