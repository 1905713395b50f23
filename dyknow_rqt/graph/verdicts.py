# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts of formulas, by the out-ports that they come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Iterator, Mapping

from dyknow.formulas import Truth, Verdict
from dyknow.model.graph import NodeletStatus, PortRef, PortState, State
from dyknow.model.streams import StreamStatus
from dyknow.model.transformation import IN, VERDICT


@dataclass(frozen=True)
class PortVerdict:
    """The first of the last equal verdicts from an out-port; None before there is one.

    Its formula has the tags of the stream of verdicts, or else the formula.
    """

    formula: str
    verdict: Verdict | None

    @property
    def truth(self) -> Truth:
        return Truth.UNKNOWN if self.verdict is None else self.verdict.value

    @property
    def text(self) -> str:
        if self.verdict is None:
            return f"{self.formula}: no verdict yet"
        since = f"{self.verdict.value.name} since {self.verdict.since / 1e9:.3f}"
        return f"{self.formula}: {since}\n{self.verdict.why}".rstrip()


def verdict_sources(nodelets: Iterable[NodeletStatus]) -> frozenset[tuple[str, str]]:
    """Find the nodes that publish verdicts now, each with the topic."""
    ports = _ports_of_verdicts(nodelets)
    return frozenset(
        (each.node, port.topic) for each, port in ports if each.state is State.RUNNING
    )


def port_verdicts(
    nodelets: Iterable[NodeletStatus],
    verdicts: Mapping[str, Verdict | None],
    streams: Iterable[StreamStatus],
) -> dict[PortRef, PortVerdict]:
    """Find the last verdict, by topic, of each out-port.

    Claims have the bindings of the variables in tags of ports.
    """
    tags: dict[str, list[str]] = {}
    for stream in streams:
        if not stream.state.ended:
            tags.setdefault(stream.topic, []).append(stream.bound_tag)
    found = {}
    for nodelet, port in _ports_of_verdicts(nodelets):
        formulas = [each.text for each in nodelet.parameters if each.name == "formula"]
        words = tags.get(port.topic) or port.tags or formulas or [port.name]
        formula = ", ".join(sorted(set(words)))
        found[PortRef(nodelet.name, port.name)] = PortVerdict(formula, verdicts.get(port.topic))
    return found


def _ports_of_verdicts(
    nodelets: Iterable[NodeletStatus],
) -> Iterator[tuple[NodeletStatus, PortState]]:
    for nodelet in nodelets:
        for port in nodelet.ports:
            if port.direction != IN and port.datatype == VERDICT and port.topic:
                yield nodelet, port
