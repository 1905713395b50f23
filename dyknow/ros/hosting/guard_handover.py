# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Hands the guards of a DyKnow manager to the nodelet managers that enforce them.

With the guards go the names of the nodelets that only this DyKnow manager may unload
(``dyknow.ros.nodelets.guard_parameters``). Guards that are missing, or were changed by another
program, are handed over again. Stock nodelet managers enforce nothing and are left out.
"""

from __future__ import annotations

import contextlib
import logging
from typing import Collection, Dict, Mapping, Sequence, Tuple

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.guards import Guards
from dyknow.locks import state_lock
from dyknow.manager.host import ManagerState
from dyknow.periodic import STEADY, Clock
from dyknow.ros.master import Master
from dyknow.ros.nodelets.guard_parameters import guards_key, to_parameter

#: Seconds between two looks whether the guards are still there.
PERIOD = 1.0

_log = logging.getLogger("rosout.dyknow")


class GuardHandover:
    """Which nodelet managers have the guards; every method is safe from any thread."""

    def __init__(self, master: Master, guards: Guards, clock: Clock = STEADY) -> None:
        """Hand over nothing yet.

        Args:
            master: keeps the parameters; its caller is whose guards these are.
            guards: what is handed over.
            clock: says when to look whether they are still there.
        """
        self._clock = clock
        self._master = master
        self._guards = guards
        self._key = guards_key(master.caller)
        self._state_lock = state_lock("handover of guards")
        #: Nodelets that are protected, by nodelet manager.
        self._protected: Dict[str, Tuple[str, ...]] = {}
        #: Incarnations that have the guards, and the nodelets named to them.
        self._done: Dict[str, Tuple[str, Tuple[str, ...]]] = {}
        #: When they were last seen to have them.
        self._seen: Dict[str, float] = {}
        #: Nodelet managers that could not be given the guards yet, and why.
        self._failed: Dict[str, str] = {}

    def protect(self, nodelets: Mapping[str, Sequence[str]]) -> None:
        """Set the protected nodelets, by nodelet manager; they go with the next hand-over."""
        with self._state_lock:
            self._protected = {each: tuple(sorted(nodelets[each])) for each in nodelets}

    def hand_over(self, manager: ManagerState) -> None:
        """Hand the guards to a nodelet manager that does not have them as they are now.

        A failure is logged, and tried again by the next call.
        """
        if not manager.alive or not manager.rewirable:
            return
        name, now = manager.name, self._clock.now()
        with self._state_lock:
            protected = self._protected.get(name, ())
            is_known = self._done.get(name) == (manager.incarnation, protected)
            if is_known and now - self._seen[name] < PERIOD:
                return
            self._seen[name] = now
        key, parameter = names.join(name, self._key), to_parameter(self._guards, protected)
        try:
            if is_known and self._present(key) == parameter:
                return
            self._master.ask("setParam", key, parameter)
        except (PeerTimeout, LookupError) as error:
            with self._state_lock:
                is_news = name not in self._failed
                self._failed[name] = str(error)
            if is_news:
                _log.warning("%s cannot be given the guards yet: %s", name, error)
            return
        with self._state_lock:
            self._done[name] = (manager.incarnation, protected)
            had_failed = self._failed.pop(name, None) is not None
        if had_failed:
            _log.info("%s has the guards now", name)
        elif is_known:
            _log.warning("%s: the guards were missing or changed, and are set again", name)

    def check(self, manager: str) -> None:
        """Refuse to load where the guards could not be handed over.

        Raises:
            HostError: they could not.
        """
        with self._state_lock:
            why = self._failed.get(manager)
        if why is not None:
            raise HostError(f"nodelet manager '{manager}' does not have the guards yet: {why}")

    def keep(self, managers: Collection[str]) -> None:
        """Forget all other nodelet managers: they are gone for good."""
        with self._state_lock:
            for table in (self._done, self._seen, self._failed):
                for name in [name for name in table if name not in managers]:
                    del table[name]

    def _present(self, key: str) -> object:
        try:
            return self._master.ask("getParam", key)
        except LookupError:
            return None

    def withdraw(self, manager: str) -> None:
        """Take the guards off a nodelet manager, as far as the master answers."""
        with contextlib.suppress(LookupError, PeerTimeout):
            self._master.ask("deleteParam", names.join(manager, self._key))
