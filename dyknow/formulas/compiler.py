# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Compiles a formula to one Python function that is called once for each state.

The function is generated from the tree: names of fields are its only words, numbers and texts are
its variables, so that formulas of one shape share their code. An operator that looks back needs
the number of the last state in which its operand was TRUE, and in which it was not FALSE; only a
lower bound needs a queue. Formulas below an operator that looks ahead go to ``LookAhead``.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from functools import lru_cache
from typing import Any, Callable, List, Optional, Sequence, Tuple, Union

from dyknow.formulas import tree
from dyknow.formulas.look_ahead import LookAhead, horizon, looks_ahead
from dyknow.formulas.precision import plain
from dyknow.formulas.semantics import FALSE, TRUE, UNKNOWN, steps

Input = Union[tree.Field, tree.Call, tree.Quantified]
"""An argument of the function: a port's message, ``age`` and its like, a quantifier's truth."""

Note = Callable[[int, int], None]
"""Called when the truth of an atom has changed, with the atom's number and its truth."""

#: Errors that make an atom UNKNOWN: a missing index, a division by zero, the root of -1 …
_ERRORS = (ArithmeticError, AttributeError, IndexError, TypeError, ValueError)
_NEGATED = (TRUE, UNKNOWN, None, FALSE)
_VERDICT = {0: FALSE, 1: TRUE, 2: UNKNOWN}


class Evaluator:
    """A formula as a function of the inputs of each state.

    Attributes:
        inputs: the arguments of ``step``, in their order.
        atoms: the atoms, numbered as for ``Note``.
        horizon: how many states later a truth is decided at the latest.
        step: called once for each state, in their order. An input is None where it is unknown.
            Returns the truths of the states that are decided now, in the order of states.
    """

    __slots__ = ("atoms", "horizon", "inputs", "step")

    def __init__(self, formula: tree.Node, period: int, note: Note | None = None) -> None:
        """Compile a formula for states that are ``period`` nanoseconds apart."""
        formula, _ = endless(formula)
        writer = _Writer(period, note is not None)
        result = writer.formula(formula)
        self.inputs: Tuple[Input, ...] = tuple(writer.inputs)
        self.atoms: Tuple[tree.Atom, ...] = tuple(writer.atoms)
        self.horizon = horizon(formula, period)
        decided = f"ahead({', '.join(writer.leaves)})" if writer.leaves else f"decided[{result}]"
        make = _compile(writer.source(decided))
        ahead = writer.look_ahead.step if writer.look_ahead is not None else None
        self.step: Callable[..., Sequence[int]] = make(note, ahead, *writer.constants)


class AtomReader:
    """The truths of the atoms and quantifiers of a formula as a function of a state's inputs.

    ``inputs`` and ``atoms`` are as in ``Evaluator``; ``step`` returns the truths of ``parts``.
    """

    def __init__(self, formula: tree.Node, period: int, note: Note | None = None) -> None:
        """Compile the atoms of a formula for states that are ``period`` nanoseconds apart."""
        writer = _Writer(period, note is not None)
        self.parts = tuple(dict.fromkeys(tree.outermost(formula)))
        names = ", ".join(map(writer.formula, self.parts))
        self.inputs: Tuple[Input, ...] = tuple(writer.inputs)
        self.atoms: Tuple[tree.Atom, ...] = tuple(writer.atoms)
        make = _compile(writer.source(f"({names},)"))
        self.step: Callable[..., Sequence[int]] = make(note, None, *writer.constants)


def endless(formula: tree.Node) -> Tuple[tree.Node, Tuple[int, ...]]:
    """Return a formula without an outermost ``always`` or ``eventually`` that has no bounds.

    It is about the whole sequence: once it is decided, all later states agree. So the same
    operator looks back, and one of its truths is a verdict. The second value has the truths that
    are verdicts.
    """
    if not (isinstance(formula, tree.Unary) and tree.is_endless(formula)):
        return formula, (FALSE, UNKNOWN, TRUE)
    if formula.operator == "always":
        return tree.Unary("historically", formula.operand), (FALSE,)
    return tree.Unary("once", formula.operand), (TRUE,)


@lru_cache(maxsize=256)
def _compile(source: str) -> Callable[..., Any]:
    names: dict[str, Any] = dict(_GLOBALS)
    exec(compile(source, "<formula>", "exec"), names)
    made: Callable[..., Any] = names["make"]
    return made


class _Writer:
    """Writes the function; a formula that occurs twice is computed once."""

    def __init__(self, period: int, notes: bool) -> None:
        self.inputs: List[Input] = []
        self.atoms: List[tree.Atom] = []
        self.constants: List[object] = []
        self.leaves: List[str] = []
        self.look_ahead: Optional[LookAhead] = None
        self._period = period
        self._notes = notes
        self._state: List[str] = []
        self._rare: List[str] = []
        self._lines: List[str] = []
        self._texts: dict[tree.Node, str] = {}
        self._uses: Counter[tree.Node] = Counter()
        self._count = 0

    def source(self, decided: str) -> str:
        """Return the text of a function that makes the function."""
        arguments = [f"i{number}" for number in range(len(self.inputs))]
        constants = [f"c{number}" for number in range(len(self.constants))]
        changing = [line.split(" = ")[0] for line in self._state]
        lines = [f"def make({', '.join(['note', 'ahead', *constants])}):"]
        lines += [f"    {line}" for line in (_LOCALS, "n = -1", *self._state, *self._rare)]
        lines += [f"    def step({', '.join(arguments)}):"]
        lines += [f"        nonlocal {', '.join(['n', *changing])}", "        n += 1"]
        lines += [f"        {line}" for line in self._lines]
        lines += [f"        return {decided}", "    return step"]
        return "\n".join(lines)

    def formula(self, formula: tree.Node) -> str:
        """Write the code of a formula's truth; returns the expression that has it."""
        self._uses.update(tree.walk(formula))
        if looks_ahead(formula):
            self.look_ahead = LookAhead(formula, self._period, self._leaf)
            return ""
        return self._truth(formula)

    def _leaf(self, formula: tree.Node) -> int:
        """Compute a part that ``LookAhead`` takes as it is; returns its number."""
        name = self._named(self._truth(formula))
        if name not in self.leaves:
            self.leaves.append(name)
        return self.leaves.index(name)

    def _truth(self, formula: tree.Node) -> str:
        if formula not in self._texts:
            if isinstance(formula, tree.Unary):
                text = self._unary(formula)
            elif isinstance(formula, tree.Binary):
                text = self._binary(formula)
            elif isinstance(formula, tree.Quantified):
                text = self._input(formula)
            else:
                text = self._atom(formula)
            self._texts[formula] = text if self._uses[formula] < 2 else self._named(text)
        return self._texts[formula]

    # Operators

    def _unary(self, formula: tree.Unary) -> str:
        operand = self._truth(formula.operand)
        if formula.operator == "not":
            return f"negated[{operand}]"
        near, far = steps(formula.interval, self._period)
        is_all = formula.operator == "historically"
        operand = self._delayed(operand, near, "3" if is_all else "0")
        return self._window(operand, None if far is None else far - near, is_all)

    def _window(self, operand: str, far: Optional[int], is_all: bool) -> str:
        """Write ``historically``, or ``once``, over a state and so many before it."""
        if far is None:
            kept = self._kept("3" if is_all else "0")
            self._lines.append(f"{kept} = {kept} {'&' if is_all else '|'} {operand}")
            return kept
        operand = self._named(operand)
        # The last states in which the other truth is possible, and certain.
        possible, certain = self._kept("-1"), self._kept("-1")
        self._lines += [
            f"if {operand} != 3:" if is_all else f"if {operand}:",
            f"    {possible} = n + {self._constant(far)}",
            f"    if {operand} == {'0' if is_all else '3'}: {certain} = {possible}",
        ]
        if is_all:
            return f"(3 if {possible} < n else 1 if {certain} < n else 0)"
        return f"(0 if {possible} < n else 1 if {certain} < n else 3)"

    def _binary(self, formula: tree.Binary) -> str:
        left, right = self._truth(formula.left), self._truth(formula.right)
        if formula.operator == "since":
            return self._since(formula, left, right)
        if formula.operator in ("and", "or"):
            return f"({left} {'&' if formula.operator == 'and' else '|'} {right})"
        left, right = self._named(left), self._named(right)
        return f"(3 if {left} == 0 else {right} if {left} == 3 else {right} | 1)"

    def _since(self, formula: tree.Binary, left: str, right: str) -> str:
        """Write ``since``: a state with the right side lasts until its end, or the left side's."""
        near, far = steps(formula.interval, self._period)
        if near:
            left = self._named(left)
        if far is None:
            found = self._kept("0")
            self._lines.append(f"{found} = {right} | {left} & {found}")
        else:
            left, right = self._named(left), self._named(right)
            possible, certain = self._kept("-1"), self._kept("-1")
            self._lines += [
                f"if {left} != 3:",
                f"    {certain} = -1",
                f"    if {left} == 0: {possible} = -1",
                f"if {right}:",
                f"    {possible} = n + {self._constant(far - near)}",
                f"    if {right} == 3: {certain} = {possible}",
            ]
            found = f"(0 if {possible} < n else 1 if {certain} < n else 3)"
        if near:
            late, held = self._delayed(found, near, "0"), self._window(left, near - 1, True)
            return f"({late} & {held})"
        return found

    def _delayed(self, name: str, states: int, before: str) -> str:
        """Write a queue, through which a truth comes out that many states later."""
        if not states:
            return name
        late, queue = self._new(), self._kept(f"deque([{before}]) * {self._constant(states)}")
        self._lines += [f"{queue}.append({name})", f"{late} = {queue}.popleft()"]
        return late

    # Atoms

    def _atom(self, atom: tree.Atom) -> str:
        """Write an atom, UNKNOWN if an input is, and note its changes."""
        name, number = self._new(), len(self.atoms)
        self.atoms.append(atom)
        texts = [self._expression(each) for each in tree.operands(atom)]
        inputs = sorted({self._input(_whole(each)) for each in tree.readings(atom)})
        if isinstance(atom, tree.Proposition):
            (text,) = texts
            if text not in inputs:
                self._lines += [f"try: x = {text}", "except ERRORS: x = None"]
                text = "x"
            found = f"3 if {text} is True else 0 if {text} is False else truth({text})"
            if text in inputs and not self._notes:
                return f"({found})"
            self._lines.append(f"{name} = {found}")
        else:
            left, right = texts
            compared = _COMPARISONS[atom.operator]
            given = ", ".join(inputs)
            self._lines += [
                f"if {' or '.join(f'{each} is None' for each in inputs)}: {name} = 1",
                "else:",
                "    try:",
                f"        x = {left}; y = {right}",
                f"        {name} = {compared}",
                f"    except ERRORS: {name} = rare{number}({given})",
            ]
            # Times and durations, which are compared with numbers in seconds, and missing ones: a
            # difference is exact if it is of times, and some sums are of seconds alone.
            in_seconds = [self._expression(each, "seconds") for each in tree.operands(atom)]
            compared = _AS_SECONDS.get(atom.operator, compared)
            self._rare += [
                f"def rare{number}({given}):",
                f"    try: x = seconds({left}); y = seconds({right}); return {compared}",
                "    except ERRORS: pass",
                f"    try: x = {in_seconds[0]}; y = {in_seconds[1]}; return {compared}",
                "    except ERRORS: return 1",
            ]
        if self._notes:
            seen = self._kept("None")
            self._lines += [
                f"if {name} != {seen}:",
                f"    {seen} = {name}",
                f"    note({number}, {name})",
            ]
        return name

    def _expression(self, expression: tree.Expression, around: str = "") -> str:
        """Write an expression, its fields each as the argument of a function."""
        if isinstance(expression, tree.Field):
            port = self._input(tree.Field(expression.port))
            path = (f"[{s}]" if isinstance(s, int) else f".{s}" for s in expression.path)
            return f"{around}({port}{''.join(path)})" if around else port + "".join(path)
        if isinstance(expression, tree.Constant):
            names = self._constant(expression.names)
            return f"constant({self._expression(expression.owner)}, {names})"
        if isinstance(expression, tree.Arithmetic):
            sides = (expression.left, expression.right)
            left, right = (self._expression(each, around or "plain") for each in sides)
            return f"({left} {expression.operator} {right})"
        if isinstance(expression, tree.Call):
            if expression.function in tree.OF_PORTS:
                return self._input(expression)
            given = (self._expression(each, around or "plain") for each in expression.arguments)
            arguments = ", ".join(given)
            return f"{_FUNCTIONS.get(expression.function, expression.function)}({arguments})"
        return self._constant(expression.value)

    # Variables

    def _input(self, wanted: Input) -> str:
        if wanted not in self.inputs:
            self.inputs.append(wanted)
        return f"i{self.inputs.index(wanted)}"

    def _constant(self, value: object) -> str:
        self.constants.append(value)
        return f"c{len(self.constants) - 1}"

    def _kept(self, value: str) -> str:
        """Declare a variable that outlives the call."""
        name = f"k{len(self._state)}"
        self._state.append(f"{name} = {value}")
        return name

    def _named(self, text: str) -> str:
        """Return a variable that has the value of an expression."""
        if text.isidentifier():
            return text
        name = self._new()
        self._lines.append(f"{name} = {text}")
        return name

    def _new(self) -> str:
        self._count += 1
        return f"v{self._count}"


#: A NaN is neither less nor greater than a number, nor equal to itself. A time is unequal to each
#: number, but less or greater than none: that is an error, and they are compared in seconds.
_COMPARISONS = {
    "<": "3 if x < y else 0 if x >= y else 1",
    "<=": "3 if x <= y else 0 if x > y else 1",
    ">": "3 if x > y else 0 if x <= y else 1",
    ">=": "3 if x >= y else 0 if x < y else 1",
    "==": "3 if x == y else 0 if x < y or x > y else 1",
    "!=": "0 if x == y else 3 if x < y or x > y else 1",
}
#: What has no order, as a text and a number, is unequal.
_AS_SECONDS = {
    "==": "3 if x == y else 0 if x == x and y == y else 1",
    "!=": "0 if x == y else 3 if x == x and y == y else 1",
}
_FUNCTIONS = {"min": "least", "max": "greatest"}


def _whole(reading: Union[tree.Field, tree.Call]) -> Union[tree.Field, tree.Call]:
    return tree.Field(reading.port) if isinstance(reading, tree.Field) else reading


def _seconds(value: Any) -> Any:
    return value.to_sec() if hasattr(value, "to_sec") else plain(value)


def _constant(message: Any, names: Sequence[str]) -> Any:
    """Look a constant up in a message, by its possible names."""
    for each in names:
        if hasattr(message, each):
            return getattr(message, each)
    raise AttributeError(names[0])


def _truth(value: Any) -> int:
    """Return the truth of a flag, of a message that has one as its data, or of a verdict."""
    if value is None:
        return UNKNOWN
    if hasattr(value, "UNKNOWN") and hasattr(value, "value"):
        return _VERDICT.get(value.value, UNKNOWN)
    value = plain(value)
    value = plain(getattr(value, "data", value))
    return (TRUE if value else FALSE) if isinstance(value, bool) else UNKNOWN


def _norm(*values: Any) -> float:
    """Return the length of a vector: of numbers, an array, or a message with x and y."""
    if len(values) == 1:
        (vector,) = values
        values = tuple(map(plain, vector)) if hasattr(vector, "__len__") else _components(vector)
    return math.sqrt(sum(value * value for value in values))


def _components(vector: Any) -> Tuple[Any, ...]:
    more = [name for name in ("z", "w") if hasattr(vector, name)]
    return tuple(plain(getattr(vector, name)) for name in ("x", "y", *more))


def _least(*values: float) -> float:
    return math.nan if any(value != value for value in values) else min(values)


def _greatest(*values: float) -> float:
    return math.nan if any(value != value for value in values) else max(values)


#: Values that the function uses often: it finds its own variables faster than those of its module.
_LOCALS = "negated, truth, decided = NEGATED, TRUTH, DECIDED"
_GLOBALS = {
    "ERRORS": _ERRORS,
    "NEGATED": _NEGATED,
    "TRUTH": _truth,
    "DECIDED": ((FALSE,), (UNKNOWN,), None, (TRUE,)),
    "constant": _constant,
    "plain": plain,
    "seconds": _seconds,
    "sqrt": math.sqrt,
    "norm": _norm,
    "least": _least,
    "greatest": _greatest,
    "deque": deque,
}
