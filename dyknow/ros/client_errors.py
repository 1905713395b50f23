"""What clients of the manager meet: who did not answer, and why there is no stream.

::

    DyKnowError
    ├── ManagerUnreachable    no master, no manager, or it hangs
    ├── NodeletUnreachable    a nodelet is not there or does not answer; it may have done it
    └── Refused
        └── StreamRefused     the manager did not make a stream
"""

from __future__ import annotations

import enum

from dyknow.errors import DyKnowError, Refused, waiting


class ManagerUnreachable(DyKnowError):
    """There is no ROS master, or no manager that answers; the text says which."""


class NodeletUnreachable(DyKnowError):
    """A nodelet's proxy does not answer; whether it did what was asked for is not known."""


class Result(enum.IntEnum):
    """Why a stream was not made; the numbers are those of ``dyknow_msgs/AcquireStream``."""

    OK = 0
    NO_PLAN = 1
    INVALID_TAG = 2
    TYPE_MISMATCH = 3
    SPAWN_FAILED = 4
    TIMEOUT = 5
    DENIED = 6


class StreamRefused(Refused):
    """The manager did not make a stream.

    Attributes:
        result: why, as a number.
        claim_id: the claim that waits until the stream can be made; empty if there is none.
    """

    def __init__(self, message: str, result: Result, claim_id: str = "") -> None:
        self.result = result
        self.claim_id = claim_id
        super().__init__(message)

    def given_up(self) -> StreamRefused:
        """Return the refusal as it is once the claim was released: nothing waits any more."""
        return StreamRefused(str(self).replace(waiting(self.claim_id), ""), self.result)
