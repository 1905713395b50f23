# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The compiled formulas against other monitors, on the language that all of them have."""

from __future__ import annotations

import random
from typing import Any, List

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples
from unit.formulas.random_formulas import State, random_formula, stepped

from dyknow.formulas.compiler import Evaluator
from dyknow.formulas.semantics import TRUE
from dyknow.formulas.tree import SECOND
from dyknow_benchmark.formulas import written_for_others

reelay = pytest.importorskip("reelay")
sentil = pytest.importorskip("sentil")


@examples(400)
@given(st.integers(0, 2**40))
def test_reelay_and_sentil_agree(seed: int) -> None:
    dice = random.Random(seed)
    # For reelay [0, 0] has no bounds.
    formula = random_formula(dice, dice.randint(1, 4), past=True, shortest=1)
    likely = dice.choice([0.1, 0.5, 0.9])
    states: List[State] = [{port: dice.random() < likely for port in "pqr"} for _ in range(40)]

    found = [truth == TRUE for truth, _ in stepped(Evaluator(formula, SECOND), states)]
    text = written_for_others(formula, "{{{}}}", ":")
    monitor = reelay.discrete_timed_monitor(text, semantics="boolean", condense=False)
    assert found == [monitor.update(state)["value"] for state in states], text
    text = written_for_others(formula, "{} > 0.5", ",")
    assert found == of_sentil(sentil.OnlineMonitor(text), states), text


def of_sentil(monitor: Any, states: List[State]) -> List[bool]:
    verdicts = []
    for number, state in enumerate(states):
        values = {port: float(bool(value)) for port, value in state.items()}
        verdicts.append(monitor.update(float(number), values))
    assert all(verdict.resolved for verdict in verdicts)
    return [bool(verdict.satisfied) for verdict in verdicts]
