# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets and claims that are not well."""

from __future__ import annotations

from typing import Iterable, List, Mapping, NamedTuple

from dyknow.model.graph import PortRef, State
from dyknow.model.streams import ClaimState, StreamStatus
from dyknow_rqt.graph.rates import PortRate
from dyknow_rqt.graph.snapshot import Snapshot

_OF_NODELETS = {State.LOST: "lost", State.FAILED: "failed"}
_OF_CLAIMS = {
    ClaimState.FAILED: "failed",
    ClaimState.DEGRADED: "degraded",
    ClaimState.RECOVERING: "degraded",
    ClaimState.PENDING: "waiting",
}
#: The words, the worst first; a nodelet is slow if messages are dropped at its in-ports.
_WORDS = ("lost", "failed", "degraded", "slow", "waiting")


class Ill(NamedTuple):
    """A nodelet or a claim that is not well.

    Attributes:
        word: lost, failed, degraded, slow or waiting.
        title: its name or tag, for people.
        nodelet: its name; empty for a claim.
        claim: its id; empty for a nodelet.
    """

    word: str
    title: str
    nodelet: str = ""
    claim: str = ""


def ills_of(
    snapshot: Snapshot, streams: Iterable[StreamStatus], traffic: Mapping[PortRef, PortRate]
) -> List[Ill]:
    """List the nodelets and claims in a bad state, the worst first, each once."""
    slow = {ref.nodelet for ref, each in traffic.items() if each.drop_rate > 0}
    words = {name: "slow" for name in slow}
    sick = (each for each in snapshot.nodelets if each.state in _OF_NODELETS)
    words.update((each.name, _OF_NODELETS[each.state]) for each in sick)
    ills = [Ill(word, name, nodelet=name) for name, word in words.items()]
    ills += [
        Ill(_OF_CLAIMS[each.state], each.bound_tag, claim=each.claim_id)
        for each in streams
        if each.state in _OF_CLAIMS
    ]
    return sorted(ills, key=lambda ill: (_WORDS.index(ill.word), ill))
