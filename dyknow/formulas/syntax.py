# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads formulas.

From loosest to tightest, the operators are::

implies   or   and   until since   not always eventually historically once
< <= > >= == !=   + -   * /   -x
"""

from __future__ import annotations

import re
from decimal import Decimal, DecimalException
from functools import partial
from keyword import iskeyword
from typing import Callable, NamedTuple, NoReturn, Union

from dyknow.errors import FormulaError
from dyknow.formulas import tree
from dyknow.similar import did_you_mean

#: Longest formula that is read, in characters, and how deep its parentheses may be.
MAX_LENGTH = 10_000
MAX_DEPTH = 60
#: Most levels of operators; Python 3.8 compiles no more than 97 parentheses within each other.
MAX_HEIGHT = 90
_TOO_HIGH = f"it has more than {MAX_HEIGHT} levels: put parentheses around some operators in a row"
_YEAR = tree.UNITS["h"] * 24 * 365
#: Numbers of arguments that functions take, and the functions that take a port.
FUNCTIONS = {
    "abs": (1, 1),
    "sqrt": (1, 1),
    "len": (1, 1),
    "norm": (1, 9),
    "min": (2, 9),
    "max": (2, 9),
    "age": (1, 1),
    "rate": (1, 2),
    "present": (1, 1),
}

_UNARY = ("not", "always", "eventually", "historically", "once")
_BETWEEN = ("until", "since")
_QUANTIFIERS = ("every", "some")
_WORDS = {*_UNARY, *_BETWEEN, *_QUANTIFIERS, "and", "or", "implies", "true", "false"}
_COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
#: Signs of other languages, and the words to write in their stead.
_ELSEWHERE = {"&&": "and", "&": "and", "||": "or", "|": "or", "!": "not", "=": "==", "<>": "!="}
_TOKEN = re.compile(
    r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_]\w*)|(?P<variable>\?\w+)"
    r"|(?P<text>'(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\")"
    r"|(?P<sign>->|=>|<=|>=|==|!=|<>|&&|\|\||[-+*/<>=!&|()\[\],.:])|(?P<end>\Z)"
)
_CONSTANT = re.compile(r"[A-Z][A-Z0-9_]*\Z")


class _Token(NamedTuple):
    kind: str
    text: str
    place: int


class _Name(NamedTuple):
    """A name in capitals: a constant, if it is compared with a field."""

    name: str
    place: int


_Part = Union[tree.Node, tree.Expression, _Name]
_EXPRESSIONS = (
    tree.Number,
    tree.Text,
    tree.Flag,
    tree.Field,
    tree.Constant,
    tree.Call,
    tree.Arithmetic,
)


def parse(text: str) -> tree.Node:
    """Read a formula; raises FormulaError with line, column, and the expected words."""
    try:
        return _Parser(text).formula()
    except RecursionError:
        raise FormulaError(text, 0, _TOO_HIGH) from None


class _Parser:
    """Reads one text; each method reads the part that bears its name, and returns it."""

    def __init__(self, text: str) -> None:
        self._text = text
        if len(text) > MAX_LENGTH:
            self._fail(f"it has {len(text)} characters: at most {MAX_LENGTH}", 0)
        self._depth = 0
        self._tokens = list(self._read(text))
        self._next = 0

    def _read(self, text: str) -> list[_Token]:
        tokens: list[_Token] = []
        place = 0
        while not tokens or tokens[-1].kind != "end":
            place += len(text[place:]) - len(text[place:].lstrip())
            found = _TOKEN.match(text, place)
            if found is None:
                what = "a text without its end" if text[place] in "'\"" else f"'{text[place]}'"
                self._fail(f"{what} is not part of a formula", place)
            tokens.append(_Token(str(found.lastgroup), found.group(), place))
            place = found.end()
        return tokens

    # Tokens

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _take(self) -> _Token:
        token = self._token
        self._next += token.kind != "end"
        return token

    def _accept(self, *texts: str) -> _Token | None:
        is_it = self._token.text in texts and self._token.kind in ("sign", "name")
        return self._take() if is_it else None

    def _expect(self, text: str, why: str = "") -> _Token:
        return self._accept(text) or self._unexpected(f"'{text}'{why}")

    def _fail(self, problem: str, place: int) -> NoReturn:
        raise FormulaError(self._text, place, problem)

    def _unexpected(self, expected: str) -> NoReturn:
        token = self._token
        found = f"'{token.text}'" if token.text else "the end"
        hint = ""
        if token.text in _ELSEWHERE:
            hint = f"; write '{_ELSEWHERE[token.text]}'"
        elif token.kind == "name" and token.text not in _WORDS:
            hint = did_you_mean(token.text.lower(), _WORDS)
        self._fail(f"expected {expected}, found {found}{hint}", token.place)

    # Formulas

    def formula(self) -> tree.Node:
        whole = self._formula(self._implication)
        if self._token.kind != "end":
            self._unexpected("an operator such as 'and', or the end")
        if tree.height(whole) > MAX_HEIGHT:
            self._fail(_TOO_HIGH, 0)
        for each in tree.walk(whole):
            if each is not whole and isinstance(each, tree.Unary) and tree.is_endless(each):
                problem = f"'{each.operator}' without bounds may only stand outermost"
                self._fail(f"{problem}: write bounds, as {each.operator}[0 s, 5 s]", each.place)
        return whole

    def _formula(self, read: Callable[[], _Part]) -> tree.Node:
        """Read a part, and take an expression for an atom."""
        place = self._token.place
        return self._taken(read(), place)

    def _taken(self, part: _Part, place: int) -> tree.Node:
        if isinstance(part, _Name):
            self._fail(f"constant '{part.name}' is not compared with a field", part.place)
        if isinstance(part, (tree.Number, tree.Text, tree.Constant, tree.Arithmetic)) or (
            isinstance(part, tree.Call) and part.function != "present"
        ):
            self._fail(f"'{part}' is not true or false: compare it", place)
        return self._atom(tree.Proposition(part)) if isinstance(part, _EXPRESSIONS) else part

    def _implication(self) -> _Part:
        self._depth += 1
        place = self._token.place
        if self._depth > MAX_DEPTH:
            self._fail(f"it is nested deeper than {MAX_DEPTH}", place)
        left = self._chain("or")
        token = self._accept("implies", "->", "=>")
        if token is not None:
            right = self._formula(self._implication)
            left = tree.Binary("implies", self._taken(left, place), right, place=token.place)
        self._depth -= 1
        return left

    def _chain(self, operator: str) -> _Part:
        """Read parts with ``or`` or ``and`` between them."""
        place = self._token.place
        inner = partial(self._chain, "and") if operator == "or" else self._between
        left = inner()
        token = self._accept(operator)
        while token is not None:
            right = self._formula(inner)
            left = tree.Binary(operator, self._taken(left, place), right, place=token.place)
            token = self._accept(operator)
        return left

    def _between(self) -> _Part:
        place = self._token.place
        left = self._unary()
        token = self._accept(*_BETWEEN)
        if token is None:
            return left
        interval = self._interval(token)
        right = self._formula(self._between)
        return tree.Binary(token.text, self._taken(left, place), right, interval, token.place)

    def _unary(self) -> _Part:
        token = self._accept(*_UNARY)
        if token is None:
            return self._quantified() or self._comparison()
        interval = tree.Interval() if token.text == "not" else self._interval(token)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self._fail(f"it is nested deeper than {MAX_DEPTH}", token.place)
        operand = self._formula(self._unary)
        self._depth -= 1
        return tree.Unary(token.text, operand, interval, token.place)

    def _interval(self, operator: _Token) -> tree.Interval:
        if not self._accept("["):
            if operator.text == "until":
                self._unexpected("the bounds of 'until', as until[0 s, 5 s]")
            return tree.Interval()
        lower = self._duration()
        self._expect(",", " between the bounds")
        token = self._token
        if self._accept("inf"):
            if operator.text not in ("historically", "once", "since"):
                self._fail(f"'{operator.text}' needs an upper bound", token.place)
            upper = None
        else:
            upper = self._duration()
            if upper < lower:
                self._fail("the upper bound is below the lower one", token.place)
        self._expect("]", " after the bounds")
        return tree.Interval(lower, upper)

    def _duration(self) -> int:
        token = self._token
        if token.kind != "number":
            self._unexpected("a duration such as 5 s or 200 ms")
        self._take()
        nanoseconds = self._times(token, self._unit())
        if not nanoseconds < _YEAR:
            self._fail("a bound is at most a year", token.place)
        return round(nanoseconds)

    def _times(self, number: _Token, unit: int) -> Decimal:
        try:
            return Decimal(number.text) * unit
        except DecimalException:
            self._fail("a number is out of range", number.place)

    def _unit(self) -> int:
        """Nanoseconds of the unit that follows, or of a second."""
        if self._token.kind == "name" and self._token.text in tree.UNITS:
            return tree.UNITS[self._take().text]
        return tree.SECOND

    def _quantified(self) -> tree.Node | None:
        token = self._accept(*_QUANTIFIERS)
        if token is None:
            return None
        if self._token.kind != "variable":
            self._unexpected("a variable such as ?c")
        variable, concept = self._take().text, ""
        if self._accept(":"):
            if self._token.kind != "name":
                self._unexpected("a concept such as Camera")
            concept = self._take().text
        self._expect("(", " before the formula of the individuals")
        operand = self._formula(self._implication)
        self._expect(")")
        for each in tree.quantifiers(operand):
            self._fail("a quantifier cannot stand within another one", each.place)
        return tree.Quantified(token.text, variable, concept, operand, token.place)

    # Atoms

    def _comparison(self) -> _Part:
        left = self._sum()
        found: tree.Node | None = None
        token = self._accept(*_COMPARISONS)
        if token is None and self._token.text in ("=", "<>"):
            self._unexpected("a comparison")
        while token is not None:
            right = self._sum()
            sides = self._constant(left, right), self._constant(right, left)
            atom = self._atom(tree.Comparison(token.text, *sides))
            found = atom if found is None else tree.Binary("and", found, atom)
            left, token = right, self._accept(*_COMPARISONS)
        return left if found is None else found

    def _atom(self, atom: tree.Atom) -> tree.Atom:
        if not tree.ports(atom):
            self._fail(f"'{atom}' reads no port, so it never changes", self._token.place)
        return atom

    def _constant(self, part: _Part, other: _Part) -> tree.Expression:
        if isinstance(part, _Name) and isinstance(other, tree.Field):
            return tree.Constant(part.name, other, part.place)
        return self._expression(part)

    def _expression(self, part: _Part) -> tree.Expression:
        if isinstance(part, _Name):
            self._fail(f"constant '{part.name}' is not compared with a field", part.place)
        if not isinstance(part, _EXPRESSIONS):
            self._fail(f"'{part}' is true or false, and cannot be compared", self._token.place)
        return part

    def _sum(self) -> _Part:
        return self._arithmetic(("+", "-"), ("*", "/"))

    def _arithmetic(self, signs: tuple[str, ...], tighter: tuple[str, ...]) -> _Part:
        left = self._arithmetic(tighter, ()) if tighter else self._sign()
        token = self._accept(*signs)
        while token is not None:
            right = self._arithmetic(tighter, ()) if tighter else self._sign()
            left = tree.Arithmetic(token.text, self._expression(left), self._expression(right))
            token = self._accept(*signs)
        return left

    def _sign(self) -> _Part:
        token = self._accept("-")
        if token is None:
            return self._primary()
        operand = self._expression(self._sign())
        if isinstance(operand, tree.Number):
            return tree.Number(-operand.value)
        return tree.Call("-", (operand,), token.place)

    def _primary(self) -> _Part:
        token = self._token
        if self._accept("("):
            inner = self._implication()
            self._expect(")")
            return inner
        if token.kind == "number":
            self._take()
            is_duration = self._token.kind == "name" and self._token.text in tree.UNITS
            value = self._times(token, self._unit() if is_duration else 1)
            if not is_duration and token.text.isdigit() and 2**53 < value < 2**64:
                return tree.Number(int(value))
            return tree.Number(float(value / tree.SECOND if is_duration else value))
        if token.kind == "text":
            return tree.Text(re.sub(r"\\(.)", r"\1", self._take().text[1:-1]))
        if token.kind != "name" or (token.text in _WORDS and token.text not in ("true", "false")):
            self._unexpected("a formula")
        self._take()
        if token.text in ("True", "False"):
            hint = f"write '{token.text.lower()}'"
            self._fail(f"'{token.text}' is a word of Python: {hint}", token.place)
        if token.text in ("true", "false"):
            return tree.Flag(token.text == "true")
        if self._token.text == "(":
            return self._call(token)
        if self._token.text in (".", "["):
            return self._field(token)
        if _CONSTANT.match(token.text):
            return _Name(token.text, token.place)
        hint = did_you_mean(token.text, _WORDS)
        if hint and self._token.kind in ("name", "number") and self._token.text not in _WORDS:
            self._fail(f"'{token.text}' is not an operator{hint}", token.place)
        return tree.Field(token.text, (), token.place)

    def _call(self, token: _Token) -> tree.Expression:
        if token.text not in FUNCTIONS:
            hint = did_you_mean(token.text, {*FUNCTIONS, *_WORDS})
            self._fail(f"'{token.text}' is not a function{hint}", token.place)
        self._take()
        first = self._sum()
        if token.text in tree.OF_PORTS and isinstance(first, _Name):
            first = tree.Field(first.name, (), first.place)
        arguments = [self._expression(first)]
        while self._accept(","):
            arguments.append(self._expression(self._sum()))
        self._expect(")", f" after the arguments of {token.text}")
        least, most = FUNCTIONS[token.text]
        if not least <= len(arguments) <= most:
            expected = f"{least}" if least == most else f"{least} to {most}"
            problem = f"{token.text} takes {expected} arguments, not {len(arguments)}"
            self._fail(problem, token.place)
        if token.text in tree.OF_PORTS and not (
            isinstance(arguments[0], tree.Field) and not arguments[0].path
        ):
            self._fail(f"{token.text} takes a port, not '{arguments[0]}'", token.place)
        if token.text == "rate" and len(arguments) == 2:
            window = arguments[1]
            if not isinstance(window, tree.Number) or not window.value > 0:
                self._fail("the second argument of rate is a duration, as 5 s", token.place)
            if not window.value < _YEAR // tree.SECOND:
                self._fail("the second argument of rate is at most a year", token.place)
        return tree.Call(token.text, tuple(arguments), token.place)

    def _field(self, token: _Token) -> tree.Field:
        path: list[str | int] = []
        while self._token.text in (".", "["):
            if self._take().text == "[":
                index = self._take()
                is_whole = index.kind == "number" and index.text.isdigit()
                # Python refuses to convert thousands of digits.
                if not is_whole or len(index.text) > 18 or self._token.text != "]":
                    hint = did_you_mean(token.text, _WORDS)
                    self._fail(
                        f"the index of '{token.text}' is one whole number{hint}", token.place
                    )
                path.append(int(index.text))
                self._take()
            else:
                step = self._take()
                if step.kind != "name" or not step.text.isascii():
                    self._fail("expected the name of a field", step.place)
                if iskeyword(step.text):
                    hint = f"the field is '{step.text}_' in Python"
                    self._fail(f"'{step.text}' is a word of Python: {hint}", step.place)
                path.append(step.text)
        return tree.Field(token.text, tuple(path), token.place)
