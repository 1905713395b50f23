# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`rewirable`: runs a program of roscpp or rospy so that its ports can be connected elsewhere.

It becomes the program, so signals, exit codes and output are the program's own. A Python script
becomes DyKnow's host of scripts; for all else the library that makes a node of roscpp re-wirable
is preloaded. That goes through shells and wrappers, and takes itself out of the environment of the
first process that is linked with libroscpp, so that the children of a node are as they would be
without it.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from typing import NoReturn, Sequence

if __name__ == "__main__":
    import dyknow.interruptible  # noqa: F401
from dyknow.errors import CannotRun
from dyknow.ros.process.programs import ELF, first_line, interpreter

LIBRARY = "libdyknow_roscpp.so"  # the library in front of libroscpp
#: Why it cannot be put there.
NO_LIBRARY = (
    f"{LIBRARY} is not there: no workspace on CMAKE_PREFIX_PATH has it; DyKnow was built without "
    "roscpp, or its path has a colon"
)
#: Runs scripts in Python.
SCRIPT_HOST = "dyknow.ros.nodelets.script_process"
_USAGE = "usage: rosrun dyknow rewirable COMMAND [ARGUMENT ...]"
_HELP = f"""{_USAGE}

Runs a program of ROS, unchanged, so that its topics can be connected elsewhere while it runs.
Signals, output and exit code are its own.

  program with roscpp            has live ports: {LIBRARY} is preloaded
  Python script with rospy       has live ports: DyKnow's host of scripts runs it
  shell script, gdb, nice, ...   a program with roscpp that it starts has live ports
  anything else                  runs as it is, and a line on stderr says why

In a launch file it is the prefix of a node:

  <node pkg="topic_tools" type="relay" name="copier" args="/scan /copy"
        launch-prefix="rosrun dyknow rewirable"/>

On the command line 'dyknow run PKG EXECUTABLE' does the same, and finds the program as rosrun
does:

  dyknow run topic_tools relay /scan /copy __name:=copier
  dyknow connect /other_scan copier:/scan
"""


def main(words: Sequence[str] | None = None) -> int:
    """Become a program, by default the process's words; returns only if that fails."""
    command = list(sys.argv[1:] if words is None else words)
    if not command:
        print(_USAGE, file=sys.stderr)
        return 2
    if command[0] in ("-h", "--help"):
        print(_HELP, end="")
        return 0
    try:
        become(command)
    except CannotRun as error:
        print(f"rewirable: {error}", file=sys.stderr)
        return 127  # as shells say it


def become(command: Sequence[str]) -> NoReturn:
    """Replace this process with a program whose node is re-wirable, as far as it can be.

    Raises:
        CannotRun: the program does not exist.
    """
    program = shutil.which(command[0])
    if program is None:
        raise CannotRun(f"'{command[0]}' is no program that can be run")
    if interpreter(program) is not None:
        become_script([program, *command[1:]])
    environment = dict(os.environ)
    library = find_library()
    trouble = NO_LIBRARY if library is None else obstacle(program)
    if trouble or library is None:
        print(f"rewirable: '{command[0]}' runs as it is: {trouble}", file=sys.stderr, flush=True)
    else:
        _preload(library, environment)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):
        signal.signal(number, signal.SIG_DFL)  # Python ignores them, and exec would keep that
    try:
        os.execve(program, list(command), environment)
    except OSError as error:
        raise CannotRun(f"'{program}' cannot be run: {error.strerror}") from error


def _preload(library: str, environment: dict[str, str]) -> None:
    """Put a library in front of those of a program.

    The linker splits LD_PRELOAD at white space, and nothing quotes that there. It finds a library
    that is named without its folder by LD_LIBRARY_PATH, which may have such folders.
    """
    present = environment.get("LD_PRELOAD", "").replace(":", " ").split()
    if library.split() != [library]:
        folder, library = os.path.split(library)
        folders = list(filter(None, environment.get("LD_LIBRARY_PATH", "").split(":")))
        if folder not in folders:
            environment["LD_LIBRARY_PATH"] = ":".join([*folders, folder])
    environment["LD_PRELOAD"] = ":".join([library, *present])


def become_script(command: Sequence[str]) -> NoReturn:
    """Become a Python script whose node is re-wirable; raises CannotRun if that cannot be."""
    python = interpreter(command[0]) or [sys.executable]
    try:
        os.execv(python[0], [*python, "-m", SCRIPT_HOST, *command])
    except OSError as error:
        raise CannotRun(f"'{python[0]}' cannot be run: {error.strerror}") from error


def obstacle(program: str) -> str:
    """Say why a program cannot be made re-wirable by the library; empty if it may be.

    The programs that a shell script starts are unknown.
    """
    first = first_line(program)
    if first.startswith("#!") and "python" in first:
        return "it is a script for another Python"
    if not first.startswith((ELF, "#!")):
        return "it is no program for this machine"
    return ""


def find_library() -> str | None:
    return find_in_workspaces("lib", LIBRARY)


def find_in_workspaces(*parts: str) -> str | None:
    """Return the first path of a file in the workspaces that are set up; None if there is none."""
    folders: list[str] = os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep)
    paths = [os.path.join(folder, *parts) for folder in folders if folder]
    return next((path for path in paths if os.path.exists(path)), None)


if __name__ == "__main__":
    sys.exit(main())
