"""Remote calls with a time limit.

rospy's service and parameter calls have none: a call to a stopped process blocks for as long as
that stays stopped.
"""

from __future__ import annotations

import queue
import threading
from typing import Callable, TypeVar

T = TypeVar("T")


class RemoteCallTimeout(Exception):
    """A remote call took longer than it was given.

    Attributes:
        what: What was called.
        seconds: The time that it was given.
    """

    def __init__(self, what: str, seconds: float) -> None:
        """Take what was called and the time that it was given."""
        super().__init__(f"{what} did not answer within {seconds:g} s")
        self.what = what
        self.seconds = seconds


def call_within(seconds: float, what: str, call: Callable[[], T]) -> T:
    """Make a blocking call, but wait for its end only so long.

    A call that is late goes on in a daemon thread of its own, and its result is dropped.

    Args:
        seconds: How long to wait.
        what: Names the call in the exception, for instance the service.
        call: The call.

    Raises:
        RemoteCallTimeout: It did not end in time.
        Exception: Whatever the call raises.
    """
    results: queue.SimpleQueue[tuple[Exception | None, T | None]] = queue.SimpleQueue()

    def work() -> None:
        try:
            results.put((None, call()))
        except Exception as error:
            results.put((error, None))

    threading.Thread(target=work, name=f"call {what}", daemon=True).start()
    try:
        error, result = results.get(timeout=seconds)
    except queue.Empty:
        raise RemoteCallTimeout(what, seconds) from None
    if error is not None:
        raise error
    return result  # type: ignore[return-value]
