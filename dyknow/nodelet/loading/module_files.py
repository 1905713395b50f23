# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Where modules come from: which are Python's own, and which need a library.

The files that catkin puts into a devel space execute those of the source space; they are followed
to these. There is one way to find a package, for shared modules and for copies: ``package_spec``.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib.util
import math
import os
import re
import sys
import sysconfig
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Collection, Iterator, Mapping, Sequence, Tuple

_RELAY = re.compile(r"^__extended_path = (['\"])(.*?)\1", re.MULTILINE)
_SCRIPT_RELAY = re.compile(r"^python_script = (['\"])(.*?)\1$", re.MULTILINE)
_IMPORTED = re.compile(
    r"^[ \t]*(?:from[ \t]+([A-Za-z_]\w*)|import[ \t]+([A-Za-z_][\w., \t]*))", re.MULTILINE
)
_TOP = re.compile(r"(?:^|,)[ \t]*(\w+)")
_STANDARD = tuple(os.path.join(sysconfig.get_paths()[key], "") for key in ("stdlib", "platstdlib"))
_THIRD_PARTY = ("site-packages", "dist-packages")
#: Folders of a package that import no library: generated messages, and tests.
_LEFT_OUT = frozenset(("msg", "srv", "cfg", "test", "tests", "__pycache__"))
_MOST_FILES = 100  # a package with more files than this is not a library for ROS

_WELL_AFTER = 2_000_000_000  # nanoseconds: more than reading and compiling a file takes

Stamp = Tuple[int, int]


def is_standard(top: str) -> bool:
    """Whether a top-level module belongs to Python itself."""
    if top in sys.builtin_module_names:
        return True
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return False
    origin = spec.origin if spec is not None else None
    if origin in ("built-in", "frozen"):
        return True
    if origin is None or any(part in origin.split(os.sep) for part in _THIRD_PARTY):
        return False
    return origin.startswith(_STANDARD)


def package_spec(top: str, path: Collection[str]) -> ModuleSpec | None:
    """Find a top-level module; of a catkin package, with every folder that holds its modules.

    A package in a devel space has its authors' modules in the source space, and generated ones
    (``msg``, ``srv``, ``cfg``) in the devel space. A relay there joins them, but it also puts the
    source space in front of ``sys.path``, so the next search may find the source folder alone.
    This finds both, whichever comes first.
    """
    spec = PathFinder.find_spec(top, list(path))
    if spec is None or os.path.basename(spec.origin or "") != "__init__.py":
        return spec
    found = _without_relay(spec)
    home = os.path.dirname(spec.origin or "")
    if found is not spec or os.path.basename(os.path.dirname(home)) in _THIRD_PARTY:
        return found
    for folder in path:
        if os.path.basename(os.path.normpath(folder)) in _THIRD_PARTY:
            beside = PathFinder.find_spec(top, [folder])
            if beside is not None and _completes(beside, home):
                below = beside.submodule_search_locations or ()
                found.submodule_search_locations = list(dict.fromkeys([home, *below]))
                break
    return found


def _without_relay(spec: ModuleSpec) -> ModuleSpec:
    for source in _sources(spec):
        file = os.path.join(source, "__init__.py")
        if os.path.isfile(file):
            folders = [source, *(spec.submodule_search_locations or ())]
            found = importlib.util.spec_from_file_location(
                spec.name, file, submodule_search_locations=folders
            )
            return found or spec
    return spec


def _completes(spec: ModuleSpec, home: str) -> bool:
    """Whether a package holds only the generated modules of the one in a source folder."""
    if any(os.path.realpath(source) == os.path.realpath(home) for source in _sources(spec)):
        return True
    try:
        return not ast.parse(Path(spec.origin or "").read_bytes()).body
    except (OSError, SyntaxError, ValueError):
        return False


class CatkinFinder:
    """Lets Python itself import the packages of devel spaces with all of their folders."""

    @classmethod
    def install(cls) -> None:
        """Add it to this process, once."""
        if not any(isinstance(each, cls) for each in sys.meta_path):
            sys.meta_path.insert(0, cls())

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a package that is in a source folder; everything else is left to Python."""
        if path is not None or fullname in sys.builtin_module_names:
            return None
        spec = package_spec(fullname, sys.path)
        if spec is None or len(spec.submodule_search_locations or ()) < 2:
            return None
        return spec if os.path.dirname(os.path.dirname(spec.origin or "")) in sys.path else None


def script_file(path: str) -> str:
    """Return the real file of a script; of a relay in a devel space, the file that it executes."""
    real = os.path.realpath(path)
    try:
        with open(real, encoding="utf-8", errors="replace") as file:
            found = _SCRIPT_RELAY.search(file.read(2000))
    except OSError:
        return real
    return os.path.realpath(found.group(2)) if found else real


def source_files(
    top: str, path: Collection[str] | None = None, most: float = math.inf
) -> dict[str, str]:
    """Return the source files of a top-level module and its submodules, by module name.

    With more than ``most`` files there are none.
    """
    spec = package_spec(top, sys.path if path is None else path)
    if spec is None:
        return {}
    folders = spec.submodule_search_locations
    if not folders:
        origin = spec.origin or ""
        return {top: origin} if origin.endswith(".py") else {}
    files: dict[str, str] = {}
    for folder in folders:
        for here, below, names in os.walk(folder):
            below[:] = sorted(each for each in below if each not in _LEFT_OUT)
            package = ".".join([top, *Path(here).relative_to(folder).parts])
            for name in sorted(each[:-3] for each in names if each.endswith(".py")):
                module = package if name == "__init__" else f"{package}.{name}"
                files.setdefault(module, os.path.join(here, f"{name}.py"))
            if len(files) > most:
                return {}
    return files


def reached_from(module: str, files: Mapping[str, str]) -> list[str]:
    """Return those ``files`` that the import of a module executes, at once or in its functions."""
    waiting, reached = [module], {}
    while waiting:
        name = waiting.pop()
        parts = name.split(".")
        for known in (".".join(parts[:count]) for count in range(1, len(parts) + 1)):
            if known in files and known not in reached:
                reached[known] = files[known]
                stamp = stamps([files[known]]).get(files[known])
                waiting += _imported_names(files[known], known, stamp)
    return sorted(reached.values())


@functools.lru_cache(maxsize=1000)
def _imported_names(file: str, module: str, stamp: Stamp | None) -> list[str]:
    """Full names of a file's imports; some may be classes and functions."""
    try:
        tree = ast.parse(Path(file).read_bytes(), file)
    except (OSError, SyntaxError, ValueError):
        return []
    package = module if os.path.basename(file) == "__init__.py" else module.rpartition(".")[0]
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*(above if node.level else ()), *filter(None, [node.module])])
            names += [f"{base}.{each.name}" for each in node.names]
    return names


def stamps(files: Collection[str]) -> dict[str, Stamp]:
    """Return the time and size of each file that exists, which change when it is written."""
    found = {}
    for file in files:
        with contextlib.suppress(OSError):
            status = os.stat(file)
            found[file] = (status.st_mtime_ns, status.st_size)
    return found


def forget_bytecode(files: Collection[str]) -> None:
    """Delete the bytecode of files that may be of an earlier version.

    Python knows a version by the second of its time and its size, and two may have been saved
    within one, or get the same time when they are copied. Bytecode that was written well after
    the file's ctime, which unlike its mtime cannot be set, is of the present version.
    """
    for file in files:
        with contextlib.suppress(OSError, NotImplementedError):
            bytecode = importlib.util.cache_from_source(file)
            if os.stat(bytecode).st_mtime_ns - os.stat(file).st_ctime_ns < _WELL_AFTER:
                os.remove(bytecode)


class Dependents:
    """Which top-level modules import a library, directly or not; ``apart`` do not count."""

    def __init__(self, library: str, apart: Collection[str] = ()) -> None:
        self._library = library
        self._apart = frozenset(apart)
        self._known: dict[str, bool] = {}

    def has(self, top: str) -> bool:
        """Whether a top-level module needs the library; the library itself does not."""
        if top == self._library or top in self._apart:
            return False
        if top not in self._known:
            self._known[top] = self._looked_up(top, {})
        return self._known[top]

    def imported_by(self, files: Collection[str]) -> frozenset[str]:
        """Return the top-level modules that these files import and that need the library."""
        return frozenset(filter(self.has, _imported_tops(files)))

    def _looked_up(self, top: str, seen: dict[str, bool]) -> bool:
        if top in self._known:
            return self._known[top]
        if top in seen or top == self._library or top in self._apart or is_standard(top):
            return top == self._library
        seen[top] = False
        files = source_files(top, most=_MOST_FILES).values()
        names = _imported_tops(files) - {top}
        return self._library in names or any(self._looked_up(name, seen) for name in names)


def _imported_tops(files: Collection[str]) -> set[str]:
    """Top-level names of the imports of all these files."""
    return {top for file, stamp in stamps(files).items() for top in _read_imports(file, stamp)}


@functools.lru_cache(maxsize=None)
def _read_imports(file: str, stamp: Stamp) -> frozenset[str]:
    """Read a file that may have errors; a parser would take thirty times as long."""
    text = Path(file).read_text(encoding="utf-8", errors="replace")
    return frozenset(
        top for found in _IMPORTED.findall(text) for top in _TOP.findall(",".join(found))
    )


def _sources(spec: ModuleSpec) -> Iterator[str]:
    """Folders in the source space that a package of a devel space points to."""
    origin = spec.origin or ""
    if os.path.basename(origin) != "__init__.py":
        return
    try:
        text = Path(origin).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return
    if "generated from catkin/cmake/template" in text[:200]:
        for found in _RELAY.finditer(text):
            for folder in found.group(2).split(";"):
                yield os.path.join(folder, spec.name)
