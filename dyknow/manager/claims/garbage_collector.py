"""Clears away what claims leave behind: nodelets that none needs, and second publishers."""

from __future__ import annotations

import logging
from functools import partial
from typing import AbstractSet, Callable, Dict, Iterable, Set, Tuple

from dyknow.backoff import Backoff
from dyknow.errors import DyKnowError
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_lock import ClaimLock
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.connector import Connector
from dyknow.manager.claims.silence_monitor import SilenceMonitor
from dyknow.manager.claims.topology import Consumer, Producer
from dyknow.manager.manager import Manager
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import IN, OUT

_log = logging.getLogger("rosout.dyknow")

#: Seconds until what failed is tried again.
_FIRST_PAUSE = 1.0

Wire = Tuple[str, str, str]
"""A nodelet, its port, and the topic that it is connected to."""


class GarbageCollector:
    """Works after the claims were mended; never touches what is protected or made by hand."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        claim_lock: ClaimLock,
        silence: SilenceMonitor,
        connector: Connector,
        linger: float,
        clock: Callable[[], float],
    ) -> None:
        """Prepare.

        Args:
            manager: destroys nodelets.
            table: the claims.
            claim_lock: knows what a request that waits counts on.
            silence: knows which nodelets do not answer.
            connector: knows who hears whom.
            linger: seconds that a nodelet that no claim needs any more is kept.
            clock: seconds, steady.
        """
        self._manager = manager
        self._table = table
        self._claim_lock = claim_lock
        self._silence = silence
        self._connector = connector
        self._linger = linger
        self._clock = clock
        self._idle_since: Dict[str, float] = {}
        # A nodelet that does not answer in time is not asked twice in one round.
        self._failures = Backoff(clock, _FIRST_PAUSE, tolerated=0)
        self._replaced: Set[Wire] = set()

    def replaced(self, claim: Claim) -> None:
        """Remember who published for a claim and could not be told that it was replaced.

        When it is back, it leaves the topic to its successor.
        """
        for record in self._manager.graph.all():
            if record.name != claim.goal[0] and record.state is not State.RUNNING:
                for port, topic in record.topics.items():
                    if topic == claim.topic:
                        self._replaced.add((record.name, port, topic))

    def disconnect(self) -> None:
        """Disconnect what was made for claims that need it no more, and whoever does not fit."""
        claims = self._table.living()
        needed, wires = self._table.needed(), _wires(claims)
        topology = self._connector.topology()
        sources = {topic for claim in claims for topic in claim.sources}
        unknown = {topic for topic in sources if not topology.is_described(topic)}
        for record in self._manager.graph.all():
            if not record.claimed:
                continue
            reserved, in_use = record.name in self._claim_lock.reserved, record.name in needed
            listening = [port for port in record.ports if port.direction == IN and port.tags]
            ports = {port.name for port in listening if port.topic in unknown}
            if not reserved:
                ports.update(
                    port.name
                    for port in (listening if in_use else record.ports)
                    if (record.name, port.name, port.topic) not in wires
                )
            # All at once: a plain nodelet comes up again with those that stay.
            self._cut(record, ports)
        for topic, sender, listener in self._connector.topology().mismatches():
            self._separate(topic, sender, listener, wires)

    def _separate(
        self, topic: str, sender: Producer, listener: Consumer, wires: AbstractSet[Wire]
    ) -> None:
        """Part two that do not fit: a claim's listener stays where the claim has it."""
        hearer = self._manager.graph.find(listener.nodelet)
        speaker = self._manager.graph.find(sender.nodelet)
        if hearer is not None and not hearer.claimed:
            return  # people connected it so
        stays = hearer is None or (hearer.name, listener.port, topic) in wires
        if speaker is not None:
            here = [port.name for port in speaker.ports if port.topic == topic]
            if sender.port not in here:
                return  # it may come here, and has not yet
            if stays and self._cut(speaker, [sender.port]):
                return
        if hearer is not None:
            self._cut(hearer, [listener.port])

    def take_apart(self, claim: Claim) -> bool:
        """Disconnect what only a claim needs, and those whose clients listen where its does.

        Returns:
            Whether nothing of it can send any more; what hangs sends nothing.
        """
        done = True
        others = [each for each in self._table.living() if each.topic != claim.topic]
        wires = _wires(others)
        for name, topics in sorted(claim.wiring.items()):
            record = self._manager.graph.find(name)
            if record is not None and record.claimed and name not in self._claim_lock.reserved:
                ports = [
                    port
                    for port in topics
                    if (name, port) == claim.goal or (name, port, topics[port]) not in wires
                ]
                done = (self._cut(record, ports) or not self._is_reachable(record)) and done
        return done

    def clear_topics(self) -> None:
        """Leave one publisher on each claimed topic, and none where nothing can be published."""
        claims = self._table.living()
        goals = {claim.topic: "" for claim in claims if claim.topic and not claim.is_made}
        goals.update(
            (claim.topic, claim.goal[0])
            for claim in claims
            if claim.state is ClaimState.ACTIVE and claim.goal[0]
        )
        self._replaced = {each for each in self._replaced if each[2] in goals}
        for record in self._manager.graph.all():
            ports = [
                port.name
                for port in record.ports
                if port.direction == OUT
                and goals.get(port.topic, record.name) != record.name
                and (record.claimed or (record.name, port.name, port.topic) in self._replaced)
            ]
            self._cut(record, ports)

    def collect(self) -> None:
        """Destroy what was made for claims and no claim needs, after a while."""
        now = self._clock()
        needed = self._table.needed() | self._claim_lock.reserved
        for record in reversed(self._manager.graph.all()):
            if not record.claimed or record.is_protected or record.name in needed:
                self._idle_since.pop(record.name, None)
                continue
            since = self._idle_since.setdefault(record.name, now)
            linger = 0.0 if record.name in self._silence.unhealthy else self._linger
            reachable = record.state in (State.RUNNING, State.FAILED)
            if now - since >= linger and reachable and self._failures.allows(record.name):
                self._try(record, partial(self._manager.lifecycle.destroy, record.name))
        present = {record.name for record in self._manager.graph.all()}
        for name in [name for name in self._idle_since if name not in present]:
            del self._idle_since[name]

    def _cut(self, record: Record, ports: Iterable[str]) -> bool:
        """Disconnect those of a nodelet's ports that are connected; whether that is done."""
        connected = {port.name for port in record.ports if port.topic}
        config = {port: "" for port in ports if port in connected}
        if not config:
            return True
        return (
            self._is_reachable(record)
            and self._failures.allows(record.name)
            and self._try(record, partial(self._connector.connect, record.name, config))
        )

    def _is_reachable(self, record: Record) -> bool:
        return record.state is State.RUNNING and record.name not in self._silence.unresponsive

    def _try(self, record: Record, action: Callable[[], None]) -> bool:
        try:
            action()
        except DyKnowError as error:
            self._failures.failed(record.name)
            _log.warning("%s: %s", record.name, error)
            return False
        self._failures.forgive(record.name)
        return True


def _wires(claims: Iterable[Claim]) -> Set[Wire]:
    """List what claims need connected."""
    return {
        (name, port, topic)
        for claim in claims
        for name, topics in claim.wiring.items()
        for port, topic in topics.items()
    }
