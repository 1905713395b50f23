# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts that decide which parts are used, and whether a stream is good enough.

A transformation may *require* verdicts, by their tags. While one is FALSE it is not available: no
plan uses it, and its nodelets count as lost. It is available again when the verdict has been TRUE
for some time, so nothing flaps. The verdicts come from claims of the manager's own: on those that
transformations require which could have a part in the stream of a claim, and on no other verdict.
FALSE counts until the verdict is TRUE, as long as a claim lives that could depend on it: even if
an input of its stream is away meanwhile, or the manager is killed.

A request may require a formula about its own stream, which a nodelet evaluates on the client's
topic.
"""

from __future__ import annotations

import json
import uuid
from typing import Callable, Mapping

from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.ends import VERDICTS
from dyknow.manager.claims.world import World
from dyknow.manager.host import HeardVerdict
from dyknow.manager.planning.problem import NO_VERDICTS, Verdicts, canonical_tag, required_tags
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import Term, parse_tag
from dyknow.manager.store import BAD_VERDICTS
from dyknow.manager.supervision.lifecycle import ManagerContext
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import VERDICT, Transformation

#: Client of the claims on verdicts.
CLIENT = "dyknow_manager"


def is_own(claim: Claim) -> bool:
    """Whether a claim is the manager's own, on verdicts that transformations require."""
    request = claim.request
    return request.client_id == CLIENT and request.request_id == f"requires {request.tag}"


class Requirements:
    """The verdicts that were heard, and their consequences; read once a round."""

    def __init__(
        self,
        context: ManagerContext,
        table: ClaimTable,
        world: Callable[[], World],
        recover: float,
    ) -> None:
        """``recover`` are the seconds for which a verdict has to be TRUE after it was FALSE."""
        self._host = context.host
        self._library = context.library
        self._store = context.store
        self._clock = context.clock.now
        self._table = table
        self._world = world
        self._recover = recover
        self._followed: set[str] = set()
        self._heard: Mapping[str, HeardVerdict] = {}
        self._tags: dict[Term, HeardVerdict] = {}
        #: Ids of the living claims that could depend on a verdict at some time.
        self._users: dict[Term, set[str]] = {}
        for tag, (is_true, stamp, why, users) in context.store.bad_verdicts().items():
            heard = HeardVerdict(is_true, self._clock(), stamp, why, was_false=True)
            self._tags[parse_tag(tag)], self._users[parse_tag(tag)] = heard, set(users)
        self.verdicts = NO_VERDICTS  # the verdicts of the last round
        self._judge()
        #: Why nodelets and topics are lost, by their names.
        self.unavailable: Mapping[str, str] = {}

    # The manager's own claims

    def hold(self, wanted: Mapping[Term, set[str]]) -> None:
        """Hold claims on these verdicts, which claims may depend on, and on no other verdict."""
        tags = {str(tag) for tag in wanted}
        held = {each.request.tag: each for each in self._table.living if is_own(each)}
        for tag in sorted(tags - held.keys()):
            request = StreamRequest(tag, VERDICT, CLIENT, f"requires {tag}")
            self._table.add(Claim(uuid.uuid4().hex[:12], request), "transformations require it")
        for tag in sorted(held.keys() - tags):
            reason = "no transformation that a claim could use requires it any more"
            self._table.end(held[tag].claim_id, ClaimState.RELEASED, reason)
        living = {each.claim_id for each in self._table.living if not is_own(each)}
        canonical = self._library.ontology.canonical
        users = {tag: ids & living for tag, ids in self._users.items() if tag in self._tags}
        for written, ids in wanted.items():
            users.setdefault(canonical_tag(written, canonical), set()).update(ids)
        self._users = {tag: ids for tag, ids in users.items() if ids}

    # Verdicts

    def read(self) -> None:
        """Ask for the verdicts that were heard."""
        own = {each.topic: each for each in self._table.living if is_own(each) and each.topic}
        monitors = [topic_of_verdicts(each) for each in self._table.living]
        topics = {*own, *monitors} - {""}
        if not (topics or self._followed or self._tags):
            return
        self._followed = topics
        self._heard = self._host.verdicts(topics)
        bad = self.verdicts.bad & self._users.keys()  # of the last round
        self._tags = {tag: heard for tag, heard in self._tags.items() if tag in bad}
        canonical = self._library.ontology.canonical
        for topic, claim in own.items():
            heard = self._heard.get(topic)
            if heard is not None:
                tag = canonical_tag(parse_tag(claim.request.tag), canonical)
                # What this topic does not know: the verdict was FALSE on an earlier one.
                self._tags[tag] = heard if heard.was_false else heard.after(self._tags.get(tag))
        self._judge()
        self._write_bad()
        self.unavailable = self._found_unavailable(is_in_use=True) if self.verdicts.bad else {}

    def _judge(self) -> None:
        good = {tag for tag, heard in self._tags.items() if self._is_good(heard)}
        self.verdicts = Verdicts(frozenset(good), frozenset(self._tags.keys() - good))

    def _write_bad(self) -> None:
        bad = {
            str(tag): (heard.is_true, heard.stamp, heard.why, sorted(self._users.get(tag, ())))
            for tag, heard in self._tags.items()
            if tag in self.verdicts.bad
        }
        self._store.write({("facts", BAD_VERDICTS): json.dumps(bad) if bad else None})

    def _is_good(self, heard: HeardVerdict) -> bool:
        is_back = not heard.was_false or self._clock() - heard.heard >= self._recover
        return heard.is_true and is_back

    def untried(self) -> dict[str, str]:
        """Return the running parts that no claim uses yet, and whose first verdict is to come."""
        used = {name for each in self._table.living for name in (*each.nodelets, *each.sources)}
        found = self._found_unavailable(is_in_use=False)
        return {name: why for name, why in found.items() if name not in used}

    def _found_unavailable(self, is_in_use: bool) -> dict[str, str]:
        """Find the running parts whose transformations are not available."""
        world, found = self._world(), {}
        for record in world.records.values():
            is_running = record.state is State.RUNNING
            why = self._why_not_nodelet(record, world, is_in_use) if is_running else ""
            if why:
                found[record.name] = f"{record.name} is not available: {why}"
        for each in world.descriptions:
            why = self.why_not(each, {}, is_in_use)
            if why:
                found[each.source] = f"topic {each.source} is not available: {why}"
        return found

    def _why_not_nodelet(self, record: Record, world: World, is_in_use: bool) -> str:
        made = record.transformation
        known = self._library.guarded.get(record.label) if record.label in self._library else made
        if known is None or not known.requires:
            return ""
        ways = world.ways(record.name) or [record.given]
        return next(filter(None, [self.why_not(known, way, is_in_use) for way in ways]), "")

    def why_not(
        self, transformation: Transformation, bindings: Mapping[str, str], is_in_use: bool = False
    ) -> str:
        """Say why a transformation is not available under bindings; empty if it is."""
        if not transformation.requires:
            return ""
        canonical = self._library.ontology.canonical
        unmet = self.verdicts.unmet(transformation, bindings, canonical, is_in_use)
        written = required_tags(transformation, bindings, str)
        tags = dict(zip(required_tags(transformation, bindings, canonical), written))
        return "; ".join(f"{tags[tag]} {self._said(self._tags.get(tag))}" for tag in unmet)

    def _said(self, heard: HeardVerdict | None) -> str:
        if heard is None:
            return "has no verdict yet"
        if heard.is_true:
            return f"has been TRUE for less than {self._recover:g} s again"
        return said(heard)

    # Formulas of requests

    def violation(self, claim: Claim, since: float) -> str:
        """Say that the formula of a claim's request is FALSE; empty if it is not.

        A run of verdicts that began before ``since`` is about an earlier stream, unless it goes on
        for as long as a verdict has to be TRUE: a formula may look back.
        """
        heard = self._heard.get(topic_of_verdicts(claim))
        if heard is None or heard.is_true:
            return ""
        if heard.heard < since and heard.state < since + self._recover:
            return ""
        return f"'{claim.request.require}' {said(heard)}"


def topic_of_verdicts(claim: Claim) -> str:
    """Return the topic of the verdicts about a claim's stream; empty if there is none."""
    return claim.wiring.get(claim.monitor, {}).get(VERDICTS, "")


def said(heard: HeardVerdict) -> str:
    """Write a verdict that is FALSE, as people read it."""
    values = f" ({heard.why})" if heard.why else ""
    return f"is FALSE since {heard.stamp:.3f}{values}"
