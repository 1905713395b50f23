# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Catches exceptions in slots and events: PyQt aborts the process if one leaves them."""

from __future__ import annotations

import functools
import inspect
import logging
from typing import Any, Callable, TypeVar, cast

from dyknow.errors import DyKnowError
from dyknow_rqt.graph.filters import BadFilter

_LOG = logging.getLogger("rosout.dyknow_rqt")
_Function = TypeVar("_Function", bound=Callable[..., Any])


def qt_slot(method: _Function) -> _Function:
    """Let a method be called by Qt.

    An exception is shown by the ``report`` of the object, if it has one: expected errors in their
    own words, others with their type, and logged with their traceback. Arguments of a signal that
    the method does not take are dropped.
    """
    most = len(inspect.signature(method).parameters) - 1

    @functools.wraps(method)
    def guard(self: Any, *args: Any) -> Any:
        try:
            return method(self, *args[:most])
        except (DyKnowError, BadFilter, OSError) as error:
            _report(self, str(error))
        except Exception as error:
            _LOG.exception("in %s", method.__qualname__)
            _report(self, f"{type(error).__name__} in {method.__qualname__}: {error}")
        return None

    return cast(_Function, guard)


def _report(owner: Any, text: str) -> None:
    report = getattr(owner, "report", None)
    if report is not None:
        report(text)
