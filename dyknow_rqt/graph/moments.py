# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The graph over time: moments, and the difference of two of them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Iterator, Mapping, Sequence

from dyknow.model.graph import NodeletStatus, PortRef
from dyknow.model.streams import StreamStatus
from dyknow_rqt.graph.snapshot import Snapshot

#: The most moments that are kept, and seconds within which changes are one.
_MOST, _TOGETHER = 300, 0.5


@dataclass(frozen=True)
class GraphMoment:
    """The graph and the claims after a change; ``time`` is in seconds since 1970."""

    time: float
    snapshot: Snapshot
    streams: tuple[StreamStatus, ...] = ()

    @property
    def essence(self) -> object:
        """The part that tells moments apart, without details that change by themselves."""
        claims = [(s.claim_id, s.state, s.topic, s.nodelets) for s in self.streams]
        return self.snapshot.nodelets, claims


@dataclass(frozen=True)
class Difference:
    """What came, went, moved and was mended since an earlier moment, and all of it in words.

    Ports move when they are connected elsewhere; nodelets of claims are mended by others.
    """

    came: frozenset[str] = frozenset()
    went: frozenset[str] = frozenset()
    moved: frozenset[PortRef] = frozenset()
    mended: tuple[tuple[str, str], ...] = ()
    lines: tuple[str, ...] = ()


class Moments:
    """The last moments, oldest first."""

    def __init__(self) -> None:
        self.all: deque[GraphMoment] = deque(maxlen=_MOST)

    def note(self, moment: GraphMoment) -> bool:
        """Note a moment; returns whether it differs from the last one."""
        moment = replace(moment, snapshot=replace(moment.snapshot))  # without its cached values
        if self.all and moment.essence == self.all[-1].essence:
            return False
        if len(self.all) > 1 and moment.time - self.all[-1].time < _TOGETHER:
            self.all[-1] = replace(moment, time=self.all[-1].time)
        else:
            self.all.append(moment)
        return True


def difference(before: GraphMoment, after: GraphMoment) -> Difference:
    old = {each.name: each for each in before.snapshot.nodelets}
    new = {each.name: each for each in after.snapshot.nodelets}
    came, went = frozenset(new.keys() - old.keys()), frozenset(old.keys() - new.keys())
    kept = [(old[name], each) for name, each in new.items() if name in old and old[name] != each]
    moves = {ref: words for pair in kept for ref, words in _moves(*pair)}
    mended = tuple(sorted(_mended(before, after, {**old, **new})))
    lines = [
        *(f"+ {name}" for name in sorted(came)),
        *(f"− {name}" for name in sorted(went)),
        *(f"{was} → {now}: mended" for was, now in mended),
        *(moves[ref] for ref in sorted(moves, key=str)),
        *(f"{b.name}: {_state(a)} → {_state(b)}" for a, b in kept if _state(a) != _state(b)),
        *_streams(before.streams, after.streams),
    ]
    return Difference(came, went, frozenset(moves), mended, tuple(lines))


def _moves(before: NodeletStatus, after: NodeletStatus) -> Iterator[tuple[PortRef, str]]:
    topics = {port.name: port.topic for port in before.ports}
    for port in after.ports:
        was = topics.get(port.name, "")
        if port.topic != was:
            ref = PortRef(after.name, port.name)
            yield ref, f"{ref}: {was or '–'} → {port.topic or '–'}"


def _state(nodelet: NodeletStatus) -> str:
    return nodelet.state.name.lower()


def _mended(
    before: GraphMoment, after: GraphMoment, nodelets: Mapping[str, NodeletStatus]
) -> Iterator[tuple[str, str]]:
    """Pair the parts that claims have lost with those that they have instead, alike first."""
    claims: dict[str, StreamStatus] = {each.claim_id: each for each in before.streams}
    found = set()
    for claim in after.streams:
        was = claims.get(claim.claim_id)
        lost = sorted(set(was.nodelets) - set(claim.nodelets)) if was is not None else []
        for name in sorted(set(claim.nodelets) - set(was.nodelets)) if was is not None else ():

            def is_other(gone: str, name: str = name) -> bool:
                ends = [nodelets.get(each) for each in (gone, name)]
                labels = [each.transformation if each is not None else None for each in ends]
                return labels[0] != labels[1]

            if lost:
                gone = min(lost, key=is_other)
                lost.remove(gone)
                found.add((gone, name))
    yield from found


def _streams(before: Sequence[StreamStatus], after: Sequence[StreamStatus]) -> Iterator[str]:
    old = {each.claim_id: each for each in before}
    for each in after:
        was = old.get(each.claim_id)
        if was is None or was.state is not each.state:
            states = "" if was is None else f"{was.state.name.lower()} → "
            yield f"{each.bound_tag}: {states}{each.state.name.lower()}"
