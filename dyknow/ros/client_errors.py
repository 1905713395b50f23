"""Who did not answer a command of the shell.

::

    DyKnowError
    ├── Unreachable   no master, no manager, or it hangs
    └── Silent        a nodelet is not there or does not answer; what was asked may be done
"""

from __future__ import annotations

from dyknow.errors import DyKnowError


class Unreachable(DyKnowError):
    """There is no ROS master, or no manager that answers; the text says which."""


class Silent(DyKnowError):
    """A nodelet's proxy does not answer; whether it did what was asked for is not known."""
