# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`run`: a node of a package, re-wirable."""

from __future__ import annotations

import argparse

from dyknow.cli.command import Command
from dyknow.cli.rewirable import CannotRun, become
from dyknow.cli.shell import Shell


def _run_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package", metavar="PKG", help="a package")
    parser.add_argument("executable", metavar="EXECUTABLE", help="a program of it")
    parser.add_argument(
        "words",
        nargs=argparse.REMAINDER,
        metavar="ARGUMENT",
        help="its arguments, remappings and parameters, as for rosrun",
    )


def _run(arguments: argparse.Namespace, shell: Shell) -> None:
    become([find_executable(arguments.package, arguments.executable), *arguments.words])


def find_executable(package: str, executable: str) -> str:
    """Return the path of a package's program.

    Raises:
        CannotRun: there is none, or there are several.
    """
    import rospkg
    from roslib.packages import find_node

    try:
        found = sorted(set(find_node(package, executable) or []))
    except rospkg.ResourceNotFound as error:
        raise CannotRun(f"there is no package '{package}' on ROS_PACKAGE_PATH") from error
    if not found:
        raise CannotRun(f"package '{package}' has no program '{executable}'")
    if len(found) > 1:
        raise CannotRun(f"'{executable}' may be one of {', '.join(found)}: expected one program")
    return str(found[0])


COMMANDS = (
    Command(
        "run",
        "run a node so that its ports can be connected elsewhere",
        "Runs a program of a package as rosrun does. A node of roscpp then has ports that can be "
        "connected elsewhere while it runs, and is shown with the nodelets. Anything else runs as "
        "it is, and says so. In a launch file the same is done by "
        'launch-prefix="rosrun dyknow rewirable".',
        "dyknow run topic_tools relay /scan /copy __name:=copier\n"
        "dyknow run nodelet nodelet standalone image_proc/resize image:=/camera/image_raw",
        _run_arguments,
        _run,
    ),
)
