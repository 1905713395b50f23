# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Remote calls with a time limit.

rospy's service and parameter calls have none: a call to a stopped process blocks for as long as
that stays stopped.
"""

from __future__ import annotations

from concurrent.futures import Future, wait
from typing import Callable, TypeVar

from dyknow.errors import PeerTimeout
from dyknow.locks import assert_no_state_lock
from dyknow.periodic import in_background

T = TypeVar("T")


def call_within(seconds: float, what: str, call: Callable[[], T]) -> T:
    """Make a blocking call in another thread, and wait for its result.

    A call that is late goes on in the background, and its result is dropped.

    Args:
        seconds: The time limit.
        what: Names the call in the exception, for instance the service.
        call: The call.

    Raises:
        PeerTimeout: It did not end in time.
        Exception: Any exception of the call.
    """
    assert_no_state_lock(f"calling {what}")
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(call())
        except Exception as error:
            future.set_exception(error)

    in_background(f"call {what}", work)
    if not wait([future], seconds).done:
        raise PeerTimeout(what, seconds)
    return future.result()
