# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Random delays where threads begin, wake up, wake others and log, as a busy machine makes them.

They find tests that depend on the moment when a thread gets the processor: most delays are below
0.03 s, rare ones up to 0.6 s.
"""

from __future__ import annotations

import functools
import logging
import random
import sys
import threading
import time
from typing import Any, Callable

_random = random.Random()
_sleep = time.sleep


def install() -> None:
    """Delay the threads of this process from now on."""
    sys.setswitchinterval(0.0005)
    for owner, method, before, after in (
        (threading.Thread, "start", 0.0, 0.2),
        (threading.Thread, "run", 0.6, 0.0),
        (threading.Condition, "wait", 0.0, 0.1),
        (threading.Condition, "notify", 0.03, 0.0),
        (threading.Event, "set", 0.0, 0.2),
    ):
        setattr(owner, method, _delayed(getattr(owner, method), before, after))
    logging.setLogRecordFactory(_delayed(logging.getLogRecordFactory(), 0.1, 0.0))


def _delayed(method: Callable[..., Any], before: float, after: float) -> Callable[..., Any]:
    """Return a method with a delay before and after it, each with a probability."""

    @functools.wraps(method)
    def delayed(*args: Any, **kwds: Any) -> Any:
        _delay(before)
        try:
            return method(*args, **kwds)
        finally:
            _delay(after)

    return delayed


def _delay(probability: float) -> None:
    drawn = _random.random()
    if drawn < probability:
        _sleep(_random.random() * (0.6 if drawn < 0.03 * probability else 0.03))
