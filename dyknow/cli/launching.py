# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""roslaunch's own parent process, whose nodes get the prefixes of a plan before it starts them.

The order of steps is that of the program `roslaunch`.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from functools import lru_cache
from typing import Any, Iterator, List, Optional, Sequence

import roslaunch
import rospkg
from roslaunch import rlutil
from roslaunch.core import is_machine_local
from roslaunch.parent import ROSLaunchParent
from roslib.packages import find_node

from dyknow.cli.launch_files import ERRORS, STDIN, explain, one_line, place_of_node
from dyknow.cli.launch_plan import LaunchPlanner, NodeFilter, Treatment
from dyknow.cli.rewirable import find_in_workspaces
from dyknow.errors import CannotLaunch


@contextlib.contextmanager
def session(options: argparse.Namespace, files: Sequence[str]) -> Iterator[str]:
    """Wait for a master if that is asked for, and set up roslaunch's log; yields the run's id.

    Args:
        options: what `dyknow launch` was told.
        files: the launch files.
    """
    if options.wait:
        rlutil._wait_for_master()
    roslaunch.write_pid_file(options.pid, False, options.port)
    try:
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


def read(
    options: argparse.Namespace, files: Sequence[str], given: Sequence[str], run_id: str = ""
) -> ROSLaunchParent:
    """Make roslaunch's parent and let it read launch files.

    Args:
        options: what `dyknow launch` was told.
        files: the launch files; `-` for standard input.
        given: their arguments, `NAME:=VALUE`.
        run_id: id of the run.

    Raises:
        CannotLaunch: they cannot be read.
    """
    sources = [(file, list(given)) for file in files if file != STDIN]
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
            roslaunch_strs=[sys.stdin.read()] if STDIN in files else None,
            show_summary=not options.no_summary,
            **_given_timeouts(options),
        )
        parent._load_config()
    except Exception as error:  # a boundary: launch files have expressions, which may raise any
        raise CannotLaunch(explain(sources, error)) from error
    return parent


def plan(parent: ROSLaunchParent, chosen: NodeFilter) -> List[Treatment]:
    """Decide what becomes of the nodes of a launch, in roslaunch's order.

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
    def find(package: str, type_: str) -> Optional[str]:
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
    """Start a launch, and return when it has ended, for whatever reason.

    Args:
        parent: has read the launch files.
        treatments: what becomes of its nodes, in their order.

    Raises:
        CannotLaunch: it cannot be started.
    """
    for node, treatment in zip(parent.config.nodes, treatments):
        node.launch_prefix = treatment.prefix or None
    try:
        parent.start()
        parent.spin()
    except ERRORS as error:
        raise CannotLaunch(one_line(error)) from error


def _given_timeouts(options: argparse.Namespace) -> Any:
    """Return the time limits that were given; roslaunch has defaults of its own for the others."""
    limits = {"sigint_timeout": options.sigint_timeout, "sigterm_timeout": options.sigterm_timeout}
    return {name: value for name, value in limits.items() if value is not None}
