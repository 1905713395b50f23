"""Streams on request, beside the made-up graph: planned for real, kept by nobody."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from typing import Callable, Dict, Iterator, List, Mapping, Tuple

from dyknow.errors import InvalidTag, Refused, Result, StreamRefused, UnknownClaim
from dyknow.manager.planning.explanation import as_tree
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, Live, NoPlan, Plan, Source
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import Term, parse_tag, read_tags
from dyknow.model.graph import NodeletStatus, State
from dyknow.model.streams import (
    Acquisition,
    ClaimState,
    Replanned,
    StreamEvent,
    StreamRequest,
    StreamStatus,
)
from dyknow.model.transformation import IN, OUT, Transformation


class SimulatedStreams:
    """Makes what a plan says, in a graph that it is given."""

    def __init__(
        self,
        nodelets: Mapping[str, NodeletStatus],
        library: Mapping[str, Transformation],
        spawn: Callable[[str, str, Mapping[str, str]], None],
        connect: Callable[[str, Mapping[str, str]], None],
    ) -> None:
        """Begin without streams.

        Args:
            nodelets: what runs, by name.
            library: what can run, by label.
            spawn: makes a nodelet of a label, of a name, with topics of its ports.
            connect: connects ports of a nodelet.
        """
        self.on_event: Callable[[StreamEvent], None] = lambda event: None
        self._nodelets, self._library = nodelets, library
        self._spawn, self._connect = spawn, connect
        self._streams: Dict[str, StreamStatus] = {}
        self._requests: Dict[str, StreamRequest] = {}

    def all(self) -> Tuple[StreamStatus, ...]:
        """All claims, by id."""
        return tuple(self._streams[claim_id] for claim_id in sorted(self._streams))

    def acquire(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        """Plan, and make what is missing."""
        claim_id = "" if dry_run else f"claim-{len(self._streams) + 1}"
        try:
            answer = self._plan(request)
        except InvalidTag as error:
            raise StreamRefused(str(error), Result.INVALID_TAG) from error
        view = StreamStatus(
            *(claim_id, request.client_id, request.tag, "", request.datatype),
            *(ClaimState.PENDING, "", (), 0.0),
        )
        if isinstance(answer, NoPlan):
            if not dry_run:
                self._requests[claim_id] = request
                self.put(replace(view, detail=str(answer)), "requested")
            raise StreamRefused(str(answer), Result.NO_PLAN, claim_id)
        labels = tuple(step.action.label for step in answer.steps)
        reused = tuple(sorted({live.nodelet for live in answer.live}))
        if dry_run:
            return Acquisition("", "", "", labels, reused, answer.cost, 0.0, as_tree(answer), "")
        made, topic = self._make(answer)
        self._requests[claim_id] = request
        names = tuple(sorted({*made.values(), *reused}))
        self.put(replace(view, topic=topic, state=ClaimState.ACTIVE, nodelets=names), "requested")
        return Acquisition(
            *(claim_id, topic, request.datatype, tuple(made.values()), reused, answer.cost, 0.0),
            *(as_tree(answer), ""),
        )

    def release(self, claim_id: str) -> None:
        """End a claim, if it is there."""
        stream = self._streams.get(claim_id)
        if stream is not None and not stream.state.ended:
            self.put(replace(stream, state=ClaimState.RELEASED), "released")

    def replan(self, claim_id: str, dry_run: bool = False) -> Replanned:
        """Say what the way is now."""
        if claim_id not in self._streams:
            raise Refused(str(UnknownClaim(claim_id)))
        answer = self._plan(self._requests[claim_id])
        if isinstance(answer, NoPlan):
            raise Refused(str(answer))
        return Replanned((), (), answer.cost, as_tree(answer), "")

    def put(self, stream: StreamStatus, reason: str) -> None:
        """Let a claim be so from now on, and tell."""
        before = self._streams.get(stream.claim_id)
        self._streams[stream.claim_id] = stream
        self.on_event(StreamEvent(time.time(), before, stream, reason))

    # Inside

    def _plan(self, request: StreamRequest) -> Answer:
        planner = Planner()
        planner.add(self._library.values())
        demand = Demand(frozenset((parse_tag(request.tag),)), request.datatype)
        return planner.plan(demand, self._live(), frozenset(request.exclude))

    def _live(self) -> Iterator[Tuple[Live, Tuple[Term, ...]]]:
        for nodelet in self._nodelets.values():
            fed = all(port.topic for port in nodelet.ports if port.direction == IN and port.tags)
            for port in nodelet.ports if fed and nodelet.state is State.RUNNING else ():
                if port.direction == OUT and port.tags:
                    stream = Live(
                        *(port.topic, port.name, nodelet.name, nodelet.transformation),
                        port.datatype,
                    )
                    yield stream, read_tags(port.tags)

    def _make(self, plan: Plan) -> Tuple[Dict[str, str], str]:
        made: Dict[str, str] = {}
        for step in plan.steps:
            label = step.action.label
            config = {port: self._topic_of(source, made) for port, source in step.inputs}
            made[label] = self._free_name(label)
            self._spawn(label, made[label], config)
        return made, self._topic_of(plan.goal, made)

    def _topic_of(self, source: Source, made: Mapping[str, str]) -> str:
        """Where a source publishes; it is connected if it does not yet."""
        name = source.nodelet if isinstance(source, Live) else made[source.label]
        port = self._nodelets[name].port(source.port)
        topic = (port.topic if port is not None else "") or f"{name}/{source.port}"
        self._connect(name, {source.port: topic})
        return topic

    def _free_name(self, label: str) -> str:
        wish = "/" + re.sub(r"[^A-Za-z0-9_]+", "_", label).strip("_")
        names: List[str] = [wish, *(f"{wish}_{number}" for number in range(2, 1000))]
        return next(name for name in names if name not in self._nodelets)
