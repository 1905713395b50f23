# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes that the user makes, as values: each is a list of reversible steps.

A change is applied, undone and redone through a manager's client, whose exceptions it raises.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Callable, Mapping, NamedTuple, NoReturn, Sequence, Tuple

from dyknow.errors import DyKnowError, StreamRefused
from dyknow.manager.steps import (
    CannotUndo,
    ReversibleStep,
    carry_out,
    check_connected,
    check_own,
    destroy_own,
)
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import NodeletStatus, SpawnRequest
from dyknow.model.hosts import pins
from dyknow.model.streams import StreamRequest
from dyknow.model.transformation import NODE, Parameter, Transformation, as_specification
from dyknow.wiring.load import by_declaration, make_again, making, steps_of
from dyknow.wiring.plan import plan_load
from dyknow.wiring.wiring import Wiring, request_of
from dyknow_rqt.graph.snapshot import Snapshot

Do = Callable[[], object]
#: The most changes that can be undone.
DEPTH = 100
#: Functions that do and undo; a third one may check that no other client has changed it since.
DoAndUndo = Tuple[Do, ...]


class CannotLoad(DyKnowError):
    """A wiring cannot be loaded; nothing was changed."""


@dataclass(frozen=True)
class Present:
    """The state in which a client makes a change; steps add words about its outcome."""

    client: BaseManagerClient
    snapshot: Snapshot = field(default_factory=Snapshot)
    library: Mapping[str, Transformation] = field(default_factory=dict)
    outcome: list[str] = field(default_factory=list)


class DoneChange(NamedTuple):
    """A change that was made, with its steps."""

    change: Change
    steps: Sequence[ReversibleStep]
    text: str

    def undo(self) -> None:
        """Undo the steps, the last first, up to the first that is refused.

        Raises:
            CannotUndo: it has no inverse, or another client has changed the same things since.
        """
        for step in self.steps:
            step.check()
        for step in reversed(self.steps):
            step.undo()


@dataclass(frozen=True)
class Change:
    """A change that the user makes, described in a few words.

    Its steps may ask the client. The check comes before a redo, and raises CannotUndo if another
    client has changed the same things since.
    """

    text: str
    steps: Callable[[Present], Sequence[ReversibleStep]] = field(compare=False)
    check: Callable[[BaseManagerClient], None] = field(default=lambda client: None, compare=False)

    def apply(self, present: Present) -> DoneChange:
        """Make the change as a whole or not at all."""
        steps = self.steps(present)
        if len(steps) == 1:
            steps[0].do()
        else:
            carry_out(steps)
        return DoneChange(self, steps, ": ".join([self.text, *present.outcome]))


class UndoHistory:
    """The changes that can be undone, and those that can be redone."""

    def __init__(self) -> None:
        self._done: list[DoneChange] = []
        self._undone: list[Change] = []

    def note(self, done: DoneChange) -> None:
        """Note a change; nothing can be redone after it."""
        self._done.append(done)
        del self._done[:-DEPTH]
        self._undone.clear()

    def note_undone(self) -> None:
        """Note that the last change was undone."""
        self._undone.append(self._done.pop().change)

    def note_redone(self, done: DoneChange) -> None:
        """Note that the last undone change was redone."""
        self._undone.pop()
        self._done.append(done)

    def drop(self) -> None:
        """Forget the last change, which cannot be undone, so that those before it can be."""
        self._done.pop()

    @property
    def last(self) -> DoneChange | None:
        """The change that undo undoes, or None."""
        return self._done[-1] if self._done else None

    @property
    def next(self) -> Change | None:
        """The change that redo makes, or None."""
        return self._undone[-1] if self._undone else None

    @property
    def texts(self) -> tuple[str, str]:
        """The changes that undo and redo would make, in words; empty for none."""
        return (
            self.last.change.text if self.last is not None else "",
            self.next.text if self.next is not None else "",
        )


def _one_step(text: str, make: Callable[[Present], DoAndUndo]) -> Change:
    """Return a change of one step; `make` returns the functions that do, undo and check it."""
    return Change(text, lambda present: [ReversibleStep(text, "", *make(present))])


def _no_way(reason: str) -> Callable[[], NoReturn]:
    def undo() -> NoReturn:
        raise CannotUndo(reason)

    return undo


def _nodelet(client: BaseManagerClient, name: str) -> NodeletStatus:
    found = client.get_graph().nodelet(name)
    if found is None:
        raise CannotUndo(f"{name} is gone")
    return found


def spawn(request: SpawnRequest) -> Change:
    """Make a nodelet."""
    name = request.name

    def make(present: Present) -> DoAndUndo:
        client = present.client

        def check() -> None:
            if name.startswith("/"):  # else it began in the manager's namespace
                check_own(_nodelet(client, name), request)

        return partial(client.spawn_nodelet, request), partial(destroy_own, request, client), check

    return _one_step(f"create {name}", make)


def destroy(name: str) -> Change:
    """Destroy a nodelet; undone, it is made again and connected as it was."""

    def make(present: Present) -> DoAndUndo:
        undo: Do = _no_way(f"the library does not have the transformation of {name}")
        nodelet = present.snapshot.nodelet(name)
        if nodelet is not None and nodelet.transformation in present.library:
            former = request_of(nodelet, pins(present.client.list_hosts()))
            made = present.library[nodelet.transformation]
            undo = partial(make_again, former, made, present.client)
        return partial(present.client.destroy, name), undo

    return _one_step(f"destroy {name}", make)


def isolate(names: Sequence[str], on: bool) -> Change:
    """Make nodelets again, with their wiring, in processes of their own, or in a shared one."""

    def make(name: str, present: Present, pinned: Mapping[str, str]) -> list[ReversibleStep]:
        nodelet = present.snapshot.nodelet(name)
        if nodelet is None or nodelet.transformation not in present.library:
            raise CannotUndo(f"the library does not have the transformation of {name}")
        client, before = present.client, request_of(nodelet, pinned)
        made = present.library[nodelet.transformation]
        if not on and (made.isolated or made.type == NODE):
            raise CannotUndo(f"the transformation of {name} gives it a process of its own")
        after = replace(before, isolated=on, manager=before.manager if before.host else "")
        # A nodelet in C++ may not have its further ports yet.
        declared, _ = by_declaration(before, made)
        end = ReversibleStep(
            f"end {name}",
            name,
            partial(client.destroy, name),
            partial(make_again, before, made, client),
            partial(check_connected, client, name, declared),
        )
        return [end, *making(after, made, client)]

    def plan(present: Present) -> list[ReversibleStep]:
        pinned = pins(present.client.list_hosts())
        return [step for name in names for step in make(name, present, pinned)]

    what = names[0] if len(names) == 1 else f"{len(names)} nodelets"
    return Change(f"isolate {what}" if on else f"let {what} share a process", plan)


def restart(names: Sequence[str]) -> Change:
    """Restart nodelets; messages that come meanwhile are lost to them."""

    def make(name: str, present: Present) -> ReversibleStep:
        def do() -> None:
            present.outcome.extend(filter(None, present.client.restart(name).remarks.split("\n")))

        return ReversibleStep(f"restart {name}", name, do, _no_way(f"{name} was restarted"))

    what = names[0] if len(names) == 1 else f"{len(names)} nodelets"
    return Change(f"restart {what}", lambda present: [make(name, present) for name in names])


def set_parameters(
    name: str, wanted: Sequence[Parameter], before: Mapping[str, Parameter]
) -> Change:
    """Set private parameters of a nodelet; those that had no value ``before`` keep the new one.

    They are set first, so that all others are set back when it is undone.
    """

    def make(parameter: Parameter, present: Present) -> ReversibleStep:
        def put(value: Parameter) -> None:
            done = present.client.set_parameter(name, value)
            present.outcome.extend(filter(None, done.remarks.split("\n")))
            if not done.is_read:
                present.outcome.append(f"{value.name} is read at the next restart")

        undo: Do = _no_way(f"{name} had no {parameter.name} before")
        if parameter.name in before:
            undo = partial(put, before[parameter.name])

        def check() -> None:
            given = {each.name: each.text for each in _nodelet(present.client, name).parameters}
            now = given.get(parameter.name, "")
            if now != parameter.text:
                raise CannotUndo(f"another client has set {parameter.name} of {name} to '{now}'")

        text = f"set {parameter.name} of {name}"
        return ReversibleStep(text, name, partial(put, parameter), undo, check)

    what = ", ".join(f"{each.name}={each.text}" for each in wanted)
    last = {each.name: each for each in wanted}.values()
    in_turn = sorted(last, key=lambda each: each.name in before)
    return Change(f"set {what} of {name}", lambda present: [make(p, present) for p in in_turn])


def protect(name: str, on: bool) -> Change:
    """Protect a nodelet from being destroyed, or release it."""

    def make(present: Present) -> DoAndUndo:
        client = present.client

        def check() -> None:
            if _nodelet(client, name).is_protected is not on:
                what = "released" if on else "protected"
                raise CannotUndo(f"another client has {what} {name}")

        put = partial(client.set_protection, name)
        return partial(put, on), partial(put, not on), check

    return _one_step(f"{'protect' if on else 'release'} {name}", make)


def add_transformations(specification: str, origin: str = "a specification") -> Change:
    """Add the transformations of an XML text that comes from `origin`."""

    def make(present: Present) -> DoAndUndo:
        client, library = present.client, present.library
        labels: list[str] = []

        def add() -> None:
            added = client.add_transformation(specification)
            labels.extend(added.labels)
            present.outcome.extend(filter(None, added.warnings.split("\n")))

        def undo() -> None:
            replaced = [library[label] for label in labels if label in library]
            if replaced:
                client.add_transformation(as_specification(replaced))
            for label in labels:
                if label not in library:
                    client.remove_transformation(label)

        return add, undo

    return _one_step(f"import {origin}", make)


def remove_transformations(labels: Sequence[str]) -> Change:
    """Remove transformations from the library."""

    def plan(present: Present) -> list[ReversibleStep]:
        client, library = present.client, present.library
        return [
            ReversibleStep(
                f"delete {label}",
                label,
                partial(client.remove_transformation, label),
                partial(client.add_transformation, library[label].to_xml()),
            )
            for label in labels
        ]

    what = labels[0] if len(labels) == 1 else f"{len(labels)} transformations"
    return Change(f"delete {what}", plan)


def load_wiring(wiring: Wiring, origin: str = "a wiring") -> Change:
    """Load a wiring that comes from `origin`; nodelets that it does not name are left alone.

    Applied, it raises CannotLoad with all problems.
    """

    def plan(present: Present) -> list[ReversibleStep]:
        client = present.client
        model, managers = client.get_model(), client.places()
        found = plan_load(wiring, model, managers, replace=True, any_manager=True)
        if found.problems:
            raise CannotLoad("\n".join(map(str, found.problems)))
        return steps_of(found, client)

    return Change(f"load {origin}", plan)


def acquire(request: StreamRequest) -> Change:
    """Acquire a stream; one that is not possible yet is made when it becomes possible."""

    def make(present: Present) -> DoAndUndo:
        claims: list[str] = []

        def ask() -> None:
            try:
                got = present.client.acquire_stream(request)
            except StreamRefused as error:
                if not error.claim_id:
                    raise
                claims.append(error.claim_id)
                present.outcome.append(f"waits, {error}")
            else:
                claims.append(got.claim_id)
                present.outcome.extend([f"on {got.topic}", *got.warnings])

        return ask, lambda: present.client.release_stream(claims[0])

    return _one_step(f"acquire {request.tag}", make)


def release(claim_id: str, tag: str) -> Change:
    """End a claim."""
    reason = "a stream that is acquired again is another one, on a topic of its own"
    return _one_step(
        f"release {tag}",
        lambda present: (lambda: present.client.release_stream(claim_id), _no_way(reason)),
    )


def replan(claim_id: str, tag: str) -> Change:
    """Switch a stream to the plan that is the cheapest now."""
    reason = "the way before was not the cheapest"
    return _one_step(
        f"replan {tag}",
        lambda present: (lambda: present.client.replan_stream(claim_id), _no_way(reason)),
    )
