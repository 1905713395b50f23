# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The output of ``dyknow list --hosts``."""

from __future__ import annotations

import math
import time
from typing import Iterator, Sequence

from dyknow.cli.output import Json, columns, picked
from dyknow.model.hosts import HostStatus

_HEAD = ("HOST", "ADDRESS", "STATE", "LOAD", "MEMORY", "CLOCK", "MANAGERS", "NODELETS")


def host_json(host: HostStatus) -> Json:
    """A host; times in s, load and memory as shares, null where they are not known."""
    named = "name address own=is_own away=is_away lasts managers nodelets pinned cores pause"
    numbers = {
        "load": host.load,
        "memory": host.memory,
        "offset": host.offset,
        "offset_error": host.error,
    }
    known = {key: None if math.isnan(value) else value for key, value in numbers.items()}
    return {**picked(host, named), **known}


def host_table(hosts: Sequence[HostStatus], now: float) -> Iterator[str]:
    """Write a line for each host; a host is away since some time before ``now`` (s)."""
    rows: list[tuple[object, ...]] = [_HEAD]
    for each in hosts:
        rows.append(
            (
                each.name,
                each.address or None,
                _state(each, now),
                _percent(each.load),
                _percent(each.memory),
                "own" if each.is_own else _clock(each),
                ", ".join(each.managers) or None,
                len(each.nodelets),
            )
        )
    yield from columns(rows, right=(3, 4, 5, 7))
    for each in hosts:
        if each.pause:
            yield (
                f"{each.name}: it was away repeatedly; for {each.pause:.0f} s nothing new is "
                "placed there if there is another host"
            )


def _state(host: HostStatus, now: float) -> str:
    if not host.is_away:
        return "here"
    return f"away since {time.strftime('%H:%M:%S', time.localtime(now - host.lasts))}"


def _percent(share: float) -> str | None:
    return None if math.isnan(share) else f"{share:.0%}"


def _clock(host: HostStatus) -> str | None:
    """Milliseconds by which the clock is ahead, and by which that may be wrong."""
    if math.isnan(host.offset):
        return None
    return f"{host.offset * 1e3:+.1f} ms ± {host.error * 1e3:.1f}"
