"""What feeds a stream: all that has to live for it to live."""

from __future__ import annotations

from typing import AbstractSet, Dict, List, Sequence, Set

from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT


def with_feeders(
    records: Sequence[Record],
    ordinary: AbstractSet[str],
    wiring: Dict[str, Dict[str, str]],
    sources: Set[str],
    reused: Set[str],
) -> None:
    """Add what feeds the nodelets that are used as they are: the stream needs that too.

    Args:
        records: the nodelets of the graph.
        ordinary: topics on which ordinary nodes send, perhaps beside nodelets.
        wiring: for each nodelet of the stream the topics that its ports need; added to.
        sources: topics of ordinary nodes; added to.
        reused: names of nodelets that were there; added to.
    """
    by_name = {record.name: record for record in records}
    waiting = sorted(name for name in reused if name in wiring)
    while waiting:
        name = waiting.pop()
        record = by_name.get(name)
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


def _publishers(records: Sequence[Record], topic: str) -> List[tuple[str, str]]:
    return [
        (record.name, port.name)
        for record in records
        if record.state is State.RUNNING and record.transformation is not None
        for port in record.ports
        if port.direction == OUT and port.topic == topic
    ]
