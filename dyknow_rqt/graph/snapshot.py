# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The computation graph at one moment, as the window received it, and over time."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace
from functools import cached_property
from typing import AbstractSet, Iterable, Iterator, Mapping, Sequence, Tuple

from dyknow import names
from dyknow.model.graph import NodeletStatus, PortRef, PortState
from dyknow.model.streams import StreamStatus
from dyknow.model.transformation import IN
from dyknow.wiring.ports import Topic, topics_of

#: One side of the master's system state: topics and the nodes that use them.
Side = Sequence[Tuple[str, Sequence[str]]]
#: Transports of connections to other processes, by node, ``in`` or ``out``, and topic.
Transports = Mapping[Tuple[str, str, str], Sequence[str]]


@dataclass(frozen=True)
class PlainNode:
    """An ordinary ROS node that uses topics of nodelets."""

    name: str
    publishes: tuple[str, ...]
    subscribes: tuple[str, ...]


@dataclass(frozen=True)
class Snapshot:
    """The computation graph at one moment; two are equal when there is nothing to redraw.

    Attributes:
        nodelets: those of the manager's model.
        nodes: ordinary nodes that use topics of nodelets.
        taken: topics after out-ports that are not connected, where ordinary nodes publish.
        pending: tags of claims that wait, each with the reason.
    """

    nodelets: tuple[NodeletStatus, ...] = ()
    nodes: tuple[PlainNode, ...] = ()
    taken: frozenset[str] = frozenset()
    pending: tuple[tuple[str, str], ...] = ()

    def nodelet(self, name: str) -> NodeletStatus | None:
        return self._by_name.get(name)

    def port(self, ref: PortRef) -> PortState | None:
        nodelet = self.nodelet(ref.nodelet)
        return nodelet.port(ref.port) if nodelet is not None else None

    def shared(self, nodelets: Iterable[NodeletStatus]) -> tuple[NodeletStatus, ...]:
        """Take the own values of nodelets that have not changed: these are compared at once."""
        pairs = ((each, self.nodelet(each.name)) for each in nodelets)
        return tuple(
            each if before is None or before != each else before for each, before in pairs
        )

    def topics(self) -> Mapping[str, Topic]:
        """Topics that ports are connected to, by name, in order."""
        return self._topics

    @cached_property
    def _by_name(self) -> dict[str, NodeletStatus]:
        return {each.name: each for each in self.nodelets}

    @cached_property
    def _topics(self) -> dict[str, Topic]:
        return {topic.name: topic for topic in topics_of(self.nodelets)}


def plain_nodes(
    publishers: Side, subscribers: Side, topics: AbstractSet[str], hosts: AbstractSet[str]
) -> tuple[PlainNode, ...]:
    """Find the ordinary nodes, all but the nodelet managers ``hosts``, that use these topics."""
    used: dict[str, tuple[list[str], list[str]]] = {}
    for number, side in enumerate((publishers, subscribers)):
        for topic, nodes in side:
            for node in nodes:
                if topic in topics and node not in hosts:
                    used.setdefault(node, ([], []))[number].append(topic)
    return tuple(
        PlainNode(name, tuple(sorted(publishes)), tuple(sorted(subscribes)))
        for name, (publishes, subscribes) in sorted(used.items())
    )


def taken_topics(
    publishers: Side, nodelets: Sequence[NodeletStatus], hosts: AbstractSet[str]
) -> frozenset[str]:
    """Find topics after out-ports that are not connected, where ordinary nodes publish.

    Topics of the nodelet managers ``hosts`` are used by their nodelets.
    """
    wishes = {
        names.topic_after(nodelet.name, port.name)
        for nodelet in nodelets
        for port in nodelet.ports
        if port.direction != IN and not port.topic
    }
    return frozenset(
        topic
        for topic, nodes in publishers
        if topic in wishes and any(node not in hosts for node in nodes)
    )


def connections_of(snapshot: Snapshot, refs: Sequence[PortRef], transports: Transports) -> str:
    """Count the connections of ports by their transports; empty if none is known."""
    found: Counter[str] = Counter()
    for key in sorted({_way_of(snapshot, ref) for ref in refs} - {("", "", "")}):
        node, direction, name = key
        topic = snapshot.topics().get(name)
        if topic is not None:
            ends = topic.targets if direction != IN else topic.sources
            found["within the process"] += sum(_way_of(snapshot, e)[0] == node for e in ends)
        found.update(transports.get(key, ()))
    return ", ".join(f"{n} {what}" for what, n in sorted(found.items()) if n)


def _way_of(snapshot: Snapshot, ref: PortRef) -> tuple[str, str, str]:
    """The node, direction and topic of a port; empty if it is gone."""
    nodelet, port = snapshot.nodelet(ref.nodelet), snapshot.port(ref)
    return (nodelet.node, port.direction, port.topic) if nodelet and port else ("", "", "")


def not_ours(names: Sequence[str], snapshot: Snapshot) -> str:
    """Why the manager does not end or restart some nodelets, in words; empty if it does."""
    found = (snapshot.nodelet(name) for name in names)
    whose = [(each.name, each.owner) for each in found if each is not None and each.owner]
    return "\n".join(f"{name} was loaded by {owner}: end it there" for name, owner in whose)


def not_destroyed(names: Sequence[str], snapshot: Snapshot) -> str:
    """Why some nodelets cannot be destroyed, in words; empty if all can."""
    found = (snapshot.nodelet(name) for name in names)
    is_held = any(each is not None and each.is_protected for each in found)
    return not_ours(names, snapshot) or ("Release them from protection first" if is_held else "")


def protection(names: Sequence[str], snapshot: Snapshot) -> tuple[list[str], bool]:
    """The nodelets to protect, those that are not yet; or if all are, all of them, to release."""
    nodelets = (snapshot.nodelet(name) for name in names)
    free = [each.name for each in nodelets if each is not None and not each.is_protected]
    return (free, True) if free or not names else (list(names), False)


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
        since = moment.time - self.all[-1].time if len(self.all) > 1 else _TOGETHER
        if 0 <= since < _TOGETHER:  # less than none: the clock was set back
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
