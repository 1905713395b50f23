# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The guards of this process: those that each DyKnow manager hands over with its polls.

The guards of all managers add up: none lifts what another denies, and each takes away only its
own. With them go the names of the nodelets that a manager protects from being unloaded by other
nodes. A process that a DyKnow manager starts has its guards in the environment, from the start.
"""

from __future__ import annotations

import os
from typing import Any, Mapping

from dyknow_msgs.msg import Guards as GuardsMessage

from dyknow.errors import Denied, ProtectedFromUnloading
from dyknow.guards import NO_GUARDS, NOT_REWIRABLE, Guards, together
from dyknow.locks import state_lock
from dyknow.ros.transport.conversions import packed
from dyknow.ros.wire.messages import guards_from

#: Environment variable of programs that a DyKnow manager starts: its guards bind them from their
#: start. What people launch begins where they say, and is bound when it is connected elsewhere.
SPAWNED = "DYKNOW_SPAWNED"
#: Environment variable with a manager and its guards, serialised, in hexadecimal digits.
_GUARDS = "DYKNOW_GUARDS"


def to_environment(owner: str, guards: GuardsMessage) -> dict[str, str]:
    """Return the environment of a process with the guards of a manager."""
    return {_GUARDS: f"{owner} {packed(guards).hex()}"}


class ProcessGuards:
    """The guards of this process, by manager; every method is safe from any thread."""

    def __init__(self, rewirable: bool = True) -> None:
        """Take those of the environment; ``rewirable``: whether ports may be connected."""
        self._rewirable = rewirable
        self._state_lock = state_lock("guards of this process")
        self._handed: Mapping[str, GuardsMessage] = {}
        self._guards: Mapping[str, Guards] = {}
        self._all = NO_GUARDS
        #: The DyKnow manager that started this process; empty for none.
        self.owner, _, digits = os.environ.get(_GUARDS, "").partition(" ")
        if digits:
            self.hand_over(self.owner, GuardsMessage().deserialize(bytes.fromhex(digits)))

    def hand_over(self, owner: str, guards: GuardsMessage) -> None:
        """Take the guards of a manager, in place of those that it handed over before."""
        with self._state_lock:
            self._handed = {**self._handed, owner: guards}
            self._guards = {key: guards_from(each) for key, each in self._handed.items()}
            self._all = together(self._guards.values())

    def current(self) -> Guards:
        """Return the guards of this moment, those of all managers together."""
        return self._all

    def check_caller(self, caller: str, what: str) -> None:
        """Raise Denied in read-only mode, unless a read-only DyKnow manager makes the change.

        Such a manager refuses the requests of users, and still restores nodelets that died.
        """
        if not self._guards.get(caller, NO_GUARDS).read_only:
            self._all.check_writable(what)

    def check_rewiring(self, caller: str, what: str) -> None:
        """Raise Denied if ports may not be connected elsewhere, by any node or by this one."""
        if not self._rewirable:
            raise Denied(what, NOT_REWIRABLE)
        self.check_caller(caller, what)

    def check_program(self, caller: str, program: str) -> None:
        """Raise Denied for a script; a DyKnow manager has checked its own guards."""
        if program.startswith("/"):
            raise Denied(f"script '{program}'", "expected PACKAGE/SCRIPT, not a path")
        together(each for owner, each in self._guards.items() if owner != caller).check_program(
            program
        )

    def check_protection(self, caller: str, name: str) -> None:
        """Raise ProtectedFromUnloading if another DyKnow manager than the caller protects it."""
        for owner, guards in self._handed.items():
            if owner != caller and name in guards.protected_nodelets:
                raise ProtectedFromUnloading(name)


def caller_of(request: Any) -> str:
    """Name of the node that made a request to a service."""
    return str((getattr(request, "_connection_header", None) or {}).get("callerid", ""))
