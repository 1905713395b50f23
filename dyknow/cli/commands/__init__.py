# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The commands of `dyknow`, a module for each group of them."""

from __future__ import annotations

from typing import Tuple

from dyknow.cli.command import Command
from dyknow.cli.commands import (
    acquire,
    check,
    doctor,
    graph,
    inspect,
    launch,
    library,
    nodelets,
    probe,
    run,
    save_load,
    statistics,
    streams,
    tags,
    wiring,
)

#: Titles and commands, in the order of the help.
GROUPS: Tuple[Tuple[str, Tuple[Command, ...]], ...] = (
    ("What runs", (*inspect.COMMANDS, *statistics.COMMANDS, *graph.COMMANDS, *doctor.COMMANDS)),
    ("Nodelets and nodes", (*nodelets.COMMANDS, *run.COMMANDS, *launch.COMMANDS)),
    ("Connections", wiring.COMMANDS),
    ("Streams on request", (*tags.COMMANDS, *acquire.COMMANDS, *streams.COMMANDS)),
    ("Transformations", (*library.COMMANDS, *check.COMMANDS, *probe.COMMANDS)),
    ("Whole wirings", save_load.COMMANDS),
)
