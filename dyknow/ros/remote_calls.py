# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Remote calls with a time limit.

rospy's service and parameter calls have none: a call to a stopped process blocks for as long as
that stays stopped.
"""

from __future__ import annotations

import queue
from typing import Callable, TypeVar

from dyknow.errors import PeerTimeout
from dyknow.locks import assert_no_state_lock
from dyknow.periodic import in_background

T = TypeVar("T")


def call_within(seconds: float, what: str, call: Callable[[], T]) -> T:
    """Make a blocking call, and wait for its end at most so long.

    A call that is late goes on in the background, and its result is dropped.

    Args:
        seconds: How long to wait.
        what: Names the call in the exception, for instance the service.
        call: The call.

    Raises:
        PeerTimeout: It did not end in time.
        Exception: Whatever the call raises.
    """
    assert_no_state_lock(f"calling {what}")
    results: queue.SimpleQueue[tuple[Exception | None, T | None]] = queue.SimpleQueue()

    def work() -> None:
        try:
            results.put((None, call()))
        except Exception as error:
            results.put((error, None))

    in_background(f"call {what}", work)
    try:
        error, result = results.get(timeout=seconds)
    except queue.Empty:
        raise PeerTimeout(what, seconds) from None
    if error is not None:
        raise error
    return result  # type: ignore[return-value]
