"""Why the manager or a nodelet did not do what a program asked for.

::

    DyKnowError
    ├── Unreachable   no master, no manager, or it hangs
    ├── Silent        a nodelet is not there or does not answer; what was asked may be done
    └── Refused       the answer was no, and nothing was done; the text is the server's
"""

from __future__ import annotations

from dyknow.errors import DyKnowError


class Unreachable(DyKnowError):
    """There is no ROS master, or no manager that answers; the text says which."""


class Refused(DyKnowError):
    """A service answered that it did not do what was asked for, and why."""


class Silent(DyKnowError):
    """A nodelet's proxy does not answer; whether it did what was asked for is not known."""
