# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`restart` and `set`: nodelets with today's code, specification and parameters."""

from __future__ import annotations

import argparse
import time
from typing import Iterable, Sequence

from dyknow.cli import completion
from dyknow.cli.arguments import argument, flag, group
from dyknow.cli.shell import Acted, Shell, command
from dyknow.model.graph import Model, NodeletKind, NodeletStatus
from dyknow.model.transformation import Parameter


@command(
    "Restart nodelets, or nodelet managers with all their nodelets, one after another. They run "
    "today's code and are made as the library specifies them today; connections, parameters, "
    "protection and claims stay, and neighbours run on. Messages that come meanwhile are lost.",
    "dyknow restart detector\ndyknow restart --all-outdated\n"
    "dyknow restart /dyknow_nodelet_manager_2\ndyknow restart --watch detector",
    argument(
        "names",
        "NAME",
        "a nodelet or a nodelet manager",
        nargs="*",
        completer=completion.restartable,
    ),
    group(
        flag(
            "--all-outdated",
            "restart the nodelets whose code or specification has changed since their load",
        ),
        flag(
            "--watch",
            "restart nodelets, all or those that are named, whenever their files or "
            "specifications change, until Ctrl-C",
        ),
    ),
)
def _restart(arguments: argparse.Namespace, shell: Shell) -> int | None:
    if arguments.names and arguments.all_outdated:
        arguments.refuse("--all-outdated restarts what is outdated; expected it without names")
    if not (arguments.names or arguments.all_outdated or arguments.watch):
        arguments.refuse(
            "expected the names of nodelets or nodelet managers, --all-outdated, or --watch"
        )
    names = [shell.resolve(name) for name in arguments.names]
    if arguments.watch:
        _watch(names, shell)
    if arguments.all_outdated:
        names = [each.name for each in shell.client.get_graph().nodelets if each.outdated]
        if not (names or shell.as_json):
            shell.show(None, ["nothing is outdated"])
            return None
    return _restart_all(names, shell)


def _restart_all(names: Iterable[str], shell: Shell, indent: int | None = 2) -> int | None:
    """Restart in order, also after one failed; return the exit code."""

    def restart(name: str) -> Acted:
        began = time.monotonic()
        done = shell.client.restart(name)
        shell.warn(done.remarks)
        others = f" with {', '.join(done.names)}" if done.names not in ((), (name,)) else ""
        return done.names, [f"restarted {name}{others} in {time.monotonic() - began:.2f} s"]

    return shell.for_each("name", "restarted", names, restart, indent)


def _watch(names: Sequence[str], shell: Shell) -> None:
    """Restart outdated nodelets; one that stays outdated is tried again at its next change.

    A nodelet in C++ that shares its process keeps the library of that. Any other one has the code
    of the moment of its restart: if it is outdated, the code was saved again since.
    """
    tried: dict[str, tuple[str, int]] = {}

    def due(model: Model) -> list[NodeletStatus]:
        return [
            each
            for each in model.nodelets
            if each.outdated
            and (not names or each.name in names or each.manager in names)
            and tried.get(each.name) != (each.outdated, model.library_revision)
        ]

    while True:
        model = shell.client.wait_for_model(lambda model: bool(due(model)))
        for each in due(model) if model is not None else ():
            assert model is not None
            tried[each.name] = each.outdated, model.library_revision
            if not _restart_all([each.name], shell, indent=None):
                keeps_library = each.kind is NodeletKind.CPP and not each.isolated
                now = shell.client.get_graph().nodelet(each.name) if keeps_library else None
                if now is None or not now.outdated:
                    del tried[each.name]


@command(
    "Set a private parameter of a nodelet, as if it had been given at the spawn: it is saved and "
    "restored. Nodelets read most parameters when they are loaded, so --restart may be needed.",
    "dyknow set camera rate 5\ndyknow set camera rate 5 --restart",
    argument("name", "NAME", "a nodelet"),
    argument("parameter", "PARAM", "name of the parameter"),
    argument("value", "VALUE", "its value, of the type that its transformation declares"),
    flag("--restart", "restart the nodelet unless it has read the parameter already"),
)
def _set(arguments: argparse.Namespace, shell: Shell) -> None:
    name = shell.resolve(arguments.name)
    given = Parameter(arguments.parameter, "", arguments.value)
    done = shell.client.set_parameter(name, given)
    shell.warn(done.remarks)
    is_read = done.is_read
    if arguments.restart and not is_read:
        shell.warn(shell.client.restart(name).remarks)
        is_read = True
    hint = "" if is_read else f"; {name} reads it when it is restarted: dyknow restart {name}"
    shell.show(
        {"nodelet": name, "name": given.name, "value": given.text, "is_read": is_read},
        [f"{name}: {given.name} = {given.text}{hint}"],
    )
