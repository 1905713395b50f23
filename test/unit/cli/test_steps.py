# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Steps that are done together or not at all."""

from __future__ import annotations

import pytest

from dyknow.errors import DyKnowError, Refused
from dyknow.manager.steps import ReversibleStep, StepFailed, carry_out


class Steps:
    """Makes steps that write down what they do, and fail as they are told."""

    def __init__(self) -> None:
        self.log: list[str] = []

    def step(
        self, name: str, fails: DyKnowError | None = None, stays: DyKnowError | None = None
    ) -> ReversibleStep:
        def act(word: str, error: DyKnowError | None) -> None:
            self.log.append(word)
            if error is not None:
                raise error

        return ReversibleStep(
            f"doing {name}",
            name,
            lambda: act(f"do {name}", fails),
            lambda: act(f"undo {name}", stays),
        )


def test_a_refused_step_was_not_done() -> None:
    steps = Steps()
    with pytest.raises(StepFailed, match="^doing b: no; everything is as it was$") as failed:
        carry_out([steps.step("a"), steps.step("b", Refused("no")), steps.step("c")])
    assert steps.log == ["do a", "do b", "undo a"]
    assert failed.value.troubles == ()


def test_a_step_without_an_answer_may_have_been_done() -> None:
    steps = Steps()
    silent = DyKnowError("no answer")
    with pytest.raises(StepFailed, match="everything is as it was"):
        carry_out([steps.step("a"), steps.step("b", silent, Refused("there is none"))])
    assert steps.log == ["do a", "do b", "undo b", "undo a"]


def test_what_could_not_be_taken_back_is_said() -> None:
    steps, silent = Steps(), DyKnowError("no answer")
    with pytest.raises(StepFailed) as failed:
        carry_out([steps.step("a", stays=Refused("too late")), steps.step("b", silent, silent)])
    assert str(failed.value) == (
        "doing b: no answer; doing b could not be taken back: no answer; "
        "doing a could not be taken back: too late"
    )


def test_others_go_on_if_wanted() -> None:
    steps, error = Steps(), Refused("no")
    failing = steps.step("a", error)
    assert carry_out([failing, steps.step("b")], keep_going=True) == [(failing, error)]
    assert steps.log == ["do a", "do b"]


def test_an_interruption_takes_everything_back() -> None:
    steps = Steps()

    def interrupt() -> None:
        raise KeyboardInterrupt

    interrupted = ReversibleStep("b", "b", interrupt, lambda: steps.log.append("undo b"))
    with pytest.raises(KeyboardInterrupt):
        carry_out([steps.step("a"), interrupted])
    assert steps.log == ["do a", "undo b", "undo a"]
