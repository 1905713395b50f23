# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The wiring that a manager loads at its start, once for each life of its state.

The state remembers which file was loaded. A manager that restarts with it restores what there was,
with all later changes of users, and loads the file again only if that has changed. An end on
purpose forgets the nodelets, and the file with them.
"""

from __future__ import annotations

import hashlib
import time
from typing import Callable

import rospy

from dyknow.backoff import Backoff
from dyknow.errors import BadParameter, DyKnowError, SpecificationError
from dyknow.manager.store import Store

#: Among the facts of the state, the file that was loaded.
_FACT = "wiring"
#: Seconds before a load that failed is tried again, the first time.
_FIRST_PAUSE = 1.0

#: Checks the content of a file of that name; raises SpecificationError.
Check = Callable[[bytes, str], object]
#: Loads it; raises DyKnowError, and has undone everything.
Load = Callable[[bytes, str], object]


class BootWiring:
    """Loads a file, after pauses that grow, until it is loaded."""

    def __init__(
        self,
        path: str,
        store: Store,
        check: Check,
        load: Load,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Read the file; an empty path is none.

        Raises:
            BadParameter: it cannot be used. If an earlier one was loaded, that is logged alone.
        """
        self._path = path
        self._store = store
        self._load = load
        self._backoff = Backoff(clock, _FIRST_PAUSE, tolerated=0)
        self._data = b""
        self._digest = known = store.number(_FACT)
        self._said = ""
        #: Whether there is something to load.
        self.is_due = False
        if self._path:
            try:
                self._read(check)
            except BadParameter as error:
                if not known:
                    raise
                rospy.logerr("%s; what was loaded before stays", error)

    def work(self) -> float | None:
        """Load it; returns the seconds until the next attempt, None once it is loaded."""
        if not self.is_due:
            return None
        try:
            self._load(self._data, self._path)
        except DyKnowError as error:
            if str(error) != self._said:
                rospy.logwarn("'%s' is not loaded yet: %s; it is tried again", self._path, error)
            self._said = str(error)
            self._backoff.failed(_FACT)
            return self._backoff.remaining(_FACT)
        self._store.write({("facts", _FACT): str(self._digest)})
        self.is_due = False
        rospy.loginfo("loaded '%s'", self._path)
        return None

    def forget(self) -> None:
        """Let the next life of the state load a file again."""
        self._store.write({("facts", _FACT): None})

    def _read(self, check: Check) -> None:
        try:
            with open(self._path, "rb") as file:
                self._data = file.read()
            digest = int(hashlib.sha1(self._data).hexdigest()[:15], 16)
            if digest == self._digest:
                return
            check(self._data, self._path)
        except OSError as error:
            raise self._error(str(error.strerror)) from error
        except SpecificationError as error:
            raise self._error(str(error)) from error
        self._digest, self.is_due = digest, True

    def _error(self, cause: str) -> BadParameter:
        return BadParameter("~wiring", self._path, f"a file as 'dyknow save' writes it; {cause}")
