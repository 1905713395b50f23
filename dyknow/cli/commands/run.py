# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`run`: a node of a package, re-wirable."""

from __future__ import annotations

import argparse

from dyknow.cli import completion
from dyknow.cli.command import Command
from dyknow.cli.rewirable import become
from dyknow.cli.shell import Shell
from dyknow.ros.programs import find_program


def program_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare a program and its arguments, as for rosrun."""
    completion.complete_with(
        parser.add_argument("package", metavar="PKG", help="a package"), completion.packages
    )
    parser.add_argument("executable", metavar="EXECUTABLE", help="a program of it")
    parser.add_argument(
        "words",
        nargs=argparse.REMAINDER,
        metavar="ARGUMENT",
        help="its arguments, remappings and parameters, as for rosrun",
    )


def _run(arguments: argparse.Namespace, shell: Shell) -> None:
    become([find_program(arguments.package, arguments.executable), *arguments.words])


COMMANDS = (
    Command(
        "run",
        "run a node so that its ports can be connected elsewhere",
        "Runs a program of a package as rosrun does. A node of roscpp or rospy then has ports "
        "that can be connected elsewhere while it runs, and is shown with the nodelets. Anything "
        "else runs as it is, and says so. In a launch file the same is done by "
        'launch-prefix="rosrun dyknow rewirable".',
        "dyknow run topic_tools relay /scan /copy __name:=copier\n"
        "dyknow run topic_tools transform /numbers /doubled std_msgs/Float64 'm.data * 2'\n"
        "dyknow run nodelet nodelet standalone image_proc/resize image:=/camera/image_raw",
        program_arguments,
        _run,
    ),
)
