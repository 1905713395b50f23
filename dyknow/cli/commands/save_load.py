# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`save` and `load`: a whole wiring in one file."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Collection, Iterable, Iterator, Sequence

from dyknow.cli.arguments import argument, flag
from dyknow.cli.output import STDIO, Json, count, read_file, write_file
from dyknow.cli.shell import FAILED, Shell, command
from dyknow.errors import ManagerUnreachable, SpecificationError
from dyknow.guards import NO_GUARDS
from dyknow.manager.steps import StepFailed, carry_out
from dyknow.model.hosts import pins
from dyknow.wiring.load import steps_of, unsettled
from dyknow.wiring.plan import LoadPlan, plan_load
from dyknow.wiring.wiring import NODELET, Wiring, read_wiring, too_many_nodelets, wiring_of

if TYPE_CHECKING:
    from dyknow.ros.shell.shell_client import ShellClient

#: Seconds between two checks of a wait, and those that it lasts at most.
_PERIOD = 0.25
_WAIT = 60.0


@command(
    "Save what runs in one XML file: the nodelets, their connections, and the transformations "
    "that they are made from.",
    "dyknow save robot.xml\ndyknow save - | less",
    argument("file", "FILE", f"where to write it; {STDIO} for standard output"),
)
def _save(arguments: argparse.Namespace, shell: Shell) -> None:
    wiring, left_out = wiring_of(shell.client.get_model(), pins(shell.client.list_hosts()))
    for nodelet in left_out:
        shell.warn(f"'{nodelet.name}' is not saved: it was not spawned from a transformation")
    text = wiring.to_xml()
    saved = {
        "file": arguments.file,
        "nodelets": [nodelet.name for nodelet in wiring.nodelets],
        "transformations": [each.label for each in wiring.transformations],
        "left_out": [nodelet.name for nodelet in left_out],
    }
    if arguments.file == STDIO:
        shell.show_file({**saved, "wiring": text}, text)
        return
    write_file(arguments.file, text.encode("utf-8"))
    shell.show(
        saved,
        [
            f"saved {count(len(wiring.nodelets), 'nodelet')} and "
            f"{count(len(wiring.transformations), 'transformation')} to {arguments.file}"
        ],
    )


@command(
    "Load a saved wiring. The whole file is checked before anything is changed. Running "
    "nodelets that it names are kept, and connected and protected as it says; with "
    "--replace those that were made differently are made again. Other nodelets are left "
    "alone. When a step fails, the steps before it are undone.",
    "dyknow load robot.xml\ndyknow load robot.xml --dry-run\n"
    "dyknow load robot.xml --keep-going --any-manager\n"
    "dyknow load robot.xml --wait --within 30",
    argument("file", "FILE", f"what 'save' wrote; {STDIO} for standard input"),
    flag("--dry-run", "check, and show what would be changed"),
    flag(
        "--wait",
        "wait until the manager answers, all of it is loaded and runs, and the claims that use it "
        "are active; with --dry-run, change nothing, but wait for that",
    ),
    argument("--within", "SECONDS", "the longest wait (default: 60)"),
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
        "where a nodelet manager cannot be used, let the DyKnow manager choose another",
    ),
)
def _load(arguments: argparse.Namespace, shell: Shell) -> int | None:
    if arguments.within and not arguments.wait:
        arguments.refuse("--within limits the wait: expected --wait beside it")
    client, file = shell.client, arguments.file
    data = read_file(file)
    name = "standard input" if file == STDIO else file
    waiting = _Waiting(shell, (arguments.within or _WAIT) if arguments.wait else 0.0)
    wiring: Wiring | None = None
    changing: LoadPlan | None = None
    while True:
        try:
            wiring = wiring or read_wiring(data, name, lambda: _limit(client))
            plan = _plan(arguments, wiring, client)
            problems = [str(problem) for problem in plan.problems]
            is_to_load = not (problems or arguments.dry_run)
            steps = steps_of(plan, client) if is_to_load else []
            failed = carry_out(steps, arguments.keep_going)
            if steps or changing is None or changing.problems or arguments.dry_run:
                changing = plan
            left = problems or list(_left(arguments, wiring, plan, client))
        except SpecificationError as error:
            for each in error.problems:
                shell.error(each)
            return FAILED
        except (ManagerUnreachable, StepFailed) as error:
            if not waiting.goes_on([str(error)]):
                raise
            continue
        if failed or not left or not waiting.goes_on(left):
            break
    for cause in (*left, *(f"{step.what}: {cause}" for step, cause in failed)):
        shell.error(cause)
    if problems:
        return FAILED
    result = {
        **_outcome(changing, [step.subject for step, _ in failed]),
        "file": file,
        "dry_run": arguments.dry_run,
        "failed": [
            {"subject": step.subject, "step": step.what, "message": str(cause)}
            for step, cause in failed
        ],
    }
    shell.show(result, _lines(result))
    return FAILED if failed or left else None


class _Waiting:
    """Waits for missing things, until a limit (s); each is named once."""

    def __init__(self, shell: Shell, limit: float) -> None:
        self._shell = shell
        self._end = time.monotonic() + limit
        self._named: set[str] = set()

    def goes_on(self, causes: Sequence[str]) -> bool:
        """Wait a little, unless it has lasted long enough; returns whether it has not."""
        if time.monotonic() >= self._end:
            return False
        for cause in causes:
            if cause not in self._named:
                self._shell.warn(f"{cause}; waiting for it")
        self._named.update(causes)
        time.sleep(_PERIOD)
        return True


def _plan(arguments: argparse.Namespace, wiring: Wiring, client: ShellClient) -> LoadPlan:
    model = client.get_model()
    if arguments.wait and arguments.dry_run:  # as at the manager's start, if its files have others
        own = {each.label: each for each in model.transformations}
        mixed = tuple(own.get(each.label, each) for each in wiring.transformations)
        wiring = replace(wiring, transformations=mixed)
    plan = plan_load(
        wiring,
        model,
        client.places(),
        client.is_own_manager,
        arguments.replace,
        arguments.any_manager,
        client.stored_parameters,
    )
    most = _limit(client)
    if len(wiring.nodelets) > most:
        first = wiring.nodelets[most].name
        plan.problems.append(wiring.problem(too_many_nodelets(most), (NODELET, first)))
    return plan


def _left(
    arguments: argparse.Namespace, wiring: Wiring, plan: LoadPlan, client: ShellClient
) -> Iterator[str]:
    """List the things that are still missing."""
    if not arguments.wait:
        return
    if arguments.dry_run and not plan.is_done:
        yield f"{arguments.file} is not loaded completely"
    yield from unsettled(wiring, client.get_graph(), client.list_streams())


def _limit(client: ShellClient) -> int:
    """How many nodelets may run."""
    name = "limits/nodelets"
    limit = client.stored_parameters(client.manager, [name]).get(name)
    return limit if isinstance(limit, int) else NO_GUARDS.nodelets


def _outcome(plan: LoadPlan, failed: Collection[str]) -> Json:
    def done(subjects: Iterable[str]) -> list[str]:
        return [each for each in subjects if each not in failed]

    return {
        "transformations": {
            "added": done(each.label for each in plan.added),
            "replaced": done(new.label for _, new in plan.replaced),
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
