# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The facts about each item of the drawing: its look and its tool tip follow from them."""

from __future__ import annotations

from typing import Mapping

from dyknow.model.graph import NodeletKind, NodeletStatus, PortRef, State
from dyknow.model.transformation import IN
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.items import PortItem
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import Vertex, VertexKind, key_of
from dyknow_rqt.graph.measurements import PortRate, PortVerdict, Strain
from dyknow_rqt.graph.snapshot import Snapshot, Transports, connections_of


class Facts:
    """The graph, and its measurements; transports of connections if a tool tip shows them."""

    def __init__(self) -> None:
        self._snapshot = Snapshot()
        self._dead: frozenset[str] = frozenset()
        self.traffic: Mapping[PortRef, PortRate] = {}
        self.verdicts: Mapping[PortRef, PortVerdict] = {}
        self.strains: Mapping[str, Strain] = {}
        self.transports: Transports = {}

    def take(self, snapshot: Snapshot) -> None:
        self._snapshot, self._dead = snapshot, _dead_keys(snapshot)

    def show_vertex(self, item: VertexItem) -> None:
        nodelet = self._snapshot.nodelet(item.vertex.name)
        if nodelet is None or item.vertex.kind is not VertexKind.NODELET:
            is_dead = item.vertex.key in self._dead
            item.shown = None
            item.set_state(State.LOST if is_dead else State.RUNNING)
            return
        item.set_strain(self.strains.get(nodelet.name, Strain()))
        for port in item.ports.values():
            port.change(verdict=self.verdicts.get(port.ref))
        if item.shown is nodelet:
            return
        item.shown = nodelet
        is_cpp = nodelet.kind in (NodeletKind.CPP, NodeletKind.CPP_NODE)
        item.set_state(nodelet.state, nodelet.is_protected, is_cpp)
        connected = {port.name for port in nodelet.ports if port.topic}
        for port in item.ports.values():
            port.change(is_connected=port.ref.port in connected)

    def show_arrow(self, item: EdgeItem) -> bool:
        """Update an arrow; returns whether its label has another size.

        Its rate is counted by its source or else its sink; of one that its sink cannot follow,
        by the sink. Its verdict is the last one that came from its out-port.
        """
        found = [self.traffic[ref] for ref in item.refs if ref in self.traffic]
        traffic = found[0 if found[0].drop_rate > 0 else -1] if found else None
        verdict = next((self.verdicts[ref] for ref in item.refs if ref in self.verdicts), None)
        is_dead = item.is_planned or not self._dead.isdisjoint((item.edge.tail, item.edge.head))
        return item.show(traffic, verdict, is_dead)

    def nodes_of(self, item: object) -> frozenset[str]:
        """The nodes of the ports whose connections an item shows."""
        nodelets = [self._snapshot.nodelet(ref.nodelet) for ref in self._refs_of(item)]
        return frozenset(nodelet.node for nodelet in nodelets if nodelet is not None)

    def tip_of(self, item: object) -> str:
        refs = self._refs_of(item)
        of_one = refs[:1] if isinstance(item, EdgeItem) else refs
        connections = connections_of(self._snapshot, of_one, self.transports)
        connections = f"connections: {connections}" if connections else ""
        if isinstance(item, VertexItem):
            return _tip(self._tip_of_vertex(item.vertex), connections)
        return "\n\n".join(filter(None, (*map(self._tip_of_port, refs), connections)))

    def _refs_of(self, item: object) -> list[PortRef]:
        """The ports whose connections an item shows, sources first."""
        if isinstance(item, EdgeItem):
            return item.refs[::-1]
        if isinstance(item, VertexItem) and item.vertex.kind is VertexKind.TOPIC:
            topic = self._snapshot.topics().get(item.vertex.name)
            return list(topic.sources or topic.targets) if topic is not None else []
        return [item.ref] if isinstance(item, PortItem) else []

    def _tip_of_vertex(self, vertex: Vertex) -> str:
        name, topic = vertex.name, self._snapshot.topics().get(vertex.name)
        nodelet = self._snapshot.nodelet(name)
        if vertex.kind is VertexKind.TOPIC and topic is not None:
            said = [self.verdicts[ref].text for ref in topic.sources if ref in self.verdicts]
            return _tip(name, topic.datatype or "type not known yet", *(said or topic.tags))
        if vertex.kind is VertexKind.NODELET and nodelet is not None:
            return _tip(_tip_of_nodelet(nodelet), self.strains.get(name, Strain()).text)
        what = {
            VertexKind.BOX: "a collapsed box; double-click to open it",
            VertexKind.GHOST: f"a nodelet of the plan that is shown: {vertex.note}",
            VertexKind.CLAIM: f"a stream that waits until it can be made: {vertex.note}",
            VertexKind.NODE: "ordinary ROS node",
        }
        return _tip(name, what.get(vertex.kind, "removed"))

    def _tip_of_port(self, ref: PortRef) -> str:
        port, traffic = self._snapshot.port(ref), self.traffic.get(ref)
        if port is None:
            return ""
        lines = [
            f"{'in' if port.direction == IN else 'out'}-port {port.name}",
            port.datatype or "type not known yet",
            port.topic or "not connected",
            *([self.verdicts[ref].text] if ref in self.verdicts else port.tags),
        ]
        if traffic is not None:
            verb = "received" if port.direction == IN else "sent"
            rates = traffic.text.replace("\n", ", ")
            lines.append(f"{rates} ({traffic.messages} {verb}, {traffic.dropped} dropped)")
            if traffic.bandwidth is not None:
                lines.append(f"about {traffic.bandwidth / 1e6:.3g} MB/s")
        return _tip(*lines)


def _dead_keys(snapshot: Snapshot) -> frozenset[str]:
    """Vertices through which nothing can come: lost nodelets, and topics without live sources.

    A topic without a known publisher lives as long as one of its receivers.
    """
    lost = {n.name for n in snapshot.nodelets if n.state in (State.LOST, State.FAILED)}
    published = {topic for node in snapshot.nodes for topic in node.publishes}
    dead = {key_of(VertexKind.NODELET, name) for name in lost}
    for topic in snapshot.topics().values() if lost else ():
        ends = topic.sources or topic.targets
        if topic.name not in published and all(ref.nodelet in lost for ref in ends):
            dead.add(key_of(VertexKind.TOPIC, topic.name))
    return frozenset(dead)


def _tip_of_nodelet(nodelet: NodeletStatus) -> str:
    inputs = sum(port.direction == IN for port in nodelet.ports)
    state = nodelet.state.name.lower()
    return _tip(
        nodelet.name,
        nodelet.origin,
        nodelet.kind.title + (f" in {nodelet.manager}" if nodelet.manager else ""),
        f"on {nodelet.host}" if nodelet.host else "",
        " ".join(f"{each.name}={each.text}" for each in nodelet.parameters),
        f"in-ports: {inputs}, out-ports: {len(nodelet.ports) - inputs}",
        "protected" if nodelet.is_protected else "",
        "in a process of its own" if nodelet.isolated else "",
        "its topics are fixed" if nodelet.is_fixed else "",
        state + (f": {nodelet.detail}" if nodelet.detail else ""),
    )


def _tip(*lines: str) -> str:
    return "\n".join(line for line in lines if line)
