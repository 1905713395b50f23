# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A manager that ends, as by kill -9, before or after any of its effects.

Its effects are what it writes to the store and what it changes through the host.
"""

from __future__ import annotations

from typing import Any, Optional, Tuple

#: Methods of ``Host`` and of ``Store``.
ON_HOST = (
    *("ensure", "retire", "renew", "load", "unload"),
    *("forget", "connect", "set_parameter"),
)
ON_DISK = ("write", "write_later", "write_pending", "end")


class Killed(BaseException):
    """The manager is killed here; nothing that it does from now on has an effect."""


class Life:
    """One life of a manager, which ends at a moment; there are two for each effect.

    Attributes:
        moments: how many have gone by.
        end: the moment at which it ends; None for never.
    """

    def __init__(self, end: Optional[int] = None) -> None:
        self.moments = 0
        self.end = end

    def go_on(self) -> None:
        """Raise if this life has ended."""
        if self.end is not None and self.moments >= self.end:
            raise Killed

    def pass_moment(self) -> None:
        self.moments += 1
        self.go_on()


class Mortal:
    """Stands for a host or a store as long as a life goes on."""

    def __init__(self, real: object, life: Life, effects: Tuple[str, ...]) -> None:
        self._real = real
        self._life = life
        self._effects = effects

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._real, name)
        if not callable(found):
            return found

        def call(*args: Any, **kwds: Any) -> Any:
            self._life.go_on()
            if name in self._effects:
                self._life.pass_moment()
            result = found(*args, **kwds)
            if name in self._effects:
                self._life.pass_moment()
            return result

        return call
