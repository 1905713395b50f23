# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A node ends when another one has registered under its name.

The master tells it so at that moment, but only once. A node that is cut off just then never hears
of it, and its nodelets would go on publishing beside those of its successor.
"""

from __future__ import annotations

from typing import Callable

from dyknow.errors import PeerTimeout
from dyknow.periodic import PeriodicWorker
from dyknow.ros.master import Master

#: Seconds between two questions to the master, and for its answer.
PERIOD = 1.0


def end_when_displaced(name: str, uri: str, end: Callable[[str], None]) -> None:
    """Ask the master from time to time, in a thread of its own, which node bears a name.

    A master that is away, or knows no node of that name, changes nothing.

    Args:
        name: of this node.
        uri: its address.
        end: called once with the reason when the master has another address.
    """
    master = Master(name, timeout=PERIOD)

    def look() -> None:
        if _is_displaced(master, name, uri):
            worker.close()
            end(f"another node bears the name {name} now")

    worker = PeriodicWorker("looking who bears the name of this node", look, PERIOD)
    worker.start()
    worker.wake()


def _is_displaced(master: Master, name: str, uri: str) -> bool:
    try:
        return master.node(name) not in ("", uri)
    except PeerTimeout:
        return False
