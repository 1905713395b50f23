# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A whole wiring, as a value and as XML: nodelets, their connections and transformations."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Callable, Iterable, Iterator, Mapping
from xml.sax.saxutils import quoteattr

from dyknow import names
from dyknow.errors import DyKnowError, InvalidName, Problem
from dyknow.guards import NO_GUARDS
from dyknow.manager.claims.ends import transformation_made_here
from dyknow.manager.specifications.findings import EnoughProblems, Findings
from dyknow.manager.specifications.specification import TRANSFORMATIONS, transformations_of
from dyknow.manager.specifications.xml_reader import (
    ANY,
    NEEDED,
    Attribute,
    Element,
    XmlNode,
    XmlReader,
)
from dyknow.model.graph import Model, NodeletStatus, SpawnRequest
from dyknow.model.hosts import AT
from dyknow.model.transformation import Parameter, Transformation

VERSION = "1"


class CannotSave(DyKnowError):
    """A wiring cannot be written so that it could be read again."""


#: The first part of what a line is of: a transformation by its label, a nodelet by its name.
#: Of a connection, the nodelet's name and the port.
TRANSFORMATION, NODELET = "transformation", "nodelet"


@dataclass(frozen=True)
class Wiring:
    """Requests for nodelets, by name, and the transformations they are made from, by label."""

    transformations: tuple[Transformation, ...] = ()
    nodelets: tuple[SpawnRequest, ...] = ()
    file: str = field(default="the wiring", compare=False)  # where it was read
    lines: Mapping[tuple[str, str], int] = field(default_factory=dict, compare=False)

    def problem(self, message: str, part: tuple[str, str]) -> Problem:
        """Name the line of a problem: that of a part; 0 if it has none."""
        return Problem(self.file, self.lines.get(part, 0), message)

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


def wiring_of(
    snapshot: Model, pinned: Mapping[str, str] = MappingProxyType({})
) -> tuple[Wiring, list[NodeletStatus]]:
    """Take the wiring out of a model; ``pinned`` are the hosts that spawns named, by nodelet.

    Returns it, and the nodelets that it leaves out: those without a transformation. Raises
    CannotSave if a transformation is gone that a nodelet was made from.
    """
    known = {each.label: each for each in snapshot.transformations}
    own = [nodelet for nodelet in snapshot.nodelets if nodelet.transformation]
    made = (transformation_made_here(each) for each in own if each.transformation not in known)
    known.update({each.label: each for each in made if each is not None})
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
    own.sort(key=lambda each: each.name)
    wiring = Wiring(
        tuple(known[label] for label in sorted(used)),
        tuple(request_of(each, pinned) for each in own),
    )
    return wiring, [nodelet for nodelet in snapshot.nodelets if not nodelet.transformation]


def request_of(nodelet: NodeletStatus, pinned: Mapping[str, str]) -> SpawnRequest:
    """Return the request that makes a nodelet again, on the host that it is pinned to."""
    host = pinned.get(nodelet.name)
    return replace(nodelet.request, manager=AT + host) if host else nodelet.request


def _nodelet_xml(nodelet: SpawnRequest) -> list[str]:
    attributes = [("name", nodelet.name), ("transformation", nodelet.label)]
    place = ("host", nodelet.host) if nodelet.host else ("manager", nodelet.manager)
    attributes.extend([place] if nodelet.manager else [])
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
_VALUE = Attribute(is_required=True, is_verbatim=True)
_PARAM = Element(
    "param", attributes={"name": NEEDED, "type": ANY, "value": _VALUE}, may_repeat=True
)
_NODELET = Element(
    "nodelet",
    (_CONNECTION, _PARAM),
    attributes={
        "name": NEEDED,
        "transformation": NEEDED,
        "manager": ANY,
        "host": ANY,
        "protected": _BOOL,
        "isolated": _BOOL,
    },
    may_repeat=True,
    is_unit=True,
)
_WIRING = Element(
    "wiring",
    (TRANSFORMATIONS, Element("nodelets", (_NODELET,))),
    attributes={"version": Attribute((VERSION,), is_required=True, is_version=True)},
)


def too_many_nodelets(limit: int) -> str:
    """Say that there are more nodelets in a wiring than may run."""
    return f"more than {limit} nodelets; the manager allows no more (its ~limits/nodelets)"


def read_wiring(
    data: bytes, file: str, limit: Callable[[], int] = lambda: NO_GUARDS.nodelets
) -> Wiring:
    """Read a wiring, XML in UTF-8, or raise SpecificationError with every problem of the file.

    ``limit`` returns how many nodelets there may be. It is called for the first nodelet beyond the
    default limit, and reading ends there if that is the limit.
    """
    findings = Findings(file)
    nodelets = _NodeletReader(findings, limit)
    units = XmlReader(findings, _WIRING).read(data)
    transformations: list[Transformation] = []
    with contextlib.suppress(EnoughProblems):
        for each in transformations_of(nodelets.take(units), findings):
            transformations.append(each)
            nodelets.lines[TRANSFORMATION, each.label] = nodelets.line
    findings.raise_if_any()
    return Wiring(
        tuple(sorted(transformations, key=lambda each: each.label)),
        tuple(sorted(nodelets.requests, key=lambda each: each.name)),
        file,
        nodelets.lines,
    )


class _NodeletReader:
    """Reads the nodelets of a wiring."""

    def __init__(self, findings: Findings, limit: Callable[[], int]) -> None:
        self._findings = findings
        self._limit = limit
        self._most = NO_GUARDS.nodelets
        #: Those that were read; to be used only if no problem was noted.
        self.requests: list[SpawnRequest] = []
        self.lines: dict[tuple[str, str], int] = {}
        self.line = 0  # of the unit that was returned last

    def take(self, units: Iterable[XmlNode]) -> Iterator[XmlNode]:
        """Read the nodelets among the units, and return the transformations."""
        for unit in units:
            if unit.name == "nodelet":
                self._read(unit)
            else:
                self.line = unit.line
                yield unit

    def _read(self, nodelet: XmlNode) -> None:
        if len(self.requests) >= self._most:
            self._most = self._limit()
        if len(self.requests) >= self._most:
            self._findings.problem(nodelet.line, too_many_nodelets(self._most))
            raise EnoughProblems
        name, label = self._global(nodelet, "name"), nodelet.get("transformation", "-")
        if not label:
            self._findings.problem(nodelet.line, 'transformation=""; expected the label of one')
        first = self.lines.get((NODELET, name))
        if name and first is not None:
            self._findings.problem(
                nodelet.line, f"the nodelet '{name}' is there already, in line {first}"
            )
        self.lines.setdefault((NODELET, name), nodelet.line)
        good = [each for each in nodelet.children if each.is_good]
        config: dict[str, str] = {}
        for each in good:
            if each.name == "connection":
                self._connect(config, each)
                self.lines[name, each.get("port")] = each.line
        self.requests.append(
            SpawnRequest(
                label,
                name,
                config,
                nodelet.get("protected") in ("true", "1"),
                nodelet.get("isolated") in ("true", "1"),
                self._place(nodelet),
                tuple(
                    Parameter(each.get("name"), each.get("type"), each.get("value"))
                    for each in good
                    if each.name == "param"
                ),
            )
        )

    def _place(self, nodelet: XmlNode) -> str:
        """Return the nodelet manager, or the host, that a nodelet is to run in."""
        manager, host = nodelet.get("manager"), nodelet.get("host")
        if manager and host:
            self._findings.problem(
                nodelet.line, f'manager="{manager}" and host="{host}"; expected one of them'
            )
        if host:
            return AT + host
        return self._global(nodelet, "manager") if manager else ""

    def _connect(self, config: dict[str, str], connection: XmlNode) -> None:
        port = connection.get("port")
        if not port:
            self._findings.problem(connection.line, 'port=""; expected the name of a port')
        if port in config:
            self._findings.problem(
                connection.line, f"the port '{port}' is there already; expected it once"
            )
        config[port] = self._global(connection, "topic")

    def _global(self, node: XmlNode, key: str) -> str:
        """Return the global name that an attribute has; empty if there is a problem with it."""
        name = node.attributes.get(key)
        if name is None:
            return ""
        try:
            checked = names.check(name, key)
            if checked.startswith("/"):
                return checked
            problem = f"{key}=\"{name}\"; expected a global name, '/{name}'"
        except InvalidName as error:
            problem = str(error)
        self._findings.problem(node.line, problem)
        return ""
