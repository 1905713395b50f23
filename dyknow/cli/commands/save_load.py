# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`save` and `load`: a whole wiring in one file."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Callable, Collection, Iterable, Iterator

from dyknow.cli.arguments import argument, flag
from dyknow.cli.output import Json, count, write_file
from dyknow.cli.shell import FAILED, Shell, command
from dyknow.errors import Problem, SpecificationError
from dyknow.guards import NO_GUARDS
from dyknow.manager.steps import carry_out
from dyknow.wiring.load import steps_of
from dyknow.wiring.plan import LoadPlan, plan_load
from dyknow.wiring.wiring import Wiring, read_wiring, too_many_nodelets, wiring_of

if TYPE_CHECKING:
    from dyknow.ros.shell.shell_client import ShellClient

STDIO = "-"


@command(
    "save",
    "save the whole wiring in a file",
    "Save what runs in one XML file: the nodelets, their connections, and the transformations "
    "that they are made from.",
    "dyknow save robot.xml\ndyknow save - | less",
    argument("file", "FILE", f"where to write it; {STDIO} for standard output"),
)
def _save(arguments: argparse.Namespace, shell: Shell) -> None:
    wiring, left_out = wiring_of(shell.client.get_model())
    for nodelet in left_out:
        shell.warn(f"'{nodelet.name}' is not saved: others loaded it, from no transformation")
    text = wiring.to_xml()
    if arguments.file == STDIO and not shell.as_json:
        shell.out.write(text)
        return
    if arguments.file != STDIO:
        write_file(arguments.file, text.encode("utf-8"))
    shell.show(
        {
            "file": arguments.file,
            "nodelets": [nodelet.name for nodelet in wiring.nodelets],
            "transformations": [each.label for each in wiring.transformations],
            "left_out": [nodelet.name for nodelet in left_out],
            **({"wiring": text} if arguments.file == STDIO else {}),
        },
        [
            f"saved {count(len(wiring.nodelets), 'nodelet')} and "
            f"{count(len(wiring.transformations), 'transformation')} to {arguments.file}"
        ],
    )


@command(
    "load",
    "load a saved wiring",
    "Load a saved wiring. The whole file is checked before anything is changed. Running "
    "nodelets that it names are kept, and connected and protected as it says; with "
    "--replace those that were made differently are made again. Other nodelets are left "
    "alone. When a step fails, the steps before it are undone.",
    "dyknow load robot.xml\ndyknow load robot.xml --dry-run\n"
    "dyknow load robot.xml --keep-going --any-manager",
    argument("file", "FILE", f"what 'save' wrote; {STDIO} for standard input"),
    flag("--dry-run", "check, and show what would be changed"),
    flag(
        "--keep-going",
        "go on when a step fails, and keep what was done (default: undo everything)",
    ),
    flag(
        "--replace",
        "replace transformations that differ, and make nodelets again that were made "
        "differently (default: refuse)",
    ),
    flag(
        "--any-manager",
        "where a nodelet manager is not running, let the DyKnow manager choose another",
    ),
)
def _load(arguments: argparse.Namespace, shell: Shell) -> int | None:
    client = shell.client
    try:
        wiring = _read(arguments.file, lambda: _limit(client))
    except SpecificationError as error:
        for each in error.problems:
            shell.error(each)
        return FAILED
    plan = plan_load(
        wiring,
        client.get_model(),
        client.nodelet_managers(),
        client.is_own_manager,
        arguments.replace,
        arguments.any_manager,
        client.stored_parameters,
    )
    most = _limit(client)
    if len(wiring.nodelets) > most:
        plan.problems.append(too_many_nodelets(most))
    if plan.problems:
        for problem in plan.problems:
            shell.error(f"{arguments.file}: {problem}")
        return FAILED
    failed = []
    if not arguments.dry_run:
        failed = carry_out(steps_of(plan, client), arguments.keep_going)
        for step, cause in failed:
            shell.error(f"{step.what}: {cause}")
    result = {
        **_outcome(plan, [step.subject for step, _ in failed]),
        "file": arguments.file,
        "dry_run": arguments.dry_run,
        "failed": [
            {"subject": step.subject, "step": step.what, "message": str(cause)}
            for step, cause in failed
        ],
    }
    shell.show(result, _lines(result))
    return FAILED if failed else None


def _limit(client: ShellClient) -> int:
    """How many nodelets may run."""
    name = "limits/nodelets"
    limit = client.stored_parameters(client.manager, [name]).get(name)
    return limit if isinstance(limit, int) else NO_GUARDS.nodelets


def _read(file: str, limit: Callable[[], int]) -> Wiring:
    if file == STDIO:
        return read_wiring(sys.stdin.buffer.read(), "standard input", limit)
    try:
        with open(file, "rb") as opened:
            return read_wiring(opened.read(), file, limit)
    except OSError as error:
        problem = Problem(file, 0, f"cannot be read: {error.strerror}")
        raise SpecificationError([problem]) from error


def _outcome(plan: LoadPlan, failed: Collection[str]) -> Json:
    def done(subjects: Iterable[str]) -> list[str]:
        return [each for each in subjects if each not in failed]

    return {
        "transformations": {
            "added": done(each.label for each in plan.added),
            "replaced": done(each.label for each in plan.replacing),
            "kept": plan.same,
        },
        "nodelets": {
            "spawned": done(each.name for each in plan.spawned),
            "replaced": done(each.wanted.name for each in plan.remade),
            "changed": done(each.wanted.name for each in plan.kept if not each.is_as_wanted),
            "kept": [each.wanted.name for each in plan.kept if each.is_as_wanted],
        },
        "differences": [
            {"nodelet": each.wanted.name, "differences": list(each.differences)}
            for each in (*plan.remade, *plan.kept)
            if each.differences
        ],
    }


def _lines(result: Json) -> Iterator[str]:
    differences = {each["nodelet"]: each["differences"] for each in result["differences"]}
    for thing in ("transformations", "nodelets"):
        for what, subjects in result[thing].items():
            words = f"would be {what}" if result["dry_run"] else what
            if what == "kept":
                words = "exists already"
            for subject in subjects:
                differs = thing == "nodelets" and what != "replaced" and differences.get(subject)
                hint = f" ({'; '.join(differs)}: see --replace)" if differs else ""
                yield f"{thing[:-1]} {subject}: {words}{hint}"
    if not any((*result["transformations"].values(), *result["nodelets"].values())):
        yield "nothing was loaded" if result["failed"] else "nothing to load"
