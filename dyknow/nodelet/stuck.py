# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Callbacks that do not return: of nodelets that run, and of nodelets that were unloaded.

A nodelet with such a callback answers its services and is listed as before, and nothing ends the
callback of a nodelet that was unloaded: Python cannot end a thread. So both are announced.
"""

from __future__ import annotations

import logging
from typing import Callable, Dict, List

from dyknow.nodelet.loader import Loader
from dyknow.periodic import STEADY, Clock, PeriodicWorker

#: Looks in the time after which a callback is reported.
_LOOKS = 4

_log = logging.getLogger("rosout.dyknow")


class StuckCallbacks:
    """Announces the nodelets of a process with callbacks that do not return, and the remains."""

    def __init__(
        self,
        loader: Loader,
        host: str,
        after: float,
        tell: Callable[[str], None],
        clock: Clock = STEADY,
    ) -> None:
        """Begin without nodelets.

        Args:
            loader: has the nodelets.
            host: the node that the process is, for advice.
            after: seconds after which a callback that has not returned is reported.
            tell: called with the name of a nodelet whose ``detail`` has changed.
            clock: steady time between the looks.
        """
        self._loader = loader
        self._host = host
        self._tell = tell
        self._after = after
        self._due: Dict[str, float] = {}  # age at which a nodelet is announced again
        self._remains_due: Dict[str, float] = {}
        self._worker = PeriodicWorker(
            "looking for callbacks that do not return",
            self.look,
            self._after / _LOOKS,
            clock=clock,
        )
        self.start = self._worker.start
        self.close = self._worker.close

    def look(self) -> None:
        """Announce what has changed; what goes on, each time that its age has doubled."""
        ages = {each.name: each.callback_age() for each in self._loader.contexts()}
        before = set(self._due)
        told = _due_now(self._due, ages, self._after)
        for name in sorted({*told, *(before - set(self._due)) & set(ages)}):
            self._tell(name)
        running = dict(self._loader.leftovers.running())
        for name in _due_now(self._remains_due, running, self._after):
            _log.warning("%s; %s", _remains_text(name, running[name]), self.cure)

    def detail(self, nodelet: str) -> str:
        """Describe a nodelet's callback that does not return; empty if it has none."""
        ages = {each.name: each.callback_age() for each in self._loader.contexts()}
        age = ages.get(nodelet, 0.0)
        return f"a callback has been running for {age:.0f} s" if age >= self._after else ""

    def remains(self) -> List[str]:
        """Return what still runs of nodelets that were unloaded, a line for each."""
        return [_remains_text(name, age) for name, age in self._loader.leftovers.running()]

    @property
    def cure(self) -> str:
        """What a user can do about the remains."""
        return (
            f"it ends with its process alone: rosnode kill {self._host}, which a DyKnow manager "
            "starts again with the other nodelets; spawn such a nodelet isolated"
        )


def _remains_text(name: str, age: float) -> str:
    return f"{name} was unloaded, but code of it has been running for {age:.0f} s"


def _due_now(due: Dict[str, float], ages: Dict[str, float], after: float) -> List[str]:
    """Return the names that are to be announced, and note when each is again."""
    for name in [name for name in due if ages.get(name, 0.0) < after]:
        del due[name]
    now = [name for name, age in sorted(ages.items()) if age >= due.get(name, after)]
    due.update({name: 2.0 * ages[name] for name in now})
    return now
