# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Several changes as one: when a step fails, those before it are taken back."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Callable, Mapping, Sequence

from dyknow.errors import DyKnowError, Refused
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import NodeletStatus, SpawnRequest

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class ReversibleStep:
    """Something to do, and how to take it back."""

    what: str  # it in words, for people
    subject: str  # the nodelet or label that it is about
    do: Callable[[], object]  # does it; raises DyKnowError
    undo: Callable[[], object]  # takes it back; raises DyKnowError
    #: Raises DyKnowError if another client has changed the same things since; for a step that is
    #: taken back much later.
    check: Callable[[], object] = lambda: None


class CannotUndo(DyKnowError):
    """A change cannot be undone; the text says why."""


class StepFailed(DyKnowError):
    """A step failed, and those before it were taken back."""

    def __init__(self, step: ReversibleStep, error: DyKnowError, troubles: list[str]) -> None:
        words = [f"{step.what}: {error}", *(troubles or ["everything is as it was"])]
        super().__init__("; ".join(words))
        self.error = error  # why it failed
        #: Steps that could not be taken back, in words; empty if all is as it was.
        self.troubles = tuple(troubles)


def carry_out(
    steps: Sequence[ReversibleStep],
    keep_going: bool = False,
    may_be_done: Callable[[DyKnowError], bool] = lambda error: not isinstance(error, Refused),
) -> list[tuple[ReversibleStep, DyKnowError]]:
    """Do the steps in order; raises StepFailed when one fails.

    ``may_be_done`` says whether a step that failed so may have been done, since no answer came.
    With ``keep_going`` it goes on after a step that failed, undoes nothing, and returns the steps
    that failed, and why.
    """
    done: list[ReversibleStep] = []
    failed: list[tuple[ReversibleStep, DyKnowError]] = []
    for step in steps:
        try:
            step.do()
            done.append(step)
        except DyKnowError as error:
            if not keep_going:
                maybe = [step] if may_be_done(error) else []
                raise StepFailed(step, error, take_back(done, maybe)) from error
            failed.append((step, error))
        except BaseException:
            for trouble in take_back(done, [step]):
                _log.warning("%s", trouble)
            raise
    return failed


def take_back(done: Sequence[ReversibleStep], maybe: Sequence[ReversibleStep] = ()) -> list[str]:
    """Take steps back, the last first; return in words which could not be.

    Another step may have been done, ``maybe``: if taking it back is refused, it was not.
    """
    troubles = []
    for step in [*maybe, *reversed(done)]:
        try:
            step.undo()
        except DyKnowError as error:
            if not (step in maybe and isinstance(error, Refused)):
                troubles.append(f"{step.what} could not be taken back: {error}")
    return troubles


def spawning(request: SpawnRequest, client: BaseManagerClient) -> ReversibleStep:
    """Spawn a nodelet; taken back, nothing of it is left, even if it is protected."""
    name = request.name

    def destroy() -> None:
        try:
            destroy_own(request, client)  # if no answer came, also one that is still being made
        except Refused as error:
            if client.get_graph().nodelet(name) is not None:  # not as if it had not been made
                raise DyKnowError(str(error)) from error

    def check() -> None:
        found = client.get_graph().nodelet(name)
        if found is not None:
            check_own(found, request)

    return ReversibleStep(
        f"spawning '{name}'", name, lambda: client.spawn_nodelet(request), destroy, check
    )


def destroy_own(request: SpawnRequest, client: BaseManagerClient) -> None:
    """Destroy the nodelet that was requested, even if it was to be protected."""
    if request.is_protected:
        client.set_protection(request.name, False)
    client.destroy(request.name)


def check_own(found: NodeletStatus, request: SpawnRequest) -> None:
    """Raise CannotUndo if another client has made a nodelet, or protected it since."""
    if found.transformation != request.label:
        raise CannotUndo(f"another client has made {found.name} from {found.transformation}")
    if found.is_protected and not request.is_protected:
        raise CannotUndo(f"another client has protected {found.name}")


def check_connected(client: BaseManagerClient, nodelet: str, topics: Mapping[str, str]) -> None:
    """Raise CannotUndo unless ports of a nodelet are connected so, as a change left them."""
    try:
        present = {port.name: port.topic for port in client.get_config(nodelet)}
    except DyKnowError as error:
        raise CannotUndo(str(error)) from error
    for port, topic in topics.items():
        if present.get(port) != topic:
            now = present.get(port) or "nothing"
            raise CannotUndo(f"{nodelet}:{port} has been connected to {now} by another client")
