# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets of a nodelet manager that live as long as their clients.

They are told apart by their contexts: another nodelet may have the name of one that ends, and a
bond of its own.
"""

from __future__ import annotations

from typing import Callable

import rospy

from dyknow.errors import DyKnowError
from dyknow.locks import state_condition
from dyknow.nodelet.context import Context
from dyknow.ros.bonding.bonds import Bonds


class BondedNodelets:
    """Unloads nodelets whose bond is broken, and breaks the bond of those that are unloaded.

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
