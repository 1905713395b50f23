#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The other ends of some bonds, made with python3-bondpy: `bond_sisters.py TOPIC ID...`.

Prints "formed ID" and "broken ID" as it happens; SIGINT breaks the bonds from this side.
"""

from __future__ import annotations

import sys

import rospy
from bondpy.bondpy import Bond


def main() -> None:
    rospy.init_node("bond_sisters", anonymous=True)
    topic, *bond_ids = rospy.myargv()[1:]
    bonds = [
        Bond(
            topic,
            bond_id,
            on_broken=lambda b=bond_id: print("broken", b),
            on_formed=lambda b=bond_id: print("formed", b),
        )
        for bond_id in bond_ids
    ]

    def part() -> None:
        for bond in bonds:
            bond.break_bond()
        for bond in bonds:  # rospy may drop what is still queued when it ends
            bond.wait_until_broken(rospy.Duration(5))

    rospy.on_shutdown(part)
    for bond in bonds:
        bond.start()
    rospy.spin()


if __name__ == "__main__":
    sys.exit(main())
