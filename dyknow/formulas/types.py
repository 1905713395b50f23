# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Checks formulas against the types of messages, which are described without importing ROS."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from typing import Any, Callable, Mapping, NamedTuple, NoReturn, Optional, Union

from dyknow.errors import FormulaError
from dyknow.formulas import tree
from dyknow.similar import did_you_mean

ARRAY = re.compile(r"(.*)\[\d*\]\Z")
_NUMBERS = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
_NUMBERS |= {"float32", "float64", "byte", "char", "time", "duration"}
_LISTED = 30  # most names that an error lists


class MessageType(NamedTuple):
    """A message type: the types of its fields, and the names of its constants."""

    name: str
    fields: Mapping[str, str]
    constants: frozenset[str]


Lookup = Callable[[str], Optional[MessageType]]
"""Returns a message type by its name, None for one that is not known."""


def type_of(message_class: Any) -> MessageType | None:
    """Describe a message class; None for classes that are not ROS's."""
    slots = getattr(message_class, "_slot_types", None)
    if slots is None:
        return None
    names = frozenset(name for name in dir(message_class) if re.match(r"[A-Z]\w*\Z", name))
    return MessageType(message_class._type, dict(zip(message_class.__slots__, slots)), names)


def known_type(name: str) -> MessageType | None:
    """Look up a message type among those that this process has imported."""
    package, _, short = name.partition("/")
    return type_of(getattr(sys.modules.get(f"{package}.msg"), short, None))


@dataclass(frozen=True)
class TypeChecker:
    """Finds kinds of values: ``number``, ``text``, ``flag``, a message type, or empty: unknown."""

    text: str
    types: Mapping[str, Optional[MessageType]]
    lookup: Lookup

    def check(self, formula: tree.Node) -> None:
        """Check a formula; see ``Formula.check``."""
        for atom in tree.atoms(formula):
            if isinstance(atom, tree.Comparison):
                self._comparable(atom, self._kind_of(atom.left), self._kind_of(atom.right))
            else:
                self._truth(atom.expression)

    def _fail(self, place: int, problem: str) -> NoReturn:
        raise FormulaError(self.text, place, problem)

    def _kind_of(self, expression: tree.Expression) -> str:
        if isinstance(expression, tree.Text):
            return "text"
        if isinstance(expression, tree.Flag):
            return "flag"
        if isinstance(expression, tree.Constant):
            self._check_constant(expression)
            return self._kind_of(expression.of)
        if isinstance(expression, tree.Arithmetic):
            for each in (expression.left, expression.right):
                kind = self._kind_of(each)
                if kind not in ("", "number"):
                    problem = f"'{expression.operator}' takes numbers, but '{each}' is {_a(kind)}"
                    self._fail(_place(each), problem)
        if isinstance(expression, tree.Call):
            return self._call(expression)
        return self._field(expression) if isinstance(expression, tree.Field) else "number"

    def _call(self, call: tree.Call) -> str:
        if call.function in tree.OF_PORTS:
            self._field(call.arguments[0])
            return "flag" if call.function == "present" else "number"
        for each in call.arguments:
            kind = self._kind_of(each)
            if call.function == "len":
                is_fit = kind in ("", "text") or bool(ARRAY.match(kind))
                fitting = "texts and arrays"
            elif call.function == "norm" and len(call.arguments) == 1:
                is_fit = self._is_vector(kind)
                fitting = "arrays of numbers, and messages with x and y"
            else:
                is_fit, fitting = kind in ("", "number"), "numbers"
            if not is_fit:
                problem = f"{call.function} cannot be applied to '{each}', {_a(kind)}"
                self._fail(call.place, f"{problem}: it takes {fitting}")
        return "number"

    def _is_vector(self, kind: str) -> bool:
        """Whether a kind is, or may be, an array of numbers or a message with x and y."""
        array = ARRAY.match(kind)
        if array is not None:
            return _kind(array.group(1)) == "number"
        if "/" not in kind:
            return not kind
        owner = self.lookup(kind)
        return owner is None or {"x", "y"} <= owner.fields.keys()

    def _field(self, field: Union[tree.Field, Any]) -> str:
        """Follow the path of a field."""
        if field.port not in self.types:
            hint = did_you_mean(field.port, self.types) or f"; there are: {_names(self.types)}"
            self._fail(field.place, f"there is no port '{field.port}'{hint}")
        owner = self.types[field.port]
        kind, done = (owner.name if owner is not None else ""), field.port
        for step in field.path:
            array = ARRAY.match(kind)
            if isinstance(step, int):
                if kind and not array:
                    self._fail(field.place, f"'{done}' has no index: it is {_a(kind)}")
                kind, done = (_kind(array.group(1)) if array else ""), f"{done}[{step}]"
                owner = self.lookup(kind) if "/" in kind else None
                continue
            if kind and ("/" not in kind or array):
                hint = f"; write an index, as {done}[0]" if array else ""
                self._fail(field.place, f"'{done}' has no fields: it is {_a(kind)}{hint}")
            if owner is not None and step not in owner.fields:
                hint = did_you_mean(step, owner.fields)
                problem = f"{owner.name} has no field '{step}'{hint or ';'}"
                self._fail(field.place, f"{problem} its fields are: {_names(owner.fields)}")
            kind, done = (_kind(owner.fields[step]) if owner is not None else ""), f"{done}.{step}"
            owner = self.lookup(kind) if "/" in kind and not ARRAY.match(kind) else None
        return kind

    def _check_constant(self, constant: tree.Constant) -> None:
        owner = self.lookup(self._field(constant.owner))
        if owner is None:
            return
        if not owner.constants.intersection(constant.names):
            hint = did_you_mean(constant.name, owner.constants)
            problem = f"{owner.name} has no constant '{constant.name}'{hint or ';'}"
            self._fail(constant.place, f"{problem} its constants are: {_names(owner.constants)}")

    def _comparable(self, atom: tree.Comparison, left: str, right: str) -> None:
        """Check that two kinds can be compared."""
        for kind, side in ((left, atom.left), (right, atom.right)):
            if "/" in kind or ARRAY.match(kind):
                owner = self.lookup(kind)
                hint = f": compare a field, one of {_names(owner.fields)}" if owner else ""
                self._fail(_place(side), f"'{side}' cannot be compared: it is {_a(kind)}{hint}")
        place = _place(atom.left, _place(atom.right))
        if left and right and left != right:
            self._fail(place, f"{_a(left)} is compared with {_a(right)}: '{atom}'")
        if atom.operator not in ("==", "!=") and {left, right} & {"text", "flag"}:
            self._fail(place, f"a text or flag is compared with '==' or '!=': '{atom}'")

    def _truth(self, expression: tree.Expression) -> None:
        """Check that an expression can be taken for a truth."""
        kind = self._kind_of(expression)
        owner = self.lookup(kind) if "/" in kind else None
        has_truth = owner is not None and (
            owner.fields.get("data") == "bool" or {"TRUE", "UNKNOWN"} <= owner.constants
        )
        if kind not in ("", "flag") and not has_truth and (owner is not None or "/" not in kind):
            hint = f": compare a field, one of {_names(owner.fields)}" if owner else ""
            problem = f"'{expression}' is not true or false: it is {_a(kind)}{hint}"
            self._fail(_place(expression), problem)


def _kind(datatype: str) -> str:
    if datatype in _NUMBERS:
        return "number"
    return {"bool": "flag", "string": "text", "Header": "std_msgs/Header"}.get(datatype, datatype)


def _a(kind: str) -> str:
    article = "an" if kind[:1] in "aeiou" else "a"
    return f"an array {kind}" if ARRAY.match(kind) else f"{article} {kind}"


def _names(names: Any) -> str:
    found = sorted(names) if isinstance(names, frozenset) else list(names)
    more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    return ", ".join(found[:_LISTED]) + more or "none"


def _place(expression: tree.Expression, default: int = 0) -> int:
    return getattr(expression, "place", default)
