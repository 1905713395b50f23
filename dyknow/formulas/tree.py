# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas as values: what ``dyknow.formulas.syntax`` reads, and ``str`` writes again.

An *expression* is a number, a text or a flag that is read from messages. An *atom* compares two
expressions, or takes one for a truth. A *formula* combines atoms. All times are in nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Iterator, List, Optional, Tuple, Union

#: Units of time in a formula, in nanoseconds.
UNITS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000}
UNITS["h"] = 60 * UNITS["min"]
SECOND = UNITS["s"]

FUTURE = ("always", "eventually", "until")
PAST = ("historically", "once", "since")
#: The functions of a port; all other ones are of numbers and texts.
OF_PORTS = ("age", "rate", "present")


@dataclass(frozen=True)
class Number:
    """A number, whole if it needs more digits than a double has; a duration is in seconds."""

    value: Union[float, int]

    def __str__(self) -> str:
        text = repr(self.value).replace("inf", "1e999")
        return text[:-2] if text.endswith(".0") else text


@dataclass(frozen=True)
class Text:
    """A text in quotes."""

    value: str

    def __str__(self) -> str:
        return "'" + self.value.replace("\\", "\\\\").replace("'", "\\'") + "'"


@dataclass(frozen=True)
class Flag:
    """``true`` or ``false``."""

    value: bool

    def __str__(self) -> str:
        return "true" if self.value else "false"


@dataclass(frozen=True)
class Field:
    """A port, or a field of its message: ``odom.twist.covariance[0]``."""

    port: str
    path: Tuple[Union[str, int], ...] = ()  # names of fields, and indices of arrays
    place: int = field(default=0, compare=False)  # where it stands in the text

    def __str__(self) -> str:
        steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in self.path)
        return self.port + "".join(steps)


@dataclass(frozen=True)
class Constant:
    """A constant of the message whose field it is compared with: ``CHARGING``.

    ``of`` is that field; a message type may begin the names of its constants with the field's.
    """

    name: str
    of: Field
    place: int = field(default=0, compare=False)

    @property
    def owner(self) -> Field:
        """The message that has the constant: that of the field, or of the array it is in."""
        return Field(self.of.port, self._path[:-1], self.place)

    @property
    def names(self) -> Tuple[str, ...]:
        """The names that the constant may have."""
        return (self.name, *(f"{str(step).upper()}_{self.name}" for step in self._path[-1:]))

    @property
    def _path(self) -> Tuple[Union[str, int], ...]:
        path = self.of.path
        while path and isinstance(path[-1], int):
            path = path[:-1]
        return path

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Call:
    """A function of expressions, or of a port: ``abs(x)``, ``age(battery)``; ``-`` negates."""

    function: str
    arguments: Tuple[Expression, ...]
    place: int = field(default=0, compare=False)

    def __str__(self) -> str:
        return f"{self.function}({', '.join(map(str, self.arguments))})"


@dataclass(frozen=True)
class Arithmetic:
    """Two expressions with ``+``, ``-``, ``*`` or ``/`` between them."""

    operator: str
    left: Expression
    right: Expression

    def __str__(self) -> str:
        return f"({self.left} {self.operator} {self.right})"


Expression = Union[Number, Text, Flag, Field, Constant, Call, Arithmetic]


@dataclass(frozen=True)
class Comparison:
    """An atom that compares two expressions."""

    operator: str
    left: Expression
    right: Expression

    def __str__(self) -> str:
        return f"{self.left} {self.operator} {self.right}"


@dataclass(frozen=True)
class Proposition:
    """An atom that takes an expression for a truth: a flag, a verdict, ``present(port)``."""

    expression: Expression

    def __str__(self) -> str:
        return str(self.expression)


@dataclass(frozen=True)
class Interval:
    """The bounds of an operator, in nanoseconds; ``upper`` is None where there is none."""

    lower: int = 0
    upper: Optional[int] = None

    def __str__(self) -> str:
        if self.upper is None and not self.lower:
            return ""
        upper = "inf" if self.upper is None else _duration(self.upper)
        return f"[{_duration(self.lower)}, {upper}]"


_NO_BOUNDS = Interval()


@dataclass(frozen=True)
class Unary:
    """``not``, or ``always``, ``eventually``, ``historically`` or ``once`` with its bounds."""

    operator: str
    operand: Node
    interval: Interval = _NO_BOUNDS
    place: int = field(default=0, compare=False)

    def __str__(self) -> str:
        return f"{self.operator}{self.interval} {_enclosed(self.operand)}"


@dataclass(frozen=True)
class Binary:
    """``and``, ``or`` or ``implies``, or ``until`` or ``since`` with its bounds."""

    operator: str
    left: Node
    right: Node
    interval: Interval = _NO_BOUNDS
    place: int = field(default=0, compare=False)

    def __str__(self) -> str:
        operator = f"{self.operator}{self.interval}"
        return f"{_enclosed(self.left)} {operator} {_enclosed(self.right)}"


@dataclass(frozen=True)
class Quantified:
    """``every`` or ``some`` individual of a concept: ``every ?c: Camera (rate(image) > 5)``."""

    quantifier: str
    variable: str
    concept: str
    operand: Node
    place: int = field(default=0, compare=False)

    def __str__(self) -> str:
        concept = f": {self.concept}" if self.concept else ""
        return f"{self.quantifier} {self.variable}{concept} ({self.operand})"


Atom = Union[Comparison, Proposition]
Operator = Union[Unary, Binary]
Node = Union[Atom, Unary, Binary, Quantified]


def children(formula: Node) -> Tuple[Node, ...]:
    """Return the formulas that a formula combines."""
    if isinstance(formula, Binary):
        return (formula.left, formula.right)
    return (formula.operand,) if isinstance(formula, (Unary, Quantified)) else ()


def walk(formula: Node) -> Iterator[Node]:
    """Yield a formula and all within it."""
    yield formula
    for child in children(formula):
        yield from walk(child)


def height(formula: Node) -> int:
    """Return how many levels of formulas and expressions there are."""
    levels = 0
    level: List[Union[Node, Expression]] = [formula]
    while level:
        levels += 1
        level = [part for each in level for part in _parts(each)]
    return levels


def _parts(part: Union[Node, Expression]) -> Tuple[Union[Node, Expression], ...]:
    if isinstance(part, (Comparison, Proposition)):
        return operands(part)
    if isinstance(part, Arithmetic):
        return (part.left, part.right)
    if isinstance(part, Call):
        return part.arguments
    return children(part) if isinstance(part, (Unary, Binary, Quantified)) else ()


def operands(atom: Atom) -> Tuple[Expression, ...]:
    return (atom.left, atom.right) if isinstance(atom, Comparison) else (atom.expression,)


def atoms(formula: Node) -> Tuple[Atom, ...]:
    """Return the atoms of a formula, each once, in the order written."""
    found = (each for each in walk(formula) if isinstance(each, (Comparison, Proposition)))
    return tuple(dict.fromkeys(found))


def quantifiers(formula: Node) -> List[Quantified]:
    """Return the quantifiers of a formula, in the order written."""
    return [each for each in walk(formula) if isinstance(each, Quantified)]


def outermost(formula: Node) -> Iterator[Union[Atom, Quantified]]:
    """Yield the quantifiers of a formula, and the atoms outside them, in the order written."""
    if isinstance(formula, (Unary, Binary)):
        for child in children(formula):
            yield from outermost(child)
    else:
        yield formula


def readings(atom: Atom) -> Tuple[Union[Field, Call], ...]:
    """Return the readings of an atom, in order: fields, ports, ``age`` and the like."""
    return tuple(dict.fromkeys(each for one in operands(atom) for each in _readings(one)))


def _readings(expression: Expression) -> Iterator[Union[Field, Call]]:
    if isinstance(expression, Field) or (
        isinstance(expression, Call) and expression.function in OF_PORTS
    ):
        yield expression
    elif isinstance(expression, Call):
        for each in expression.arguments:
            yield from _readings(each)
    elif isinstance(expression, Arithmetic):
        yield from (*_readings(expression.left), *_readings(expression.right))


def port_of(reading: Union[Field, Call]) -> str:
    """Return the port that a field or a function of a port belongs to."""
    field_ = reading if isinstance(reading, Field) else reading.arguments[0]
    assert isinstance(field_, Field)
    return field_.port


def ports(formula: Node) -> Tuple[str, ...]:
    """Return the ports that a formula reads, in the order written."""
    return tuple(
        dict.fromkeys(port_of(each) for atom in atoms(formula) for each in readings(atom))
    )


def temporal(formula: Node) -> Optional[Operator]:
    """Return a formula if it is an operator that looks at other states."""
    if isinstance(formula, (Unary, Binary)) and formula.operator in (*FUTURE, *PAST):
        return formula
    return None


def temporals(formula: Node) -> Iterator[Operator]:
    """Yield the operators within a formula that look at other states."""
    for each in walk(formula):
        found = temporal(each)
        if found is not None:
            yield found


def is_endless(formula: Node) -> bool:
    """Whether it is ``always`` or ``eventually`` without bounds, which only stands outermost."""
    found = temporal(formula)
    return found is not None and found.operator in FUTURE and found.interval.upper is None


def _enclosed(formula: Node) -> str:
    is_plain = isinstance(formula, (Proposition, Quantified)) or (
        isinstance(formula, Unary) and formula.operator == "not"
    )
    return str(formula) if is_plain else f"({formula})"


def _duration(nanoseconds: int) -> str:
    for unit in ("h", "min", "s", "ms", "us"):
        if nanoseconds and nanoseconds % UNITS[unit] == 0:
            return f"{nanoseconds // UNITS[unit]} {unit}"
    return f"{nanoseconds} ns" if nanoseconds else "0 s"
