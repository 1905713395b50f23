# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A specification as it was written: texts and lines, before templates and checks."""

from __future__ import annotations

from typing import Callable, Iterator, List, NamedTuple, Optional, Tuple


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
    """A `<port>`; what was left out of its attributes is empty."""

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


class TransformationDraft:
    """One `<transformation>` as read.

    Attributes:
        line: The line of the start tag.
        type: The type, empty when it was left out or is not one (which was reported).
        cost: The cost as text, 1 when it was left out.
        isolated: Whether it says that nodelets get processes of their own.
        node: The node of others that it describes; None when it describes none.
        label: The label; None when it is missing (which was reported).
        label_line: The line of the label.
        source: The source; None when it is missing (which was reported if it is required).
        source_line: The line of the source.
        args: The variables of the template.
        parameters: The parameters, in the order written.
        ports: The ports, in the order written.
        tags: The tags, in the order written.
        ports_known: Whether `ports` is complete; False when a port could not be read.
        has_variables: Whether some text contains `${`.
    """

    __slots__ = (
        "args",
        "cost",
        "has_variables",
        "isolated",
        "label",
        "label_line",
        "line",
        "node",
        "parameters",
        "ports",
        "ports_known",
        "source",
        "source_line",
        "tags",
        "type",
    )

    def __init__(self, line: int) -> None:
        self.line = line
        self.type = ""
        self.cost = "1"
        self.isolated = False
        self.node: Optional[str] = None
        self.label: Optional[str] = None
        self.label_line = line
        self.source: Optional[str] = None
        self.source_line = line
        self.args: List[ArgDraft] = []
        self.parameters: List[ParameterDraft] = []
        self.ports: List[PortDraft] = []
        self.tags: List[TagDraft] = []
        self.ports_known = True
        self.has_variables = False

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
        made = TransformationDraft(self.line)
        made.type = self.type
        made.cost = render(self.cost)
        made.isolated = self.isolated
        made.node = None if self.node is None else render(self.node)
        made.label = None if self.label is None else render(self.label)
        made.label_line = self.label_line
        made.source = None if self.source is None else render(self.source)
        made.source_line = self.source_line
        made.parameters = [
            ParameterDraft(render(name), type_, render_value(text), line)
            for name, type_, text, line in self.parameters
        ]
        made.ports = [
            PortDraft(
                render(name), direction, render(datatype), line, render(rate), render(latency)
            )
            for name, direction, datatype, line, rate, latency in self.ports
        ]
        made.tags = [TagDraft(render(port), render(text), line) for port, text, line in self.tags]
        made.ports_known = self.ports_known
        return made
