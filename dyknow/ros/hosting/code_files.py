# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The files of nodelets' code on this machine, and whether they have changed since a load.

Of a nodelet in Python or a script these are its module and what that imports of its package; other
packages belong to the process, and a restart of a nodelet does not load them again. Of C++ it is
the library or the program. DyKnow's own files do not count.
"""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Iterator, Mapping, Tuple

from dyknow.errors import DyKnowError, HostError, UnknownNodeletType
from dyknow.locks import state_lock
from dyknow.model.transformation import NODE, Program, Transformation
from dyknow.nodelet.loading.module_files import (
    Stamp,
    forget_bytecode,
    reached_from,
    script_file,
    source_files,
    stamps,
)
from dyknow.nodelet.loading.plugins import Package, Plugins, plugin_files
from dyknow.ros.hosting.installed import cpp_descriptions
from dyknow.ros.process import programs

#: Seconds for which the stamps of files are relied on.
_PERIOD = 0.4
_OURS = "dyknow"


@dataclass(frozen=True)
class _Code:
    """The files of a source: their stamps at the last load, and now."""

    files: Tuple[str, ...]
    loaded: Mapping[str, Stamp]
    present: Mapping[str, Stamp]
    looked_at: float

    @property
    def text(self) -> str:
        if not self.present:
            return ""
        return hashlib.sha1(repr(sorted(self.present.items())).encode()).hexdigest()[:16]


class CodeFiles:
    """The code of each source; safe from any thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Know no files yet."""
        self._clock = clock
        self._plugins = Plugins(plugin_files)
        self._state_lock = state_lock("files of code")
        self._known: dict[tuple[str, str], _Code] = {}
        #: Stamps that were checked, and the problem of one of these files.
        self._checked: dict[tuple[str, str], tuple[Mapping[str, Stamp], str]] = {}

    def of(self, transformation: Transformation, anew: bool = False) -> str:
        """Return a text that differs when the files do; ``anew`` for a load: find them first."""
        key, now = (transformation.type, transformation.source), self._clock()
        with self._state_lock:
            code = self._known.get(key)
        if anew or code is None:
            files = tuple(self._files_of(transformation))
            if anew:
                forget_bytecode(files)  # a node in Python imports without us
            found = stamps(files)
            code = _Code(files, found, found, now)
        elif now - code.looked_at >= _PERIOD:
            code = replace(code, present=stamps(code.files), looked_at=now)
        else:
            return code.text
        with self._state_lock:
            self._known[key] = code
        return code.text

    def check(self, transformation: Transformation) -> None:
        """Raise HostError if a file that has changed since the last load is not Python."""
        self.of(transformation)
        key = (transformation.type, transformation.source)
        with self._state_lock:
            code = self._known[key]
            checked, problem = self._checked.get(key, (code.loaded, ""))
        if checked != code.present:
            changed = [
                file for file, each in code.present.items() if code.loaded.get(file) != each
            ]
            problem = next(filter(None, map(_problem_of, changed)), "")
            with self._state_lock:
                self._checked[key] = code.present, problem
        if problem:
            raise HostError(problem)

    def _files_of(self, transformation: Transformation) -> Iterator[str]:
        try:
            if transformation.type == NODE:
                yield from _files_of_program(Program.of(transformation.source))
            else:
                yield from self._files_of_nodelet(transformation.source)
        except (DyKnowError, OSError):
            return  # it is on another machine, perhaps

    def _files_of_nodelet(self, source: str) -> Iterator[str]:
        try:
            declared = self._plugins.find(source)
        except UnknownNodeletType:
            yield from _library_of(source)
            return
        module = declared.type.rpartition(".")[0]
        top = module.partition(".")[0]
        if top != _OURS:
            yield from reached_from(
                module, Package.find(top, str(declared.library.resolve())).files
            )


def _problem_of(file: str) -> str:
    """Say why a file is not Python, unless it is a library or a program."""
    try:
        text = Path(file).read_bytes()
        if not text.startswith(programs.ELF.encode()):
            compile(text, file, "exec", dont_inherit=True)
    except SyntaxError as error:
        return f"{file} cannot be run: line {error.lineno}: {error.msg}"
    except (OSError, ValueError) as error:
        return f"{file} cannot be run: {error}"
    return ""


def _files_of_program(program: Program) -> Iterator[str]:
    path = programs.find_program(program.package, program.executable)
    if programs.interpreter(path) is None:
        yield path
        return
    script = script_file(path)
    beside = {each.stem: str(each) for each in Path(script).parent.glob("*.py")}
    yield from reached_from(
        "__main__", {**source_files(program.package), **beside, "__main__": script}
    )


def _library_of(source: str) -> Iterator[str]:
    """Find the library of a nodelet in C++ in the workspaces of the environment."""
    for root in cpp_descriptions():
        for library in root.iter("library"):
            if source not in [each.get("name") for each in library.iter("class")]:
                continue
            name = os.path.basename(library.get("path") or "")
            for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep):
                yield os.path.join(prefix, "lib", f"{name}.so")
