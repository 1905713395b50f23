# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What lives as long as its client: nodelets of a nodelet manager, and claims of a manager."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Callable, Iterable

import rospy

from dyknow import names
from dyknow.errors import DyKnowError
from dyknow.locks import state_condition, state_lock, turn_lock
from dyknow.nodelet.context import Context
from dyknow.ros.bonding.bonds import TOPIC, Bonds

if TYPE_CHECKING:
    from dyknow.manager.claim import Claim


class BondedNodelets:
    """Unloads nodelets whose bond is broken, and breaks the bond of those that are unloaded.

    They are told apart by their contexts: another nodelet may have the name of one that ends, and
    a bond of its own.
    ``unload`` unloads a nodelet; it raises DyKnowError if that is done already.
    """

    def __init__(self, bonds: Bonds, unload: Callable[[Context], None]) -> None:
        self._bonds = bonds
        self._unload = unload
        self._changed = state_condition("bonded nodelets")
        self._ids: dict[Context, str] = {}

    def add(self, context: Context, bond_id: str) -> None:
        """Bond a nodelet; one that cannot be is unloaded."""
        with self._changed:
            self._ids[context] = bond_id  # first: the bond may break at once
        try:
            self._bonds.add(bond_id, lambda: self._broken(context))
        except BaseException:
            with self._changed:
                self._ids.pop(context, None)
            self._unload(context)
            raise
        if context.closed:  # unloaded in between
            self.ended(context)

    def ended(self, context: Context) -> None:
        """Break the bond of a nodelet that is unloaded, if it has one."""
        with self._changed:
            bond_id = self._ids.pop(context, None)
            self._changed.notify_all()
        if bond_id is not None:
            self._bonds.remove(bond_id)

    def wait(self, seconds: float) -> None:
        """Wait until none is left, or so long."""
        with self._changed:
            self._changed.wait_for(lambda: not self._ids, seconds)

    def _broken(self, context: Context) -> None:
        with self._changed:
            if context not in self._ids:
                return
        rospy.loginfo("the bond of nodelet %s is broken: unloading it", context.name)
        try:
            self._unload(context)
        except DyKnowError as error:
            rospy.loginfo("%s", error)


class ClaimBonds:
    """Has one bond for each id that a claim names; every method is safe from any thread.

    Both ends speak on the manager's topic ``~bond``, as with nodelet managers. Bonds outlive a
    manager that is killed: the next one waits for each client to be heard, for as long as bonds
    do.
    """

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
