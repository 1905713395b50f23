# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The inputs of plans: transformations, streams, and nodelets to connect elsewhere."""

from __future__ import annotations

from math import inf
from typing import (
    AbstractSet,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Sequence,
    Set,
    Tuple,
    Union,
)

from dyknow.errors import HostError, UnknownTransformation
from dyknow.manager.claim import Claim
from dyknow.manager.claims.context import ClaimContext
from dyknow.manager.claims.ends import Inlet, Way, is_relay, supplied, ways_to_bind
from dyknow.manager.claims.topology import Topology
from dyknow.manager.library import Library
from dyknow.manager.planning.problem import (
    NO_LABELS,
    NO_WISHES,
    Demand,
    Live,
    New,
    Plan,
    PlanStep,
    TaggedStream,
    Wishes,
)
from dyknow.manager.record import Record, ports_on
from dyknow.manager.specifications.given import exposed_variables
from dyknow.manager.specifications.tags import Bindings, Subsumption, Term, read_tags
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT, Transformation

Instance = Tuple[str, Bindings]
"""The label of a transformation and what its variables stand for: what a plan needs once."""

#: Seconds for which the answer to "which topics are published?" is good enough.
_FRESH = 0.5


class OwnNodelet(NamedTuple):
    """A healthy nodelet that can be connected elsewhere for a claim.

    Attributes:
        name: its name.
        label: its transformation.
        kept: names that its variables have to stand for wherever it is connected.
        present: names that they stand for now, as far as known.
    """

    name: str
    label: str
    kept: Bindings = ()
    present: Bindings = ()


def instance_of(part: Union[New, PlanStep]) -> Instance:
    """Return the instance that a part of a plan belongs to."""
    label = part.label if isinstance(part, New) else part.action.label
    return label, part.bindings


def assigned(plan: Plan, own: Sequence[OwnNodelet], ontology: Subsumption) -> Dict[Instance, str]:
    """Choose nodelets for the steps of a plan.

    Those that stay as they are come first, since nothing that they supply changes.

    Args:
        plan: the plan.
        own: nodelets that can be connected elsewhere, the preferred ones first.
        ontology: knows which names mean the same individual.

    Returns:
        Names of nodelets by instance; the other instances need new ones.
    """
    left: List[OwnNodelet] = list(own)
    found: Dict[Instance, str] = {}
    for stays in (True, False):
        for step in plan.steps:
            instance = instance_of(step)
            if instance in found:
                continue
            for each in left:
                bound = each.present if stays else each.kept
                if each.label == instance[0] and _agree(bound, instance[1], ontology):
                    if stays and not each.present:
                        continue
                    found[instance] = each.name
                    left.remove(each)
                    break
    return found


def _agree(some: Bindings, all_: Bindings, ontology: Subsumption) -> bool:
    """Whether all that is bound in ``some`` stands for the same individual in ``all_``."""
    known = {variable: ontology.canonical(name) for variable, name in all_}
    return all(known.get(variable) == ontology.canonical(name) for variable, name in some)


def live_streams(
    records: Iterable[Record],
    published: Iterable[Transformation],
    topology: Topology,
    ontology: Subsumption,
    unhealthy: AbstractSet[str] = frozenset(),
) -> List[TaggedStream]:
    """List the streams that a plan can use as they are.

    A nodelet's out-ports supply their tags only while the nodelet runs and each of its tagged
    in-ports is connected to a stream that satisfies it: a detector without input supplies nothing.
    These streams bind the nodelet's variables. The stated latency of a stream adds to that of
    the latest one that feeds its nodelet; one that states no rate is as fast as the slowest one.

    Args:
        records: the nodelets of the graph.
        published: transformations of type topic whose topic has a publisher.
        topology: all publishers of each topic: only the tags that hold for all of them count.
        ontology: hierarchy of names.
        unhealthy: nodelets that are not to be relied on.
    """
    streams: List[TaggedStream] = []
    on_topic: Dict[str, Tuple[Tuple[Term, ...], str]] = {}  # tags and type
    latencies: Dict[str, float] = {}
    rates: Dict[str, float] = {}  # infinite if none is stated

    def supply(stream: Live, tags: Tuple[Term, ...]) -> None:
        if stream.topic:
            tags = topology.common_tags(stream.topic, tags)
            known, _ = on_topic.get(stream.topic, ((), ""))
            on_topic[stream.topic] = (known + tags, stream.datatype)
            latencies[stream.topic] = max(stream.latency, latencies.get(stream.topic, 0.0))
            rates[stream.topic] = max(stream.rate or inf, rates.get(stream.topic, 0.0))
        streams.append((stream, tags))

    def ways(record: Record) -> List[Way]:
        """Ways to bind a nodelet's variables; none while an in-port is not fed."""
        inlets = [
            Inlet(demand, (on_topic.get(record.topics.get(port, ""), ((), "")),))
            for port, demand in _demands(record)
        ]
        return ways_to_bind([record.given], inlets, ontology)

    for each in published:
        port = each.ports[0]
        stream = Live(each.source, "", "", each.label, port.datatype, port.rate, port.latency)
        supply(stream, read_tags(port.tags))
    waiting = [
        record
        for record in records
        if record.state is State.RUNNING
        and record.transformation is not None
        and record.name not in unhealthy
    ]
    progress = True
    while progress:
        progress = False
        for record in list(waiting):
            found = ways(record)
            if found:
                waiting.remove(record)
                progress = True
                fed = [record.topics.get(port, "") for port, _ in _demands(record)]
                begun = max([latencies.get(topic, 0.0) for topic in fed], default=0.0)
                slowest = min([rates.get(topic, inf) for topic in fed], default=inf)
                for stream, tags in _outputs(record):
                    latency = round(begun + stream.latency, 6)
                    rate = stream.rate or (slowest if slowest < inf else 0.0)
                    supply(stream._replace(latency=latency, rate=rate), supplied(tags, found))
    return streams


def _demands(record: Record) -> List[Tuple[str, Demand]]:
    """List the tagged in-ports of a nodelet, each with its demand."""
    assert record.transformation is not None
    return [
        (port.name, Demand(frozenset(tags), port.datatype))
        for port in record.transformation.ports
        for tags in [read_tags(port.tags)]
        if port.direction == IN and tags
    ]


def _outputs(record: Record) -> List[TaggedStream]:
    assert record.transformation is not None
    seen = {port.name: port.datatype for port in record.ports}
    found = []
    for port in record.transformation.ports:
        tags = read_tags(port.tags)
        is_there = port.name in seen or not record.is_described
        if port.direction == OUT and tags and is_there:
            stream = Live(
                record.topics.get(port.name, ""),
                port.name,
                record.name,
                record.transformation.label,
                seen.get(port.name) or port.datatype,
                port.rate,
                port.latency,
            )
            found.append((stream, tags))
    return found


def add_upstream(
    records: Mapping[str, Record],
    ordinary: AbstractSet[str],
    wiring: Dict[str, Dict[str, str]],
    sources: Set[str],
    reused: Set[str],
) -> None:
    """Add everything that feeds the nodelets which are used as they are: the stream needs it too.

    Args:
        records: the nodelets by name.
        ordinary: topics on which ordinary nodes publish, perhaps besides nodelets.
        wiring: for each nodelet of the stream the topics that its ports need; added to.
        sources: topics of ordinary nodes; added to.
        reused: names of nodelets that existed before; added to.
    """
    waiting = sorted(name for name in reused if name in wiring)
    while waiting:
        name = waiting.pop()
        record = records.get(name)
        if record is None or record.transformation is None:
            continue
        for port in record.transformation.ports:
            topic = record.topics.get(port.name, "")
            if port.direction != IN or not port.tags or not topic:
                continue
            wiring[name][port.name] = topic
            publishers = _publishers(records, topic)
            if not publishers or topic in ordinary:
                sources.add(topic)
            for publisher, out_port in publishers:
                if publisher not in wiring:
                    waiting.append(publisher)
                    reused.add(publisher)
                wiring.setdefault(publisher, {})[out_port] = topic


def _publishers(records: Mapping[str, Record], topic: str) -> List[Tuple[str, str]]:
    return [
        (record.name, port)
        for record in records.values()
        if record.state is State.RUNNING and record.transformation is not None
        for port in ports_on(record, OUT, topic)
    ]


class PlanInputs:
    """The present world, as plans need it; used under the lock of the claims."""

    def __init__(self, context: ClaimContext, ontology: Subsumption) -> None:
        self._manager = context.manager
        self._table = context.table
        self._lock = context.lock
        self._world = context.connector.world
        self._monitor = context.monitor
        self._clock = context.clock
        self._ontology = ontology
        self._transformations: Dict[str, Transformation] = {}
        self._transformations_at: Tuple[int, FrozenSet[str]] = (-1, NO_LABELS)
        self._looked = float("-inf")
        #: Topics of ordinary nodes that had a publisher at the last look.
        self.published: FrozenSet[str] = frozenset()

    def look(self, at_once: bool = False) -> None:
        """Ask which topics of ordinary nodes are published: now and then, or ``at_once``.

        The last answer holds until there is another one.
        """
        now = self._clock()
        if now - self._looked < _FRESH and not at_once:
            return
        self._looked = now
        wanted = set(self._world().described)
        wanted.update(topic for claim in self._table.living() for topic in claim.sources)
        try:
            self.published = self._manager.host.published(sorted(wanted))
        except HostError:
            return  # the ROS master is away, which interrupts no stream

    def ordinary(self) -> FrozenSet[str]:
        """Topics on which ordinary nodes publish what the library describes."""
        return self.published & self._world().described.keys()

    def transformations(self) -> Mapping[str, Transformation]:
        """Return the transformations for steps of plans by label; another mapping after changes.

        An external node is among them while it runs.
        """
        library, nodes = self._manager.library, self._world().described_nodes
        if self._transformations_at != (library.revision, nodes):
            self._transformations_at = library.revision, nodes
            self._transformations = {
                each.label: each for each in library.all() if not each.node or each.label in nodes
            }
        return self._transformations

    def offers(self) -> Hashable:
        """Return a value that differs when a plan may have become cheaper."""
        others = frozenset(
            record.name
            for record in self._world().records.values()
            if not record.claimed and record.state is State.RUNNING
        )
        return self._manager.library.revision, self.published, others

    def own(self, claim: Claim, transformations: Mapping[str, Transformation]) -> List[OwnNodelet]:
        """Healthy nodelets that can be connected elsewhere for a claim, the preferred ones first.

        These are the claim's own nodelets and those that no claim needs, and external nodes that
        the library describes. Parts that other claims share are among them, unless these claims
        exclude other labels than this one, or have other wishes; they have to go on supplying the
        same.
        """
        sharing = [each for each in self._table.living() if each.claim_id != claim.claim_id]
        world = self._world()
        needed, records = world.needed | self._lock.reserved, world.records
        idle = [name for name in records if name not in needed]
        unfit = self._monitor.unhealthy | self._monitor.quality.unfit(self._table.together(claim))
        found: List[OwnNodelet] = []
        for name in reversed((*idle, *claim.nodelets)):
            record = records.get(name)
            users = [each for each in sharing if name in each.wiring]
            if (
                record is not None
                and name not in unfit
                and _is_connectable(record, transformations)
                and all(_may_lend(each, claim) for each in users)
            ):
                exposed = exposed_variables(transformations[record.label])
                ways = world.topology.dependent.ways(name) if exposed else None
                present = {_restricted(way, exposed) for way in ways or ()}
                bound = min(present) if len(present) == 1 else ()
                is_certain = {variable for variable, _ in bound} == exposed
                if is_certain or not users:
                    kept = bound if users else tuple(sorted(record.given.items()))
                    found.append(OwnNodelet(name, record.label, kept, bound))
        return found

    def streams(
        self, exclude: AbstractSet[str], without: AbstractSet[str] = frozenset()
    ) -> List[TaggedStream]:
        """List the streams that can be relied on.

        Args:
            exclude: labels that must have no part in them, directly or further up.
            without: nodelets and topics that must have no part in them.
        """
        world, library = self._world(), self._manager.library
        published = [
            each
            for each in world.descriptions
            if each.label not in exclude
            and each.source in self.published
            and each.source not in self._monitor.silent
            and each.source not in without
        ]
        excluded = {
            record.name
            for record in world.records.values()
            if record.label in exclude or (record.claimed and not is_current(library, record))
        }
        unfit = without | excluded | self._monitor.unhealthy
        records = world.records.values()
        return live_streams(records, published, world.topology, self._ontology, unfit)

    def upstream(self, claim: Claim, streams: Iterable[TaggedStream]) -> Dict[str, FrozenSet[str]]:
        """Labels upstream of each nodelet of streams, where the claim has wishes about them."""
        if wishes_of(claim) == NO_WISHES:
            return {}
        records, ordinary = self._world().records, self.ordinary()
        found = {}
        for name in {stream.nodelet for stream, _ in streams if stream.nodelet}:
            fed: Dict[str, Dict[str, str]] = {name: {}}
            topics: Set[str] = set()
            add_upstream(records, ordinary, fed, topics, {name})
            found[name] = frozenset(self.labels(fed.keys() - {name}, topics))
        return found

    def labels(self, nodelets: Iterable[str], topics: Iterable[str]) -> List[str]:
        """Labels of nodelets that run, and of ordinary topics."""
        world, wanted = self._world(), set(topics)
        found = [world.records.get(name) for name in nodelets]
        described = [each.label for each in world.descriptions if each.source in wanted]
        return [record.label for record in found if record is not None] + described

    def without_relays(self, streams: Iterable[TaggedStream]) -> List[TaggedStream]:
        """Leave out the streams of relays: a plan uses the stream that they forward."""
        relays = self._world().relays
        return [each for each in streams if each[0].nodelet not in relays]

    def engaged(self, own: Iterable[OwnNodelet]) -> FrozenSet[str]:
        """Labels of the external nodes that run, but can only be used as they are connected."""
        return self._world().described_nodes - {each.label for each in own}


def wishes_of(claim: Claim) -> Wishes:
    """Return the preferences of a claim's client."""
    request = claim.request
    return Wishes(tuple(sorted(set(request.prefer))), tuple(sorted(set(request.avoid))))


def is_current(library: Library, record: Record) -> bool:
    """Whether the library still has a nodelet's transformation, perhaps in a newer version."""
    if is_relay(record.transformation):
        return True
    try:
        library.get(record.label)
    except UnknownTransformation:
        return False
    return True


def _is_connectable(record: Record, transformations: Mapping[str, Transformation]) -> bool:
    """Whether a nodelet runs, is one that plans may connect, and is as today's library says."""
    return (
        record.transformation is not None
        and record.transformation == transformations.get(record.label)
        and (record.claimed or (record.is_described and record.is_complete))
        and record.state is State.RUNNING
    )


def _may_lend(user: Claim, claim: Claim) -> bool:
    """Whether a claim may connect elsewhere what another one uses."""
    excluded = set(user.request.exclude)
    return excluded <= set(claim.request.exclude) and wishes_of(user) == wishes_of(claim)


def _restricted(way: Mapping[str, str], variables: AbstractSet[str]) -> Bindings:
    return tuple(sorted((each, way[each]) for each in variables if each in way))
