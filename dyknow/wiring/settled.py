# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Whether everything of a wiring runs."""

from __future__ import annotations

from typing import Iterator, Sequence

from dyknow.model.graph import Model, State
from dyknow.model.streams import ClaimState, StreamStatus
from dyknow.wiring.wiring import Wiring


def unsettled(wiring: Wiring, model: Model, streams: Sequence[StreamStatus]) -> Iterator[str]:
    """Say what of a wiring does not run, and which claims that use it are not active."""
    wanted = {each.name for each in wiring.nodelets}
    for name in sorted(wanted):
        nodelet = model.nodelet(name)
        if nodelet is None:
            yield f"nodelet '{name}' is not there"
        elif nodelet.state is not State.RUNNING:
            why = f": {nodelet.detail}" if nodelet.detail else ""
            yield f"nodelet '{name}' is {nodelet.state.name.lower()}{why}"
    for claim in streams:
        is_active = claim.state is ClaimState.ACTIVE or claim.state.ended
        if not (is_active or wanted.isdisjoint(claim.nodelets)):
            why = f": {claim.detail}" if claim.detail else ""
            yield f"claim {claim.claim_id}, {claim.tag}, is {claim.state.name.lower()}{why}"
