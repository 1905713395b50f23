# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads specification XML into drafts: texts and lines, before templates and checks.

The elements are those of `transformations.rng`, which is for people and their editors; a test
compares the two.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from sys import intern
from typing import Callable, Iterator, List, NamedTuple, Optional, Tuple, Union

from dyknow.manager.specifications.findings import Findings
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.xml_reader import (
    ANY,
    NEEDED,
    Attribute,
    Attributes,
    Element,
    Unreadable,
    XmlReader,
)


class ArgDraft(NamedTuple):
    """An `<arg>`: a variable of the template and where its terms come from."""

    label: str
    terms: str
    line: int


class ParameterDraft(NamedTuple):
    """A `<param>`; the type is empty when it was left out."""

    name: str
    type: str
    text: str
    line: int


class PortDraft(NamedTuple):
    """A `<port>`; missing attributes are empty."""

    name: str
    direction: str
    datatype: str
    line: int
    rate: str = ""
    latency: str = ""


class TagDraft(NamedTuple):
    """A `<tag>`."""

    port: str
    text: str
    line: int


@dataclass
class TransformationDraft:
    """One `<transformation>` as read; missing or unreadable values are None or empty.

    Attributes:
        line: The line of the start tag.
        node: The external node that it describes, if any.
        ports_known: Whether `ports` is complete; False when a port could not be read.
        has_variables: Whether some text contains `${`.
    """

    line: int
    type: str = ""
    cost: str = "1"
    isolated: bool = False
    node: Optional[str] = None
    label: Optional[str] = None
    label_line: int = 0
    source: Optional[str] = None
    source_line: int = 0
    args: List[ArgDraft] = field(default_factory=list)
    parameters: List[ParameterDraft] = field(default_factory=list)
    ports: List[PortDraft] = field(default_factory=list)
    tags: List[TagDraft] = field(default_factory=list)
    ports_known: bool = True
    has_variables: bool = False

    def values(self) -> Iterator[Tuple[str, int]]:
        """The texts of parameters, with their lines: variables are substituted there too."""
        for parameter in self.parameters:
            yield parameter.text, parameter.line

    def texts(self) -> Iterator[Tuple[str, int]]:
        """The other texts in which variables are substituted, with their lines."""
        yield self.cost, self.line
        yield self.node or "", self.line
        yield self.label or "", self.label_line
        yield self.source or "", self.source_line
        for parameter in self.parameters:
            yield parameter.name, parameter.line
        for port in self.ports:
            yield port.name, port.line
            yield port.datatype, port.line
            yield port.rate, port.line
            yield port.latency, port.line
        for tag in self.tags:
            yield tag.port, tag.line
            yield tag.text, tag.line

    def map(
        self, render: Callable[[str], str], render_value: Callable[[str], str]
    ) -> TransformationDraft:
        """Make a copy in which all of `texts` and `values` are rendered."""
        return replace(
            self,
            cost=render(self.cost),
            node=None if self.node is None else render(self.node),
            label=None if self.label is None else render(self.label),
            source=None if self.source is None else render(self.source),
            args=[],
            parameters=[
                each._replace(name=render(each.name), text=render_value(each.text))
                for each in self.parameters
            ],
            ports=[
                PortDraft(
                    render(name), direction, render(datatype), line, render(rate), render(latency)
                )
                for name, direction, datatype, line, rate, latency in self.ports
            ],
            tags=[TagDraft(render(port), render(text), line) for port, text, line in self.tags],
            has_variables=False,
        )


_ARG = Element("arg", attributes={"label": NEEDED}, holds_text=True, may_repeat=True)
_PARAM = Element(
    "param",
    attributes={"name": NEEDED, "type": Attribute(("string", "int", "double", "bool", "yaml"))},
    holds_text=True,
    may_repeat=True,
)
_PORT = Element(
    "port",
    attributes={
        "type": Attribute(("in", "out"), is_required=True),
        "datatype": ANY,
        "rate": ANY,
        "latency": ANY,
    },
    holds_text=True,
    may_repeat=True,
)
_TAG = Element("tag", attributes={"port": NEEDED}, holds_text=True, may_repeat=True)

TRANSFORMATION = Element(
    "transformation",
    Element("label", holds_text=True, is_required=True),
    Element("source", holds_text=True, is_required=True, unless="node"),
    Element("args", _ARG),
    Element("params", _PARAM),
    Element("ports", _PORT),
    Element("tags", _TAG),
    attributes={
        "type": Attribute(("nodelet", "node", "topic")),
        "cost": ANY,
        "isolated": Attribute(("true", "false")),
        "node": ANY,
    },
    may_repeat=True,
)
TRANSFORMATIONS = Element("transformations", TRANSFORMATION)


class SpecificationReader(XmlReader):
    """Makes a draft of each transformation that is complete, problems or not."""

    def __init__(self, findings: Findings, limits: SpecificationLimits, *roots: Element) -> None:
        """Prepare to read a specification, or another text with transformations in it."""
        super().__init__(findings, limits, *(roots or (TRANSFORMATION, TRANSFORMATIONS)))
        self._draft = TransformationDraft(0)
        self._ready: List[TransformationDraft] = []
        self._count = 0
        self._items = 0
        self.on_start["transformation"] = self._begin_transformation
        self.on_end["transformation"] = self._end_transformation
        self.on_text.update(
            label=self._label,
            source=self._source,
            arg=self._arg,
            param=self._param,
            port=self._port,
            tag=self._tag,
        )

    def drafts(self, text: Union[str, bytes]) -> Iterator[TransformationDraft]:
        """Read a text; yield its transformations one after the other.

        Args:
            text: The XML, as characters or as UTF-8.
        """
        for _ in self.read(text):
            yield from self._ready
            self._ready.clear()

    def _begin_transformation(self, attributes: Attributes, line: int) -> None:
        self._count += 1
        self._items = 0
        if self._count > self._limits.transformations:
            raise Unreadable(
                line, f"more than {self._limits.transformations} transformations in one text"
            )
        self._draft = TransformationDraft(line)
        self._draft.type = attributes.get("type") or ""
        self._draft.cost = attributes.get("cost", "1") or ""
        self._draft.isolated = attributes.get("isolated") == "true"
        self._draft.node = (attributes["node"] or "") if "node" in attributes else None
        self.has_variables = "${" in self._draft.cost or "${" in (self._draft.node or "")

    def _end_transformation(self, _: Attributes, __: int) -> None:
        self._draft.has_variables = self.has_variables
        self._ready.append(self._draft)

    def _label(self, text: Optional[str], _: Attributes, line: int) -> None:
        if text is not None and self._draft.label is None:
            self._draft.label, self._draft.label_line = text, line

    def _source(self, text: Optional[str], _: Attributes, line: int) -> None:
        if text is not None and self._draft.source is None:
            self._draft.source, self._draft.source_line = text, line

    def _arg(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        label = attributes["label"]
        if label is not None:
            self._draft.args.append(ArgDraft(label, text or "", line))

    def _param(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        name, type_ = attributes["name"], attributes.get("type", "")
        if name is not None and type_ is not None and text is not None:
            self._draft.parameters.append(ParameterDraft(intern(name), type_, text, line))

    def _port(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        direction, datatype = attributes["type"], attributes.get("datatype", "")
        rate, latency = attributes.get("rate", ""), attributes.get("latency", "")
        if (
            text is not None
            and direction is not None
            and datatype is not None
            and rate is not None
            and latency is not None
        ):
            port = PortDraft(intern(text), direction, intern(datatype), line, rate, latency)
            self._draft.ports.append(port)
        else:
            self._draft.ports_known = False

    def _tag(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        port = attributes["port"]
        if port is not None and text is not None:
            self._draft.tags.append(TagDraft(port, text, line))

    def _count_item(self, line: int) -> None:
        self._items += 1
        if self._items > self._limits.items:
            raise Unreadable(
                line,
                f"more than {self._limits.items} args, params, ports and tags in one "
                "<transformation>",
            )
