# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How a stream is made now, as a tree of words."""

from __future__ import annotations

from typing import FrozenSet, Iterator

from dyknow.model.streams import StreamStatus
from dyknow.model.transformation import IN
from dyknow_rqt.graph.snapshot import Snapshot


def way_of(stream: StreamStatus, snapshot: Snapshot) -> str:
    """Write the nodelets of a claim behind each other, from its topic to its sources."""
    parts = [
        stream.bound_tag,
        f"on {stream.topic}" if stream.topic else "",
        stream.state.name.lower(),
    ]
    title = ", ".join(part for part in parts if part)
    lines = _lines(stream.topic, frozenset(stream.nodelets), snapshot, frozenset())
    return "\n".join([title + (f": {stream.detail}" if stream.detail else ""), *lines])


def _lines(
    topic: str, members: FrozenSet[str], snapshot: Snapshot, seen: FrozenSet[str]
) -> Iterator[str]:
    found = snapshot.topics().get(topic)
    refs = [ref for ref in (found.sources if found is not None else ()) if ref.nodelet in members]
    for number, ref in enumerate(refs):
        is_last = number == len(refs) - 1
        nodelet = snapshot.nodelet(ref.nodelet)
        made = f" ({nodelet.transformation})" if nodelet is not None else ""
        yield f"{'└─' if is_last else '├─'} {ref.nodelet}.{ref.port}{made}"
        inputs = [p.topic for p in (nodelet.ports if nodelet else ()) if p.direction == IN]
        for source in dict.fromkeys(inputs):
            if source and source not in seen:
                for line in _lines(source, members, snapshot, seen | {source, topic}):
                    yield f"{'   ' if is_last else '│  '}{line}"
