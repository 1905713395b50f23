# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A whole wiring, as a value and as XML: nodelets, their connections and transformations."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Callable, Dict, List, Tuple
from xml.sax.saxutils import quoteattr

from dyknow import names
from dyknow.errors import DyKnowError, InvalidName
from dyknow.guards import NO_GUARDS
from dyknow.manager.claims.ends import transformation_of_relay
from dyknow.manager.specifications.findings import EnoughProblems, Findings
from dyknow.manager.specifications.limits import DEFAULT_LIMITS
from dyknow.manager.specifications.reader import TRANSFORMATIONS, SpecificationReader
from dyknow.manager.specifications.specification import transformations_of
from dyknow.manager.specifications.xml_reader import ANY, NEEDED, Attribute, Attributes, Element
from dyknow.model.graph import Model, NodeletStatus, SpawnRequest
from dyknow.model.transformation import Parameter, Transformation

VERSION = "1"


class CannotSave(DyKnowError):
    """A wiring cannot be written so that it could be read again."""


@dataclass(frozen=True)
class Wiring:
    """Requests for nodelets, by name, and the transformations they are made from, by label."""

    transformations: Tuple[Transformation, ...] = ()
    nodelets: Tuple[SpawnRequest, ...] = ()

    def to_xml(self) -> str:
        """Write the wiring as canonical XML: the same text for equal wirings."""
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', f'<wiring version="{VERSION}">']
        lines.append("<transformations>")
        lines.extend(each.to_xml().rstrip("\n") for each in self.transformations)
        lines.append("</transformations>")
        lines.append("<nodelets>")
        for nodelet in self.nodelets:
            lines.extend(_nodelet_xml(nodelet))
        lines.append("</nodelets>")
        lines.append("</wiring>\n")
        return "\n".join(lines)


def wiring_of(snapshot: Model) -> Tuple[Wiring, List[NodeletStatus]]:
    """Take the wiring out of a model.

    Returns:
        The wiring, and the nodelets that it leaves out: those without a transformation.

    Raises:
        CannotSave: a transformation is gone that a nodelet was made from.
    """
    known = {each.label: each for each in snapshot.transformations}
    own = [nodelet for nodelet in snapshot.nodelets if nodelet.transformation]
    relays = (transformation_of_relay(each) for each in own if each.transformation not in known)
    known.update({each.label: each for each in relays if each is not None})
    gone = [
        f"'{each.transformation}' of '{each.name}'"
        for each in own
        if each.transformation not in known
    ]
    if gone:
        raise CannotSave(
            f"the library has no more {', '.join(gone)}; expected the transformation of every "
            "nodelet (import it again, or destroy the nodelet)"
        )
    used = {nodelet.transformation for nodelet in own}
    wiring = Wiring(
        tuple(known[label] for label in sorted(used)),
        tuple(nodelet.request for nodelet in sorted(own, key=lambda each: each.name)),
    )
    return wiring, [nodelet for nodelet in snapshot.nodelets if not nodelet.transformation]


def _nodelet_xml(nodelet: SpawnRequest) -> List[str]:
    attributes = [("name", nodelet.name), ("transformation", nodelet.label)]
    attributes.extend([("manager", nodelet.manager)] if nodelet.manager else [])
    attributes.extend([("protected", "true")] if nodelet.is_protected else [])
    attributes.extend([("isolated", "true")] if nodelet.isolated else [])
    opening = "  <nodelet" + "".join(f" {key}={quoteattr(value)}" for key, value in attributes)
    if not nodelet.config and not nodelet.parameters:
        return [opening + "/>"]
    return [
        opening + ">",
        *(
            f"    <param name={quoteattr(name)} type={quoteattr(type_)} value={quoteattr(text)}/>"
            for name, type_, text in nodelet.parameters
        ),
        *(
            f"    <connection port={quoteattr(port)} topic={quoteattr(topic)}/>"
            for port, topic in sorted(nodelet.config.items())
        ),
        "  </nodelet>",
    ]


_BOOL = Attribute(("true", "false", "1", "0"))
_CONNECTION = Element("connection", attributes={"port": NEEDED, "topic": NEEDED}, may_repeat=True)
_PARAM = Element(
    "param",
    attributes={"name": NEEDED, "type": ANY, "value": NEEDED},
    may_repeat=True,
)
_NODELET = Element(
    "nodelet",
    _CONNECTION,
    _PARAM,
    attributes={
        "name": NEEDED,
        "transformation": NEEDED,
        "manager": ANY,
        "protected": _BOOL,
        "isolated": _BOOL,
    },
    may_repeat=True,
)
_WIRING = Element(
    "wiring",
    TRANSFORMATIONS,
    Element("nodelets", _NODELET),
    attributes={"version": Attribute((VERSION,), is_required=True)},
)


def too_many_nodelets(limit: int) -> str:
    """Say that there are more nodelets in a wiring than may run."""
    return f"more than {limit} nodelets; the manager allows no more (its ~limits/nodelets)"


def read_wiring(
    data: bytes, file: str, limit: Callable[[], int] = lambda: NO_GUARDS.nodelets
) -> Wiring:
    """Read a wiring.

    Args:
        data: The XML, in UTF-8.
        file: The name to use in messages.
        limit: Returns how many nodelets there may be. It is called for the first nodelet beyond
            the default limit, and reading ends there if that is the limit.

    Raises:
        SpecificationError: with every problem of the file.
    """
    findings = Findings(file, DEFAULT_LIMITS.problems)
    reader = _WiringReader(findings, limit)
    transformations: List[Transformation] = []
    with contextlib.suppress(EnoughProblems):
        transformations.extend(transformations_of(reader.drafts(data), findings))
    findings.raise_if_any()
    return Wiring(
        tuple(sorted(transformations, key=lambda each: each.label)),
        tuple(sorted(reader.nodelets, key=lambda each: each.name)),
    )


class _WiringReader(SpecificationReader):
    """Reads the nodelets of a wiring beside its transformations.

    Attributes:
        nodelets: those that were read; to be used only if no problem was noted.
    """

    def __init__(self, findings: Findings, limit: Callable[[], int]) -> None:
        super().__init__(findings, DEFAULT_LIMITS, _WIRING)
        self._limit = limit
        self._most = NO_GUARDS.nodelets
        self.nodelets: List[SpawnRequest] = []
        self._lines: Dict[str, int] = {}
        self._connections: Dict[str, str] = {}
        self._parameters: List[Parameter] = []
        self.on_start.update(wiring=self._begin_wiring, nodelet=self._begin_nodelet)
        self.on_end.update(
            connection=self._end_connection, param=self._end_param, nodelet=self._end_nodelet
        )

    def _begin_wiring(self, attributes: Attributes, line: int) -> None:
        if attributes["version"] is None:
            raise EnoughProblems  # what another version means is not known

    def _begin_nodelet(self, attributes: Attributes, line: int) -> None:
        if len(self.nodelets) >= self._most:
            self._most = self._limit()
        if len(self.nodelets) >= self._most:
            self._findings.problem(line, too_many_nodelets(self._most))
            raise EnoughProblems
        self._connections = {}
        self._parameters = []

    def _end_param(self, attributes: Attributes, line: int) -> None:
        name, value = attributes["name"], attributes["value"]
        if name is not None and value is not None:
            self._parameters.append(Parameter(name, attributes.get("type") or "", value))

    def _end_connection(self, attributes: Attributes, line: int) -> None:
        port, topic = attributes["port"], self._global(attributes, "topic", line)
        if port == "":
            self._findings.problem(line, 'port=""; expected the name of a port')
        if port in self._connections:
            self._findings.problem(line, f"the port '{port}' is there already; expected it once")
        if port is not None:
            self._connections[port] = topic

    def _end_nodelet(self, attributes: Attributes, line: int) -> None:
        name, label = self._global(attributes, "name", line), attributes["transformation"]
        if label == "":
            self._findings.problem(line, 'transformation=""; expected the label of one')
        first = self._lines.setdefault(name, line)
        if name and first != line:
            self._findings.problem(line, f"the nodelet '{name}' is there already, in line {first}")
        self.nodelets.append(
            SpawnRequest(
                label or "",
                name,
                self._connections,
                attributes.get("protected") in ("true", "1"),
                attributes.get("isolated") in ("true", "1"),
                self._global(attributes, "manager", line) if attributes.get("manager") else "",
                tuple(self._parameters),
            )
        )

    def _global(self, attributes: Attributes, key: str, line: int) -> str:
        """Return the global name that an attribute has; empty if there is a problem with it."""
        name = attributes[key]
        if name is None:
            return ""
        try:
            if names.check(name, key).startswith("/"):
                return name
            self._findings.problem(line, f"{key}=\"{name}\"; expected a global name, '/{name}'")
        except InvalidName as error:
            self._findings.problem(line, str(error))
        return ""
