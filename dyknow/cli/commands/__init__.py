"""The commands of `dyknow`, a module for each group of them."""

from __future__ import annotations

from typing import Tuple

from dyknow.cli.command import Command
from dyknow.cli.commands import (
    checking,
    completion,
    graph,
    holding,
    library,
    looking,
    nodelets,
    statistics,
    storage,
    streams,
    tags,
    wiring,
)

#: Titles and commands, in the order of the help; it leaves those without a title out.
GROUPS: Tuple[Tuple[str, Tuple[Command, ...]], ...] = (
    ("What runs", (*looking.COMMANDS, *statistics.COMMANDS, *graph.COMMANDS)),
    ("Nodelets", nodelets.COMMANDS),
    ("Connections", wiring.COMMANDS),
    ("Streams on request", (*tags.COMMANDS, *holding.COMMANDS, *streams.COMMANDS)),
    ("Transformations", (*library.COMMANDS, *checking.COMMANDS)),
    ("Whole wirings", storage.COMMANDS),
    ("", completion.COMMANDS),
)
