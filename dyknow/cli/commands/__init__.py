# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The commands of `dyknow`, and the modules that have them, which are imported when needed."""

from __future__ import annotations

from importlib import import_module

from dyknow.cli.shell import Command

#: Titles, and the commands below them with their modules and summaries, in the order of the help.
GROUPS = {
    "What runs": {
        "list": ("inspect", "list the nodelets"),
        "info": ("inspect", "show nodelets, their ports and connections"),
        "stats": ("inspect", "show the rates of the ports"),
        "graph": ("graph", "show or draw the computation graph"),
        "doctor": ("inspect", "find the defects of a system, and their cures"),
    },
    "Nodelets and nodes": {
        "spawn": ("nodelets", "make a nodelet from a transformation"),
        "destroy": ("nodelets", "destroy nodelets"),
        "restart": ("restart", "restart nodelets with today's code"),
        "set": ("restart", "set a parameter of a nodelet"),
        "protect": ("nodelets", "protect nodelets from being destroyed"),
        "unprotect": ("nodelets", "let protected nodelets be destroyed again"),
        "run": ("programs", "run a node so that its ports can be connected elsewhere"),
        "launch": ("launch", "start launch files with every node re-wirable"),
    },
    "Connections": {
        "connect": ("connect", "connect ports to each other, or to topics"),
        "disconnect": ("connect", "disconnect ports"),
    },
    "Streams on request": {
        "tags": ("streams", "list the tags of streams"),
        "acquire": ("acquire", "ask for a stream and hold it"),
        "plan": ("streams", "explain how a stream would be made"),
        "streams": ("streams", "list the claimed streams"),
        "release": ("streams", "end claims"),
        "replan": ("streams", "switch a stream to the cheapest plan"),
        "holds": ("holds", "evaluate a formula on topics, streams or a bag"),
    },
    "What happened": {
        "record": ("record", "write the last seconds of streams as a bag"),
        "why": ("record", "tell what happened to a stream"),
    },
    "Transformations": {
        "library": ("library", "list the transformations, or show specifications"),
        "import": ("library", "add transformations from specification files"),
        "export": ("library", "write transformations as a specification file"),
        "remove": ("library", "remove transformations"),
        "check": ("library", "check specification files without a manager"),
        "probe": ("programs", "run a node once, and write its specification"),
    },
    "Whole wirings": {
        "save": ("save_load", "save the whole wiring in a file"),
        "load": ("save_load", "load a saved wiring"),
    },
}
COMMANDS = {name: found for group in GROUPS.values() for name, found in group.items()}


def find(name: str) -> Command:
    found: Command = getattr(import_module(f"{__name__}.{COMMANDS[name][0]}"), f"_{name}")
    return found
