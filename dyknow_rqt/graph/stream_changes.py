# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Acquiring, releasing and replanning streams, as changes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dyknow.errors import StreamRefused
from dyknow.model.client import BaseManagerClient
from dyknow.model.streams import StreamRequest
from dyknow_rqt.graph.changes import CannotUndo, Change, Library
from dyknow_rqt.graph.snapshot import Snapshot


@dataclass(frozen=True)
class AcquireStream(Change):
    """Acquires a stream; one that is not possible yet is made when it becomes possible.

    Attributes:
        request: the request for the stream.
        claim_id: of the claim; known after the change.
        outcome: what became of it, for people; known after the change.
    """

    request: StreamRequest
    claim_id: str = ""
    outcome: str = ""

    @property
    def text(self) -> str:
        """The change in words."""
        return f"acquire {self.request.tag}" + (f": {self.outcome}" if self.outcome else "")

    def apply(self, client: BaseManagerClient) -> Change:
        """Ask for it."""
        try:
            got = client.acquire_stream(self.request)
        except StreamRefused as error:
            if not error.claim_id:
                raise
            return replace(self, claim_id=error.claim_id, outcome=f"waits, {error}")
        return replace(self, claim_id=got.claim_id, outcome=f"on {got.topic}")

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Release it."""
        return ReleaseStream(self.claim_id, self.request.tag)


@dataclass(frozen=True)
class ReleaseStream(Change):
    """Ends a claim."""

    claim_id: str
    tag: str

    @property
    def text(self) -> str:
        """The change in words."""
        return f"release {self.tag}"

    def apply(self, client: BaseManagerClient) -> Change:
        """Release it."""
        client.release_stream(self.claim_id)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """A released claim cannot be restored."""
        raise CannotUndo("a stream that is acquired again is another one, on a topic of its own")


@dataclass(frozen=True)
class ReplanStream(Change):
    """Switches a stream to the plan that is the cheapest now."""

    claim_id: str
    tag: str

    @property
    def text(self) -> str:
        """The change in words."""
        return f"replan {self.tag}"

    def apply(self, client: BaseManagerClient) -> Change:
        """Replan it."""
        client.replan_stream(self.claim_id)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """A more expensive plan cannot be restored."""
        raise CannotUndo("the way before was not the cheapest")
