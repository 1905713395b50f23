# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`launch`: the nodes of launch files, re-wirable."""

from __future__ import annotations

import argparse
import sys
from itertools import groupby
from typing import TYPE_CHECKING, Any, Iterator, Sequence

from dyknow.cli import completion
from dyknow.cli.arguments import REPEATED, argument, flag, group
from dyknow.cli.output import STDIO, columns, count, picked
from dyknow.cli.shell import Shell, command
from dyknow.errors import CannotLaunch
from dyknow.similar import did_you_mean

if TYPE_CHECKING:
    from dyknow.cli.launching import NodeFilter, Treatment


_ROSLAUNCH = group(
    flag("--screen", "output of all nodes to the screen"),
    flag("--log", "output of all nodes to the log"),
    flag("--required", "every node is required"),
    flag("--local", "do not start nodes of other machines"),
    flag("--wait", "wait for the master"),
    argument("-p --port", "PORT", "port of the master, if it starts one"),
    argument("--pid", "FILE", "write its process id there", default="", type=str),
    argument("--run_id", "ID", "id of the run", completer=None),
    flag("-v --verbose", "say what is read"),
    flag("--no-summary", "no summary of roslaunch's"),
    flag("--skip-log-check", "do not look how large the logs are"),
    flag("--disable-title", "leave the terminal's title alone"),
    *(
        argument(f"--{it}-timeout", "SECONDS", f"time that a node has to end after {it.upper()}")
        for it in ("sigint", "sigterm")
    ),
    title="options of roslaunch",
)


@command(
    "Starts launch files as roslaunch does. The nodes then have ports that can be connected "
    "elsewhere while they run; nothing else is changed. What is left alone, and why, is said "
    "at the start. PATTERN is as of a shell; quote it.",
    "dyknow launch my_robot robot.launch camera:=left --screen\n"
    "dyknow launch my_robot robot.launch --dry-run\n"
    "dyknow launch robot.launch --except '/arm/*' --except 'usb_cam/*'",
    argument(
        "words",
        "FILE",
        "launch files, the first of PKG if that is given; - is standard input. "
        "NAME:=VALUE are their arguments",
        completer=completion.launch_words,
        nargs="+",
    ),
    argument("--given", None, argparse.SUPPRESS, **REPEATED),
    argument(
        "--only",
        "PATTERN",
        "leave all nodes alone whose name and PACKAGE/TYPE do not match; may be repeated",
        **REPEATED,
    ),
    argument(
        "--except",
        "PATTERN",
        "leave the nodes alone whose name or PACKAGE/TYPE matches; may be repeated",
        dest="except_",
        **REPEATED,
    ),
    flag("--dry-run", "show what would become of each node, and end"),
    _ROSLAUNCH,
    usage="dyknow launch [OPTION ...] [PKG] FILE ... [NAME:=VALUE ...]",
)
def _launch(arguments: argparse.Namespace, shell: Shell) -> None:
    from dyknow.cli import launching
    from dyknow.cli.launch_files import find_files, unknown_arguments
    from dyknow.cli.launching import NodeFilter

    if arguments.json and not arguments.dry_run:
        arguments.refuse("--json is for --dry-run")
    if arguments.screen and arguments.log:
        arguments.refuse("--screen and --log exclude each other")
    files, given = find_files(arguments.words), arguments.given
    piped = sys.stdin.read() if STDIO in files else ""
    chosen = NodeFilter(arguments.only, arguments.except_)

    def prepare(run_id: str = "") -> Any:
        parent = launching.read(arguments, files, given, run_id, piped)
        plan = launching.plan(parent, chosen)
        loaded = parent.config.roslaunch_files
        for problem in unknown_arguments(files, loaded, given, piped):
            shell.warn(problem)
        _check(chosen, plan, shell)
        return parent, plan

    if arguments.dry_run:
        parent, plan = prepare()
        for problem in parent.config.config_errors:
            shell.warn(problem)
        named = "node program machine how why launch_prefix=prefix"
        nodes = [{**picked(each, named), "how": each.how.name.lower()} for each in plan]
        shell.show({"nodes": nodes}, _table(plan))
        return
    with launching.session(arguments, files) as run_id:
        parent, plan = prepare(run_id)
        shell.show(None, _summary(plan))
        launching.run(parent, plan)


def _check(chosen: NodeFilter, plan: Sequence[Treatment], shell: Shell) -> None:
    """Refuse an `--only` that no node matches, and warn of an `--except`."""
    known = {name for each in plan for name in (each.node, each.program)}
    for option, pattern in chosen.without_match(plan):
        problem = f"{option} {pattern}: no node matches{did_you_mean(pattern, known)}"
        if option == "--only":
            raise CannotLaunch(problem)
        shell.warn(problem)


def _summary(plan: Sequence[Treatment]) -> Iterator[str]:
    """Say how many nodes are re-wirable, and which are left alone, a line for each reason."""
    from dyknow.cli.launching import How

    left = sorted((each for each in plan if each.why), key=lambda each: (each.why, each.node))
    away = sum(each.how is How.OTHER_MACHINE for each in plan)
    there = f", {away} more if DyKnow is on their machine" if away else ""
    yield f"re-wirable: {len(plan) - len(left) - away} of {count(len(plan), 'node')}{there}"
    for why, nodes in groupby(left, key=lambda each: each.why):
        yield f"left alone: {', '.join(each.node for each in nodes)} ({why})"


def _table(plan: Sequence[Treatment]) -> list[str]:
    rows = [("NODE", "RUNS", "HOW")]
    for each in sorted(plan, key=lambda each: each.node):
        how = f"{each.how.value}: {each.why}" if each.why else each.how.value
        where = f" on {each.machine}" if each.machine else ""
        rows.append((each.node, each.program + where, how))
    return columns(rows)
