# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parameters of nodelets and nodes, checked when they are read."""

from __future__ import annotations

from typing import Any, Callable

from dyknow import names
from dyknow.errors import BadParameter, InvalidName
from dyknow.manager.specifications.values import find
from dyknow.ros.wire.message_classes import message_class


def get_datatype(nh: Any, parameter: str = "~datatype", default: str = "std_msgs/Header") -> Any:
    """Return the message class that a parameter names.

    Raises:
        BadParameter: no message type of that name can be imported.
    """
    name = nh.get_param(parameter, default)
    found = message_class(name) if isinstance(name, str) else None
    if found is None:
        expected = "a message type of a built package, such as sensor_msgs/Image"
        raise BadParameter(nh.resolve_name(parameter), name, expected)
    return found


def get_positive(nh: Any, name: str, default: float, unit: str) -> float:
    """Return a parameter that must be a number above zero, or its default.

    Raises:
        BadParameter: it is not such a number.
    """
    value = nh.get_param(name, default)
    if not (is_number(value) and value > 0):
        raise BadParameter(nh.resolve_name(name), value, f"a number above 0, in {unit}")
    return float(value)


class PrivateParameters:
    """All private parameters of a node, from one question: the master may be far away.

    Each method but ``find`` raises BadParameter for a value that is not the expected one.
    """

    def __init__(self, given: Any) -> None:
        """Take the parameters; a value in place of all of them has none."""
        self.given: dict[str, Any] = given if isinstance(given, dict) else {}

    def find(self, name: str, default: Any) -> Any:
        """Return a parameter, also one in a namespace, or its default."""
        return find(self.given, name, default)

    def read(self, name: str, default: Any, expected: str, fits: Callable[[Any], bool]) -> Any:
        """Return a parameter, or its default, if its value fits."""
        value = self.find(name, default)
        if not fits(value):
            raise BadParameter(f"~{name}", value, expected)
        return value

    def string(self, name: str, default: str = "") -> str:
        return str(self.read(name, default, "a text", lambda value: isinstance(value, str)))

    def strings(self, name: str) -> tuple[str, ...]:
        """Read a list, or a text with white space between the entries, as launch files have it."""

        def fits(value: Any) -> bool:
            return isinstance(value, str) or (
                isinstance(value, list) and all(isinstance(each, str) for each in value)
            )

        value = self.read(name, [], "a list of texts", fits)
        return tuple(value.split() if isinstance(value, str) else value)

    def nodes(self, name: str, node: str) -> tuple[str, ...]:
        """Read names of nodes; relative ones resolve in the namespace of the node itself."""
        try:
            return tuple(
                names.resolve(each, names.parent(node), node) for each in self.strings(name)
            )
        except InvalidName as error:
            raise BadParameter(
                f"~{name}", error.name, "names of nodes, separated by spaces"
            ) from error

    def texts(self, name: str, expected: str) -> dict[str, str]:
        """Read a map of texts."""

        def fits(value: Any) -> bool:
            return isinstance(value, dict) and all(isinstance(e, str) for e in value.values())

        return dict(self.read(name, {}, expected, fits))

    def one_of(self, name: str, *values: str) -> str:
        """Read one of some texts, of which the first is the default."""
        expected = " or ".join(f"'{value}'" for value in values)
        return str(self.read(name, values[0], expected, lambda value: value in values))

    def flag(self, name: str, default: bool = False) -> bool:
        return bool(
            self.read(name, default, "true or false", lambda value: isinstance(value, bool))
        )

    def integer(self, name: str, default: int) -> int:
        """Read an integer that is not negative."""

        def fits(value: Any) -> bool:
            return isinstance(value, int) and not isinstance(value, bool) and value >= 0

        return int(self.read(name, default, "an integer from 0", fits))

    def number(
        self, name: str, default: float, expected: str, fits: Callable[[float], bool]
    ) -> float:
        return float(
            self.read(name, default, expected, lambda value: is_number(value) and fits(value))
        )


def is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
