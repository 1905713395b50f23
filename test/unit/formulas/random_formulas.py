# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Random formulas over the ports p, q and r, and traces of them for the reference interpreter."""

from __future__ import annotations

import random
from typing import Any, Dict, Iterable, List, Optional, Sequence, Tuple

from dyknow.formulas.semantics import FALSE, TRUE, UNKNOWN, Trace, truth
from dyknow.formulas.tree import (
    FUTURE,
    PAST,
    SECOND,
    Atom,
    Binary,
    Field,
    Interval,
    Node,
    Proposition,
    Quantified,
    Unary,
)

State = Dict[str, Optional[bool]]
PORTS = "pqr"


def random_formula(
    dice: random.Random,
    depth: int,
    ports: str = PORTS,
    longest: int = 7,
    past: bool = False,
    shortest: int = 0,
) -> Node:
    """A formula whose bounds are whole seconds, `shortest` to `longest` apart."""
    if depth == 0 or dice.random() < 0.15:
        return Proposition(Field(dice.choice(ports)))

    def inner() -> Node:
        return random_formula(dice, depth - 1, ports, longest, past, shortest)

    kind = dice.random()
    if kind < 0.15:
        return Unary("not", inner())
    if kind < 0.4:
        return Binary(dice.choice(["and", "or", "implies"]), inner(), inner())
    operator = dice.choice(PAST if past else (*FUTURE, *PAST))
    near = dice.choice([0, 0, 0, 1, 2, 3])
    far: Optional[int] = near + dice.randint(shortest, longest)
    if operator in PAST and dice.random() < 0.3:
        far = None
    interval = Interval(near * SECOND, None if far is None else far * SECOND)
    if operator in ("until", "since"):
        return Binary(operator, inner(), inner(), interval)
    return Unary(operator, inner(), interval)


def random_states(dice: random.Random, count: int) -> List[State]:
    unknown, likely = dice.choice([0.0, 0.0, 0.2, 0.5]), dice.choice([0.1, 0.5, 0.9])

    def value() -> Optional[bool]:
        return None if dice.random() < unknown else dice.random() < likely

    return [{port: value() for port in PORTS} for _ in range(count)]


class Listed(Trace):
    """A trace of states, one a second; traces of individuals are given with each state."""

    period = SECOND

    def __init__(
        self,
        states: Sequence[State],
        individuals: Sequence[Sequence[Tuple[Trace, int]]] = (),
    ) -> None:
        self.states = states
        self._individuals = individuals

    def __len__(self) -> int:
        return len(self.states)

    def atom(self, atom: Atom, state: int) -> int:
        assert isinstance(atom, Proposition)
        value = self.states[state][str(atom)]
        return UNKNOWN if value is None else TRUE if value else FALSE

    def individuals(self, formula: Quantified, state: int) -> Iterable[Tuple[Trace, int]]:
        return self._individuals[state]


def stepped(evaluator: Any, states: Sequence[State]) -> List[Tuple[int, int]]:
    """For each decided state, in order: its truth, and the state that decides it."""
    return [
        (value, number)
        for number, state in enumerate(states)
        for value in evaluator.step(*(state[str(each)] for each in evaluator.inputs))
    ]


def decisions(formula: Node, states: Sequence[State]) -> List[Tuple[int, int]]:
    """For each decided state, in order: its truth, and the state that decides it."""
    found: List[Tuple[int, int]] = []
    for seen in range(1, len(states) + 1):
        trace = Listed(states[:seen])
        while len(found) < seen:
            least = truth(formula, len(found), trace, FALSE)
            if least != truth(formula, len(found), trace, TRUE):
                break
            found.append((least, seen - 1))
    return found
