# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The compiled formulas against the interpreter that is their meaning."""

from __future__ import annotations

import itertools
import random
from typing import Any, Dict, List, Optional, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples
from unit.formulas.random_formulas import (
    Listed,
    State,
    decisions,
    random_formula,
    random_states,
    stepped,
)

import dyknow.formulas
from dyknow.formulas import exact
from dyknow.formulas.compiler import Evaluator
from dyknow.formulas.exact import ExactEvaluator
from dyknow.formulas.look_ahead import horizon, looks_ahead
from dyknow.formulas.semantics import FALSE, TRUE, UNKNOWN, truth
from dyknow.formulas.tree import SECOND, Node, Quantified, outermost, ports

seeds = st.integers(0, 2**40)
VERDICTS = {FALSE: 0, TRUE: 1, UNKNOWN: 2}


def completed(evaluator: Any, states: List[State]) -> List[int]:
    """The truth of each state, the open ones when nothing more will be known."""
    truths = [value for value, _ in stepped(evaluator, states)]
    for _ in range(evaluator.horizon):
        truths += evaluator.step(*[None] * len(evaluator.inputs))
    return truths[: len(states)]


@examples(1000)
@given(seeds)
def test_each_state_is_decided_as_soon_as_it_can_be(seed: int) -> None:
    dice = random.Random(seed)
    formula = random_formula(dice, dice.randint(1, 3), longest=5)
    states = random_states(dice, dice.randint(1, 20))
    assert stepped(Evaluator(formula, SECOND), states) == decisions(formula, states)


@examples(1000)
@given(seeds)
def test_the_end_leaves_no_state_open(seed: int) -> None:
    dice = random.Random(seed)
    formula = random_formula(dice, dice.randint(1, 3), longest=5)
    states = random_states(dice, dice.randint(1, 20))
    trace = Listed(states)
    expected = [truth(formula, number, trace) for number in range(len(states))]
    assert completed(Evaluator(formula, SECOND), states) == expected


@examples(500)
@given(seeds)
def test_a_formula_reads_as_it_is_written(seed: int) -> None:
    dice = random.Random(seed)
    formula = random_formula(dice, 4)
    assert dyknow.formulas.parse(str(formula)).tree == formula


# From messages


class Message:
    """Has a value, and the time at which it was made, if that is known."""

    stamp: float  # of a header

    def __init__(self, value: float, stamp: Optional[float]) -> None:
        self.value = value
        if stamp is not None:
            self.header = Message(0.0, None)
            self.header.stamp = stamp


Event = Tuple[str, float, float, float]
"""A message: its port, stamp, time of receipt, and value."""


def random_events(dice: random.Random, names: Tuple[str, ...]) -> List[Event]:
    """Messages in the order of receipt, of which some come late or in another order."""
    events = []
    for port in names:
        step = dice.choice([0.3, 0.7, 1.0, 2.5])
        stamp = dice.uniform(0.0, 2.0) if dice.random() < 0.5 else 1.0
        while stamp < 14.0:
            lag = dice.choice([0.0, 0.1, 0.4, dice.expovariate(1.0)])
            value = dice.choice([1.0, 1.0, -1.0, -1.0, float("nan")])
            if dice.random() < 0.8:
                events.append((port, round(stamp, 6), round(stamp + lag, 6), value))
            stamp += step
    return sorted(events, key=lambda event: event[2])


def expected_verdicts(
    formula: Node, events: List[Event], hold: Optional[float], delay: float
) -> Tuple[List[Tuple[int, int]], int]:
    """Times and values of all verdicts by the definition of states, and how many came late."""
    names = ports(formula)
    seen: List[Event] = []
    first = open_ = None
    late = 0
    now = -1.0
    for port, stamp, received, value in events:
        now = max(now, received)
        state = int(-(-stamp // 1))
        if open_ is None:
            begin = round(now - delay, 6)
            first = open_ = max(state, int(-(-begin // 1)))
        while round(open_ + delay, 6) < now:
            open_ += 1
        if state < open_ and open_ > first:  # the first state sees what came for an earlier one
            late += 1
            continue
        seen.append((port, stamp, received, value))
        while open_ <= now and all(
            any(each[0] == name and each[1] > open_ for each in seen) for name in names
        ):
            open_ += 1
    if first is None:
        return [], late
    last = max([first - 1, *(int(each[1] // 1) for each in seen)])
    states: List[State] = []
    for state in range(first, max(last + 1, open_ or 0)):
        values: State = {}
        for name in names:
            past = [each for each in seen if each[0] == name and each[1] <= state]
            values[name] = None
            if past:
                _, stamp, _, value = max(past, key=lambda each: each[1])
                is_held = hold is None or round(state - stamp, 6) <= hold
                if is_held and value == value:
                    values[name] = value > 0
        states.append(values)
    trace = Listed(states)
    truths = [truth(formula, number, trace) for number in range(len(states))]
    return [(first + number, VERDICTS[each]) for number, each in enumerate(truths)], late


@examples(600)
@given(seeds)
def test_verdicts_from_partial_late_and_reordered_messages(seed: int) -> None:
    dice = random.Random(seed)
    formula = random_formula(dice, dice.randint(1, 3))
    events = random_events(dice, ports(formula))
    hold, delay = dice.choice([None, 0.5, 2.0]), dice.choice([0.0, 0.5, 2.0])
    monitor = dyknow.formulas.parse(numeric(formula)).monitor(1.0, hold, delay)
    verdicts = [
        verdict
        for port, stamp, received, value in events
        for verdict in monitor.feed(port, Message(value, stamp), received)
    ]
    late = monitor.late
    verdicts += monitor.finish()
    found = [(verdict.stamp // SECOND, int(verdict.value)) for verdict in verdicts]
    assert (found, late) == expected_verdicts(formula, events, hold, delay)


def numeric(formula: Node) -> str:
    """The formula on values of messages: each port `p` is `p.value > 0`."""
    words = str(formula).replace("(", " ( ").replace(")", " ) ").split()
    return " ".join(f"({word}.value > 0)" if word in "pqr" else word for word in words)


@examples(300)
@given(seeds)
def test_individuals_that_come_and_go(seed: int) -> None:
    dice = random.Random(seed)
    operand = random_formula(dice, dice.randint(0, 2), "p", 3)
    quantified = Quantified(dice.choice(["every", "some"]), "?x", "", operand)
    whole = random_formula(dice, dice.randint(0, 2), dice.choice(["q", "qr"]), 3)
    text = str(whole).replace("q", f"({quantified})")
    names = ["a", "b", "c"]
    count = dice.randint(2, 12)
    present = [[name for name in names if dice.random() < 0.6] for _ in range(count)]
    values = [{name: dice.choice([True, False, None]) for name in names} for _ in range(count)]
    shared: List[State] = [{"r": dice.choice([True, False, None])} for _ in range(count)]

    formula = dyknow.formulas.parse(text)
    monitor = formula.monitor(1.0, hold=0.0, delay=0.0)
    verdicts = []
    for state in range(count):
        verdicts += monitor.individuals("?x", present[state], float(state))
        for name in present[state] if "p" in formula.ports else ():
            if values[state][name] is not None:
                verdicts += monitor.feed("p", values[state][name], float(state), name)
        if "r" in formula.ports and shared[state]["r"] is not None:
            verdicts += monitor.feed("r", shared[state]["r"], float(state))
    verdicts += monitor.advance(count - 0.5)
    verdicts += monitor.finish()
    assert [int(each.value) for each in verdicts] == [
        VERDICTS[each] for each in of_individuals(formula.tree, present, values, shared)
    ]


def of_individuals(
    formula: Node,
    present: List[List[str]],
    values: List[Dict[str, Any]],
    shared: List[State],
) -> List[int]:
    """Truths of states; an individual has states from its arrival on, until it goes."""
    lives: Dict[Tuple[str, int], Listed] = {}
    of_states: List[List[Tuple[Any, int]]] = []
    for state in range(len(shared)):
        of_states.append([])
        for name in present[state]:
            begin = state
            while begin and name in present[begin - 1]:
                begin -= 1
            life = lives.setdefault((name, begin), Listed([]))
            life.states.append({"p": values[state][name]})  # type: ignore[attr-defined]
            of_states[-1].append((life, state - begin))
    trace = Listed(shared, of_states)
    return [truth(formula, state, trace) for state in range(len(shared))]


# Exactly


def all_completions(formula: Node, states: List[State], limit: int = 8) -> Optional[List[int]]:
    """The value that all completions agree on in each state; None if there are too many."""
    later = horizon(formula, SECOND)
    names = ports(formula)
    nothing: State = dict.fromkeys(names)
    whole = [*states, *(dict(nothing) for _ in range(later))]
    unknown = [(n, name) for n, state in enumerate(whole) for name in names if state[name] is None]
    if len(unknown) > limit:
        return None
    outcomes: List[set[int]] = [set() for _ in states]
    for values in itertools.product((False, True), repeat=len(unknown)):
        filled = [dict(state) for state in whole]
        for (number, name), value in zip(unknown, values):
            filled[number][name] = value
        trace = Listed(filled)
        for number, outcome in enumerate(outcomes):
            outcome.add(truth(formula, number, trace))
    return [outcome.pop() if len(outcome) == 1 else UNKNOWN for outcome in outcomes]


def few_states(dice: random.Random) -> Tuple[Node, List[State], Optional[List[int]]]:
    """A small formula, some states, and the values that all completions of these agree on."""
    formula = random_formula(dice, dice.randint(1, 3), "pq", 1, past=dice.random() < 0.7)
    states = random_states(dice, dice.randint(1, 6))
    return formula, states, all_completions(formula, states)


@examples(250)
@given(seeds)
def test_exact_is_what_all_completions_agree_on(seed: int) -> None:
    formula, states, expected = few_states(random.Random(seed))
    if expected is not None:
        assert completed(ExactEvaluator(formula, SECOND, None, 1000), states) == expected


@examples(250)
@given(seeds)
def test_exact_without_room_is_between_kleene_and_the_truth(seed: int) -> None:
    dice = random.Random(seed)
    formula, states, expected = few_states(dice)
    if expected is not None:
        kleene = completed(Evaluator(formula, SECOND), states)
        found = completed(ExactEvaluator(formula, SECOND, None, dice.randint(0, 3)), states)
        for least, value, most in zip(kleene, found, expected):
            assert value in (UNKNOWN, most)
            assert least in (UNKNOWN, value)


def test_exact_takes_few_steps_for_values_that_stay_unknown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    make = exact._Diagrams._make
    made = []

    def counted(*arguments: Any) -> int:
        made.append(arguments)
        return make(*arguments)

    monkeypatch.setattr(exact._Diagrams, "_make", counted)
    formula = dyknow.formulas.parse("p since[0 s, 100 s] q").tree
    nothing: State = dict.fromkeys("pq")
    assert set(completed(ExactEvaluator(formula, SECOND, None, 1000), [nothing] * 15)) == {UNKNOWN}
    assert len(made) < 2000


def test_exact_survives_values_that_stay_unknown() -> None:
    formula = dyknow.formulas.parse("once p").tree
    unknown: State = {"p": None}
    states = [unknown] * 1100 + [{"p": True}]
    truths = completed(ExactEvaluator(formula, SECOND, None, 10**6), states)
    assert truths == [UNKNOWN] * 1100 + [TRUE]


def test_a_quantifier_may_look_ahead() -> None:
    formula = dyknow.formulas.parse("some ?x (eventually[1 s, 2 s] p)").tree
    assert looks_ahead(formula)
    assert [type(each) for each in outermost(formula)] == [Quantified]
