# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bonds with the clients of claims: a bond that breaks ends the claims that name it.

Both ends speak on the manager's topic ``~bond``, as with nodelet managers. Bonds outlive a manager
that is killed: the next one waits for each client to be heard, for as long as bonds do.
"""

from __future__ import annotations

import time
from typing import Callable, Iterable

import rospy

from dyknow import names
from dyknow.errors import DyKnowError
from dyknow.locks import state_lock, turn_lock
from dyknow.manager.claim import Claim
from dyknow.ros.bonding.bonds import TOPIC, Bonds


class ClaimBonds:
    """Has one bond for each id that a claim names; every method is safe from any thread."""

    def __init__(
        self,
        claims: Callable[[], Iterable[Claim]],
        expire: Callable[[str, str], None],
        running: Callable[[], float] = time.monotonic,
    ) -> None:
        """Make it without bonds.

        ``claims`` returns the present claims, ``expire`` ends one, given its id and a reason, and
        ``running`` is the time for which this process has run (s).
        """
        self._claims = claims
        self._expire = expire
        self._bonds = Bonds(names.join(rospy.get_name(), TOPIC), clock=running)
        self.close = self._bonds.close
        #: Changes of claims are followed in turn: the last one decides.
        self._turn = turn_lock("bonds of claims")
        self._state_lock = state_lock("claims by bond")
        self._held: dict[str, set[str]] = {}

    def follow(self) -> None:
        """Watch over the clients of the present claims."""
        with self._turn:
            wanted: dict[str, set[str]] = {}
            for claim in self._claims():
                if claim.request.bond_id and not claim.state.ended:
                    wanted.setdefault(claim.request.bond_id, set()).add(claim.claim_id)
            with self._state_lock:
                new = sorted(set(wanted) - set(self._held))
                old = sorted(set(self._held) - set(wanted))
                self._held = wanted
            for bond_id in old:
                self._bonds.remove(bond_id)
            for bond_id in new:
                self._add(bond_id)

    def _add(self, bond_id: str) -> None:
        try:
            self._bonds.add(bond_id, lambda: self._on_broken(bond_id))
        except DyKnowError as error:
            rospy.logwarn("bond '%s' of a stream's client: %s", bond_id, error)

    def _on_broken(self, bond_id: str) -> None:
        with self._state_lock:
            claims = sorted(self._held.pop(bond_id, ()))
        for claim_id in claims:
            self._expire(claim_id, "the bond with its client broke")
