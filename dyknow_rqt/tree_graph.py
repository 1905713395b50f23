# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A made-up graph of many nodelets, for pictures, tests and measurements."""

from __future__ import annotations

from dyknow.model.client import BaseManagerClient
from dyknow_rqt.simulated import SimulatedRemote

_RELAY = (
    "<transformation><label>relay</label><source>dyknow/Relay</source><ports>"
    '<port type="in">in</port><port type="out">out</port></ports></transformation>'
)


def tree(count: int) -> SimulatedRemote:
    """A simulated manager with so many nodelets."""
    remote = SimulatedRemote()
    remote.client.add_transformation(_RELAY)
    for number in range(count):
        spawn_relay(remote.client, number)
    return remote


def spawn_relay(client: BaseManagerClient, number: int) -> None:
    """Spawn the next relay of a tree.

    There are ten in a namespace, where each leads to two of them; a namespace leads to five.
    """
    group, place = divmod(number, 10)
    topics = {"out": f"/part{group}/stream{place}"}
    if number:
        source = (group, (place - 1) // 2) if place else ((group - 1) // 5, 9)
        topics["in"] = "/part{}/stream{}".format(*source)
    client.spawn("relay", f"/part{group}/nodelet{place}", topics)
