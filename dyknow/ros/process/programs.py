# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The programs of packages: their paths and kinds."""

from __future__ import annotations

import functools
import os
import shlex
import sys
from typing import Any

from dyknow.errors import CannotRun
from dyknow.model.graph import NodeletKind
from dyknow.model.transformation import Program

#: The nodelet that runs a Python script, which is its first argument.
SCRIPT = "dyknow/Script"
#: How a binary begins.
ELF = "\x7fELF"


def find_program(package: str, executable: str) -> str:
    """Return the path of a package's program: the one that rosrun and roslaunch run.

    One that is installed for the package (in a devel space a relay to its source) comes before
    those in its folder; a path below the folder names one of these.

    Raises:
        CannotRun: there is none, or there are several.
    """
    import rospkg  # here: reading first lines does not wait for it

    try:
        folder, found = _found(package, executable)
    except rospkg.ResourceNotFound:
        folder, found = "", []
    if not found:  # the packages are searched again only now: that takes longer than all else
        _packages.cache_clear()
        try:
            folder, found = _found(package, executable)
        except rospkg.ResourceNotFound as error:
            raise CannotRun(f"there is no package '{package}' on ROS_PACKAGE_PATH") from error
    if not found:
        raise CannotRun(f"package '{package}' has no program '{executable}'")
    installed = [path for path in found if not path.startswith(os.path.join(folder, ""))]
    if len(found) > 1 and len(installed) != 1:
        raise CannotRun(
            f"'{executable}' may be one of {', '.join(found)}: expected one program, or its path "
            f"below {folder}"
        )
    return (installed or found)[0]


def _found(package: str, executable: str) -> tuple[str, list[str]]:
    """Return the folder of a package, and the programs of that name, as rosrun finds them."""
    from roslib.packages import find_node

    folder = _packages().get_path(package)
    if "/" not in executable:
        return folder, sorted(set(map(str, find_node(package, executable, _packages()))))
    path = os.path.join(folder, executable)
    is_below = ".." not in executable.split("/")
    is_program = is_below and os.path.isfile(path) and os.access(path, os.X_OK)
    return folder, [path] if is_program else []


@functools.lru_cache(maxsize=1)
def _packages() -> Any:
    import rospkg

    return rospkg.RosPack()


def find_script(name: str) -> str:
    """Return the path of a script in Python that is named ``PKG/SCRIPT``, or by its path."""
    package, slash, executable = name.partition("/")
    if not slash:
        raise CannotRun(f"'{name}' names no script: expected PACKAGE/SCRIPT or a path")
    path = name if os.path.isabs(name) else find_program(package, executable)
    if interpreter(path) is None:
        raise CannotRun(f"'{path}' is no script in Python: its first line does not say so")
    return path


def kind_of(program: Program) -> NodeletKind:
    """Return the kind of a program when it is spawned; raises `CannotRun` for other files."""
    path = find_program(program.package, program.executable)
    if interpreter(path) is not None:
        return NodeletKind.SCRIPT
    if first_line(path).startswith(ELF):
        return NodeletKind.CPP_NODE
    raise CannotRun(
        f"'{path}' is neither a Python script nor a binary; expected a node of rospy or roscpp"
    )


def interpreter(path: str) -> list[str] | None:
    """Return the command of a Python script, by its first line; None for other programs."""
    first = first_line(path)
    if not first.startswith("#!") or "python" not in first or "python2" in first:
        return None
    words = shlex.split(first[2:])
    while words and "python" not in os.path.basename(words[0]):
        words.pop(0)  # env, and its options
    if not words:
        return None
    if not os.path.isabs(words[0]) or not os.path.exists(words[0]):
        words[0] = sys.executable
    return words


def first_line(path: str) -> str:
    """Return the first line of a file, as much of it as the system reads."""
    try:
        with open(path, "rb") as file:
            return file.readline(200).decode("latin-1")
    except OSError as error:
        raise CannotRun(f"'{path}' cannot be read: {error.strerror}") from error
