# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A manager whose nodelets, nodelet managers and own life may end at any moment."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, Callable, List, Sequence

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from unit.manager.field import Field, counted_ids

from dyknow.errors import DyKnowError

NUMBERS = st.integers(0, 30)


class FaultyLife(RuleBasedStateMachine):
    """The steps that all state machines share: clients end claims, and processes die and hang.

    A subclass makes the field in ``make_field``, adds consequences of faults in ``after_kill`` and
    ``after_hang``, and adds its own steps.
    """

    def __init__(self) -> None:
        super().__init__()
        self.ids = counted_ids()
        self.ids.start()
        self.folder = tempfile.TemporaryDirectory()
        self.field = self.make_field(str(Path(self.folder.name) / "state.db"))

    def make_field(self, path: str) -> Field:
        """Make the field, with its state in a file of that path."""
        raise NotImplementedError

    def after_kill(self) -> None:
        """Called after a nodelet manager was killed."""

    def after_hang(self) -> None:
        """Called after a nodelet manager was stopped, or went on."""

    def end_faults(self) -> None:
        """End all faults of nodelets and nodelet managers, at the end of a run."""
        self.ids.stop()
        host = self.field.host
        host.fail = lambda operation, argument: None
        host.silent.clear()
        host.slow.clear()
        for manager in filter(host.is_hung, list(host.processes)):
            host.wake(manager)
            self.after_hang()

    def holds(self) -> None:
        """Called after each step: check the invariants."""
        raise NotImplementedError

    @invariant()
    def holds_for_claims(self) -> None:
        self.field.check_claims()

    def relive(self, *steps: Sequence[Any]) -> None:
        """Take steps, each a rule and the values that it is called with, and end."""
        for name, *values in steps:
            getattr(self, name)(*values)
            self.holds()
            self.holds_for_claims()
        self.teardown()

    def close(self) -> None:
        self.field.store.close()
        self.folder.cleanup()

    # Clients

    @precondition(lambda self: self.field.living())
    @rule(number=NUMBERS)
    def release(self, number: int) -> None:
        self.field.reconciler.release(self.any_of(self.field.living(), number).claim_id)

    @precondition(lambda self: self.field.living())
    @rule(number=NUMBERS)
    def replan(self, number: int) -> None:
        claim_id = self.any_of(self.field.living(), number).claim_id
        self.asked(lambda: self.field.reconciler.replan(claim_id))

    # Faults

    @rule(number=NUMBERS)
    def kill(self, number: int) -> None:
        processes = sorted(self.field.host.processes)
        if processes:
            self.field.host.kill(self.any_of(processes, number))
            self.after_kill()

    @rule(number=NUMBERS, hang=st.booleans())
    def hang(self, number: int, hang: bool) -> None:
        host = self.field.host
        processes = [name for name in sorted(host.processes) if host.processes[name].state.alive]
        if processes:
            (host.hang if hang else host.wake)(self.any_of(processes, number))
            self.after_hang()

    @rule()
    def kill_dyknow(self) -> None:
        self.field.kill_manager()

    # How it is done

    @staticmethod
    def asked(action: Callable[[], Any]) -> None:
        """Ask for something that may be refused."""
        try:
            action()
        except DyKnowError:
            return

    @staticmethod
    def any_of(names: List[Any], number: int) -> Any:
        return names[number % len(names)]

    def any_nodelet(self, number: int) -> str:
        return str(self.any_of(self.field.host.running, number))
