# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which nodelet manager a nodelet goes to."""

from __future__ import annotations

import collections
from typing import Dict, Iterable, List, Optional

from dyknow.errors import HostError
from dyknow.manager.host import Host
from dyknow.manager.record import Record, topics_of
from dyknow.model.graph import NodeletKind


def choose(
    host: Host,
    records: Iterable[Record],
    kind: NodeletKind,
    topics: Iterable[str],
    asked: str = "",
    isolated_for: str = "",
) -> str:
    """Choose, and start if need be, a nodelet manager for a new nodelet.

    It is the one that was asked for; else a new process for an isolated nodelet; else the one that
    runs most neighbours of the nodelet, since messages go by reference there; else the one that
    runs fewest nodelets. One without live ports is used only if it was asked for, or if the host
    can start no other.

    Raises:
        HostError: the manager asked for is unknown, down, of the other kind or there for another
            nodelet alone, or a process for the nodelet alone was asked for as well.
    """
    if asked and kind.is_node:
        raise HostError(
            f"a {kind.title} has a process of its own, and is in no nodelet manager such as "
            f"'{asked}'"
        )
    if asked and isolated_for:
        raise HostError(
            f"'{isolated_for}' cannot be isolated in nodelet manager '{asked}': "
            "expected a process of its own or a named one, not both"
        )
    if asked:
        host.look_for(asked)
    states = {state.name: state for state in host.managers()}
    if asked:
        state = states.get(asked)
        if state is None:
            known = ", ".join(sorted(states)) or "none"
            raise HostError(f"unknown nodelet manager '{asked}'; known: {known}")
        if state.isolated_for:
            raise HostError(f"nodelet manager '{asked}' is there for '{state.isolated_for}' alone")
        if not state.alive:
            what = "does not answer" if state.away else "is not running"
            raise HostError(f"nodelet manager '{asked}' {what}")
        if state.kind is not kind.host:
            raise HostError(
                f"'{asked}' hosts no {kind.title}s: it is there for a {state.kind.title}"
            )
        return asked
    if isolated_for:
        return host.ensure(kind.host, isolated_for)
    shared = [
        name
        for name, state in sorted(states.items())
        if state.alive
        and state.responsive
        and state.rewirable
        and state.kind is kind.host
        and not state.isolated_for
    ]
    best = _nearest(list(records), shared, set(topics))
    return best if best is not None else host.ensure(kind.host)


def _nearest(records: List[Record], shared: List[str], topics: set[str]) -> Optional[str]:
    if not shared:
        return None
    load: Dict[str, int] = collections.Counter(record.manager for record in records)
    near: Dict[str, int] = collections.Counter(
        record.manager
        for record in records
        if topics & (set(topics_of(record).values()) | set(record.topics.values()))
    )
    return min(shared, key=lambda name: (-near.get(name, 0), load.get(name, 0), name))
