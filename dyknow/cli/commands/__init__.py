# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The commands of `dyknow`, a module for each family of them."""

from __future__ import annotations

from dyknow.cli.commands import (
    acquire,
    connect,
    graph,
    holds,
    inspect,
    launch,
    library,
    nodelets,
    programs,
    record,
    restart,
    save_load,
    streams,
)
from dyknow.cli.shell import Command

_MODULES = (
    *(inspect, graph, nodelets, restart, programs, launch),
    *(connect, streams, acquire, holds, record, library, save_load),
)
_FOUND = (each for module in _MODULES for each in vars(module).values())
_BY_NAME = {each.name: each for each in _FOUND if isinstance(each, Command)}

#: Titles and commands, in the order of the help.
GROUPS: tuple[tuple[str, tuple[Command, ...]], ...] = tuple(
    (title, tuple(_BY_NAME[name] for name in names.split()))
    for title, names in (
        ("What runs", "list info stats graph doctor"),
        ("Nodelets and nodes", "spawn destroy restart set protect unprotect run launch"),
        ("Connections", "connect disconnect"),
        ("Streams on request", "tags acquire plan streams release replan holds"),
        ("What happened", "record why"),
        ("Transformations", "library import export remove check probe"),
        ("Whole wirings", "save load"),
    )
)
