# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodes of launch files: how each is made re-wirable, and roslaunch's parent that starts them.

A node is made re-wirable by its launch-prefix. The prefix that it has already is kept; ours stands
innermost, next to the node, except where a debugger has to be next to it.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import shlex
import sys
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Any, Callable, Iterator, Sequence

import roslaunch
import rospkg
from roslaunch import rlutil
from roslaunch.core import is_machine_local
from roslaunch.parent import ROSLaunchParent
from roslib.packages import find_node

from dyknow import names
from dyknow.cli.launch_files import ERRORS, explain, one_line, place_of_node, said
from dyknow.cli.output import STDIO
from dyknow.cli.rewirable import NO_LIBRARY, find_in_workspaces, find_library, obstacle
from dyknow.errors import CannotLaunch, CannotRun
from dyknow.ros.process import signals
from dyknow.ros.process.programs import interpreter

#: Nodes that are left alone unless `--only` names them, and why.
LEFT_ALONE = (
    ("rosbag/record", "a bag names the topics that were recorded"),
    ("rviz/*", "its user chooses topics in its window"),
    ("rqt*/*", "its user chooses topics in its window"),
    ("plotjuggler/*", "its user chooses topics in its window"),
    ("rosbridge_server/*", "its clients choose topics"),
    ("foxglove_bridge/*", "its clients choose topics"),
)
#: Have to start the program itself, not a script that becomes it.
_DEBUGGERS = frozenset({"gdb", "gdbserver", "lldb", "valgrind", "heaptrack", "ltrace"})
#: Take the next word for a script in Python.
_INTERPRETERS = ("python", "ipython", "pypy", "pdb", "pudb", "coverage", "kernprof", "scalene")
#: Start the program with another environment, or where our files are not.
_ELSEWHERE = frozenset(
    {"sudo", "su", "runuser", "pkexec", "doas", "ssh", "chroot", "schroot", "docker", "podman"}
)
#: `cwd="node"` is the folder of the first word of the command: the prefix goes there itself.
_GO_TO_THE_NODE = 'cd "${1%/*}" && '
#: On another machine: DyKnow's prefix if the workspace there has it, else the node alone.
_IF_THERE = (
    "IFS=:; for folder in $CMAKE_PREFIX_PATH; do "
    'test -x "$folder/lib/dyknow/rewirable" && exec "$folder/lib/dyknow/rewirable" "$@"; '
    'done; exec "$@"'
)


class How(Enum):
    """How a node runs."""

    LIBRARY = "live ports by the library"
    SCRIPT_HOST = "live ports by the script host"
    OTHER_MACHINE = "live ports if DyKnow is on that machine"
    AS_IT_IS = "as it is"


@dataclass(frozen=True)
class Treatment:
    """How a node is started."""

    node: str  # its global name
    program: str  # PACKAGE/TYPE
    machine: str  # as the launch file calls it; empty for this one
    how: How
    why: str  # it is left as it is, else empty
    prefix: str  # its whole launch-prefix, empty for none


@dataclass(frozen=True)
class NodeFilter:
    """Patterns, as of a shell, for names of nodes and for their programs."""

    only: Sequence[str] = ()  # if there are any, nodes that match none are left alone
    except_: Sequence[str] = ()  # nodes that match one are left alone

    def without_match(self, plan: Sequence[Treatment]) -> list[tuple[str, str]]:
        """Return the patterns that match no node, with their options."""
        given = [("--only", each) for each in self.only]
        given += [("--except", each) for each in self.except_]
        return [
            (option, pattern)
            for option, pattern in given
            if not any(matches(it.node, it.program, [pattern]) for it in plan)
        ]

    def reason(self, node: str, program: str) -> str:
        """Say why the patterns leave a node alone; empty if they do not."""
        if matches(node, program, self.except_):
            return "--except names it"
        if self.only:
            return "" if matches(node, program, self.only) else "--only does not name it"
        return next((why for pattern, why in LEFT_ALONE if fnmatchcase(program, pattern)), "")


def matches(node: str, program: str, patterns: Sequence[str]) -> bool:
    """Say whether a pattern matches a node's name, whose first `/` is optional, or its program."""
    known = (node, node.lstrip("/"), program)
    return any(fnmatchcase(name, pattern) for name in known for pattern in patterns)


@dataclass(frozen=True)
class LaunchPlanner:
    """Decides about nodes."""

    rewirable: str  # path of that program
    find: Callable[[str, str], str | None]  # the program of a package, as roslaunch does
    is_local: Callable[[Any], bool]  # whether a machine of the launch file is this one
    chosen: NodeFilter

    def treat(self, node: Any) -> Treatment:
        """Decide how one of roslaunch's nodes is started; the node is not changed."""
        is_local = self.is_local(node.machine)
        name = names.join(node.namespace, node.name)
        program = f"{node.package}/{node.type}"
        words = shlex.split(node.launch_prefix or "")
        how, prefix = How.AS_IT_IS, node.launch_prefix or ""
        why = self.chosen.reason(name, program) or _nothing_to_do(node) or _occupied(words)
        if not why:
            how, why = self._how(node) if is_local else (How.OTHER_MACHINE, "")
        if not why:
            prefix = self._prefix(words, is_local, node.cwd == "node" and not words)
        return Treatment(name, program, "" if is_local else node.machine.name, how, why, prefix)

    def _how(self, node: Any) -> tuple[How, str]:
        program = self.find(node.package, node.type)
        if program is None:
            return How.AS_IT_IS, "there is no such program"
        trouble = _hidden(node)
        try:
            if not trouble and interpreter(program) is not None:
                return How.SCRIPT_HOST, ""
            trouble = trouble or obstacle(program)
        except CannotRun as error:
            trouble = str(error)
        if not trouble and find_library() is None:
            trouble = NO_LIBRARY
        return (How.AS_IT_IS, trouble) if trouble else (How.LIBRARY, "")

    def _prefix(self, words: Sequence[str], local: bool, in_its_folder: bool) -> str:
        """Insert our command into the words of a node's prefix."""
        go = _GO_TO_THE_NODE if in_its_folder else ""
        if not local:
            own = ["/bin/sh", "-c", go + _IF_THERE, "sh"]
        elif go:
            own = ["/bin/sh", "-c", go + 'exec "$0" "$@"', self.rewirable]
        else:
            own = [self.rewirable]
        bare = [os.path.basename(word) for word in words]
        place = next((at for at, word in enumerate(bare) if word in _DEBUGGERS), len(words))
        return " ".join(map(shlex.quote, [*words[:place], *own, *words[place:]]))


def _nothing_to_do(node: Any) -> str:
    """Say why a node needs nothing; empty if it does."""
    if node.package == "dyknow":
        return "it is DyKnow's own"
    words = [word for word in node.args.split() if not word.startswith("-")]
    if (node.package, node.type) == ("nodelet", "nodelet") and words[:1] in (["load"], ["unload"]):
        return f"it {words[0]}s a nodelet and has no ports itself"
    return ""


def _occupied(prefix: Sequence[str]) -> str:
    """Say why nothing can be put into a launch-prefix; empty if it can."""
    for word in map(os.path.basename, prefix):
        if word == "rewirable":
            return "its launch-prefix makes it re-wirable"
        if word.startswith(_INTERPRETERS):
            return f"its launch-prefix runs it in {word}"
        if word in _ELSEWHERE:
            return f"its launch-prefix starts it by {word}, with another environment"
    return ""


def _hidden(node: Any) -> str:
    """Say whether the node's own environment hides DyKnow; empty if it does not."""
    path = dict(node.env_args).get("PYTHONPATH")
    if path is None or any(
        os.path.isdir(os.path.join(each, "dyknow")) for each in path.split(":")
    ):
        return ""
    return "DyKnow is not on the PYTHONPATH that the launch file sets for it"


@contextlib.contextmanager
def session(options: argparse.Namespace, files: Sequence[str]) -> Iterator[str]:
    """Wait for a master if `--wait` is set, and set up roslaunch's log; yields the run's id.

    Raises:
        CannotLaunch: the file with the process id cannot be written, or a setting is wrong.
    """
    with _preparing():
        if options.wait:
            rlutil._wait_for_master()
        roslaunch.write_pid_file(options.pid, False, options.port)
    try:
        with _preparing():
            run_id = rlutil.get_or_generate_uuid(options.run_id, options.wait)
            roslaunch.configure_logging(run_id)
            if not options.skip_log_check:
                rlutil.check_log_disk_usage()
            if not options.disable_title:
                rlutil.change_terminal_name(list(files), False)
        yield run_id
    finally:
        if options.pid:
            with contextlib.suppress(OSError):
                os.unlink(options.pid)


@contextlib.contextmanager
def _preparing() -> Iterator[None]:
    """Make one line of what roslaunch raises before it reads launch files."""
    try:
        yield
    except (OSError, *ERRORS) as error:
        raise CannotLaunch(said(error).replace("master URI", "ROS_MASTER_URI")) from error


def read(
    options: argparse.Namespace,
    files: Sequence[str],
    given: Sequence[str],
    run_id: str = "",
    piped: str = "",
) -> ROSLaunchParent:
    """Make roslaunch's parent read launch files, `-` for ``piped``; raises CannotLaunch."""
    sources = [(file, list(given)) for file in files if file != STDIO]
    timeouts = {
        name: getattr(options, name)
        for name in ("sigint_timeout", "sigterm_timeout")
        if getattr(options, name) is not None  # else roslaunch's own
    }
    # Where the log is not set up, logging would print the traceback of a wrong standard input.
    logging.getLogger("roslaunch").addHandler(logging.NullHandler())
    try:
        parent = ROSLaunchParent(
            run_id,
            sources,
            port=options.port,
            local_only=options.local,
            verbose=options.verbose,
            force_screen=options.screen,
            force_log=options.log,
            force_required=options.required,
            roslaunch_strs=[piped] if STDIO in files else None,
            show_summary=not options.no_summary,
            **timeouts,
        )
        with contextlib.redirect_stdout(sys.stderr):  # it says that it reads standard input
            parent._load_config()
    except Exception as error:  # a boundary: launch files have expressions, which may raise any
        raise CannotLaunch(explain(sources, error)) from error
    return parent


def plan(parent: ROSLaunchParent, chosen: NodeFilter) -> list[Treatment]:
    """Decide how the nodes of a launch are started, in roslaunch's order.

    Raises:
        CannotLaunch: DyKnow is in no workspace, or a machine's address is unknown.
    """
    rewirable = find_in_workspaces("lib", "dyknow", "rewirable")
    if rewirable is None:
        raise CannotLaunch(
            "lib/dyknow/rewirable is in no workspace on CMAKE_PREFIX_PATH; source the setup file "
            "of the one that DyKnow is built in"
        )
    packages = rospkg.RosPack()

    @lru_cache(maxsize=None)
    def find(package: str, type_: str) -> str | None:
        try:
            return next(iter(find_node(package, type_, packages)), None)
        except rospkg.ResourceNotFound:
            return None

    planner = LaunchPlanner(rewirable, find, is_machine_local, chosen)
    treatments = []
    for node in parent.config.nodes:
        try:
            treatments.append(planner.treat(node))
        except ERRORS as error:
            place = place_of_node(parent.roslaunch_files, node)
            raise CannotLaunch(f"{place}: node {node.name}: {one_line(error)}") from error
    return treatments


def run(parent: ROSLaunchParent, treatments: Sequence[Treatment]) -> None:
    """Start a launch with its nodes treated so, and wait for its end; raises CannotLaunch."""
    for node, treatment in zip(parent.config.nodes, treatments):
        node.launch_prefix = treatment.prefix or None
    signals.raise_swallowed()  # roslaunch drops all that is raised while it sets up its log
    try:
        parent.start()
        parent.spin()
    except ERRORS as error:
        raise CannotLaunch(one_line(error)) from error
