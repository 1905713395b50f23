# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Message types, as formulas are checked against them."""

from __future__ import annotations

from typing import Any, Collection, Mapping

from dyknow.errors import DyKnowError
from dyknow.formulas import Formula, MessageType
from dyknow.formulas.types import type_of
from dyknow.model.transformation import VERDICT
from dyknow.ros.wire.message_classes import message_class


def usual_delay(datatypes: Collection[str]) -> float:
    """Return the seconds for which states stay open by default.

    A verdict comes after its state by the delay of the formula that it is of.
    """
    return 0.5 if VERDICT in datatypes else 0.1


def message_type(datatype: str) -> MessageType | None:
    """Describe a message type; None if it is not built here."""
    return type_of(message_class(datatype))


def known_class(datatype: str) -> Any:
    """Return the class of a message type.

    Raises:
        DyKnowError: it is not built here.
    """
    found = message_class(datatype)
    if found is None:
        package = datatype.partition("/")[0]
        raise DyKnowError(
            f"the message type {datatype} cannot be imported: is the package {package} built, and "
            "its workspace sourced?"
        )
    return found


def check(formula: Formula, datatypes: Mapping[str, str]) -> None:
    """Check a formula against the types of its ports; empty for one that is not known.

    Raises:
        FormulaError: it does not fit them.
    """
    formula.check({port: message_type(name) for port, name in datatypes.items()}, message_type)
