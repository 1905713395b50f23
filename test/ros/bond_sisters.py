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
    for bond in bonds:
        bond.start()
    rospy.on_shutdown(lambda: [bond.break_bond() for bond in bonds])
    rospy.spin()


if __name__ == "__main__":
    sys.exit(main())
