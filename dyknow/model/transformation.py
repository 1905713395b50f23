# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Transformations: the blueprints that nodelets are made from, as values."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import dataclass
from decimal import Decimal
from typing import Iterable, List, Mapping, NamedTuple, Tuple

NODELET = "nodelet"
NODE = "node"
TOPIC = "topic"
FORMULA = "formula"
#: The nodelet of every formula, and the type of its out-port.
FORMULA_CLASS = "dyknow/Formula"
VERDICT = "dyknow_msgs/Verdict"
IN = "in"
OUT = "out"


class Parameter(NamedTuple):
    """A parameter that is set in the nodelet's namespace before the nodelet is loaded."""

    name: str  #: The name, relative to the nodelet
    type: str  #: `string`, `int`, `double`, `bool` or `yaml`
    text: str  #: The value as text; that of a transformation may have `placeholders`


class Port(NamedTuple):
    """A port of a nodelet, or the topic of a topic transformation."""

    name: str  #: The name, unique in the transformation across both directions
    direction: str  #: `in` or `out`
    datatype: str = ""  #: The ROS type, such as `sensor_msgs/Image`; empty when it is not stated
    tags: Tuple[str, ...] = ()  #: Semantic descriptions of the stream, in the order written
    rate: float = 0.0  #: Messages a second that an out-port sends, in Hz; 0 when it is not stated
    #: Seconds that its nodelet adds to the age of an out-port's messages; 0 when it is not stated.
    latency: float = 0.0


class Requirement(NamedTuple):
    """A verdict that has to be TRUE, for a transformation to be usable."""

    tag: str  #: the tag of the verdicts; its variables are those of the transformation
    initially: bool = True  #: whether it counts as TRUE before the first verdict


_PROGRAM = re.compile(r"([A-Za-z][\w-]*)/([\w.+-]+)\Z", re.ASCII)


class Program(NamedTuple):
    """A program of a package, with arguments, as the source of a node names it."""

    package: str  #: the name of a package
    executable: str  #: the name of a program in it
    arguments: Tuple[str, ...] = ()  #: its command-line arguments

    @classmethod
    def of(cls, source: str) -> Program:
        """Read a source: `package/executable` and arguments, quoted as in a shell.

        Raises:
            ValueError: it is something else; the text names the fault.
        """
        first, *arguments = shlex.split(source) or [""]
        found = _PROGRAM.match(first)
        if found is None:
            raise ValueError(f"'{first}' is no name of a program")
        return cls(found.group(1), found.group(2), tuple(arguments))

    @property
    def name(self) -> str:
        """The name, `package/executable`."""
        return f"{self.package}/{self.executable}"

    @property
    def source(self) -> str:
        """What `of` reads."""
        return " ".join([self.name, *map(shlex.quote, self.arguments)])


class Transformation(NamedTuple):
    """A blueprint for nodelets and nodes, or a description of an external node or topic.

    These are values: equal when they say the same, safe to share between threads. They are
    named tuples because a library may hold hundreds of thousands of them.
    """

    label: str  #: The name under which the manager keeps the transformation
    #: The nodelet's plugin name, `package/Class`; of a node `package/executable`, with its
    #: arguments as in a shell; the topic if `type` is `topic`.
    source: str
    type: str = NODELET  #: `nodelet`, `node`, `topic` or `formula`
    cost: int = 1  #: Cost of such a nodelet in a plan, 0 to 2**32 - 1
    #: Parameters to set before the load, in the order written.
    parameters: Tuple[Parameter, ...] = ()
    ports: Tuple[Port, ...] = ()  #: The ports, in the order written
    #: Whether a nodelet gets a process of its own, unless the spawn says where it goes.
    isolated: bool = False
    node: str = ""  #: Global name of the external node that this describes; empty for a blueprint
    requires: Tuple[Requirement, ...] = ()  #: Verdicts on which it depends

    @property
    def is_described(self) -> bool:
        """True for external nodes and topics, which cannot be spawned."""
        return self.type == TOPIC or bool(self.node)

    def to_xml(self) -> str:
        """Write the transformation as canonical XML: the same text for equal transformations.

        Parsing the text gives back an equal transformation, provided that this one could have
        come from a text: no value begins or ends with white space, for instance.
        """
        isolated = ' isolated="true"' if self.isolated else ""
        node = f" node={_attribute(self.node)}" if self.node else ""
        lines = [f'<transformation type="{self.type}" cost="{self.cost}"{isolated}{node}>']
        lines.append(f"  <label>{_text(self.label)}</label>")
        ports = self.ports
        if self.type == FORMULA:
            formula, more = _formula_of(self.parameters)
            lines.append(f"  {formula}")
            ports += more
        elif self.source or not self.node:
            lines.append(f"  <source>{_text(self.source)}</source>")
        if self.type != FORMULA:
            _add_section(lines, "params", [_param_xml(p) for p in self.parameters])
        _add_section(lines, "ports", [_port_xml(p) for p in ports])
        tags = [
            f"<tag port={_attribute(port.name)}>{_text(tag)}</tag>"
            for port in ports
            for tag in port.tags
        ]
        _add_section(lines, "tags", tags)
        lines += [_requires_xml(each) for each in self.requires]
        lines.append("</transformation>\n")
        return "\n".join(lines)


Transformations = Mapping[str, Transformation]
"""Transformations by label."""


@dataclass(frozen=True)
class Added:
    """The outcome of adding a specification to the library."""

    labels: Tuple[str, ...]  #: of the added or replaced transformations, sorted
    warnings: str  #: probable mistakes, one a line


def as_specification(transformations: Iterable[Transformation]) -> str:
    """Write transformations as one specification."""
    inside = "".join(each.to_xml() for each in transformations)
    return f"<transformations>\n{inside}</transformations>\n"


def _formula_of(parameters: Tuple[Parameter, ...]) -> Tuple[str, Tuple[Port, ...]]:
    """Write the formula that parameters are made of; returns the ports of individuals as well."""
    given = {name: text for name, _, text in parameters}
    settings = ("period", "hold", "delay", "exact", "max_nodes")
    attributes = [f' {name}="{given[name]}"' for name in settings if name in given]
    datatypes = json.loads(given["datatypes"])
    tags = json.loads(given.get("individuals", "{}"))
    ports = tuple(
        Port(name, IN, datatypes[name], (re.sub(r"\$\{(\?[^{}]*)\}", r"\1", tag),))
        for name, tag in sorted(tags.items())
    )
    return f"<formula{''.join(attributes)}>{_text(given['formula'])}</formula>", ports


def _requires_xml(requirement: Requirement) -> str:
    initially = "" if requirement.initially else ' initially="false"'
    return f"  <requires{initially}>{_text(requirement.tag)}</requires>"


def read_requirements(specification: str) -> Tuple[Requirement, ...]:
    """Read the requirements in a specification that `Transformation.to_xml` has written."""
    if "<requires" not in specification:
        return ()
    from xml.etree import ElementTree  # here: most specifications have none

    found = ElementTree.fromstring(specification).iter("requires")
    return tuple(
        Requirement((each.text or "").replace("$${", "${"), each.get("initially") != "false")
        for each in found
    )


def _param_xml(parameter: Parameter) -> str:
    name, type_, text = parameter
    # Templates leave placeholders, and dollars before `{?`, as they are.
    written = _escaped(re.sub(r"\$\{(?!\?)", "$${", text))
    return f'<param name={_attribute(name)} type="{type_}">{written}</param>'


def _port_xml(port: Port) -> str:
    datatype = f" datatype={_attribute(port.datatype)}" if port.datatype else ""
    rate = f' rate="{_number(port.rate)}"' if port.rate else ""
    latency = f' latency="{_number(port.latency)}"' if port.latency else ""
    return f'<port type="{port.direction}"{datatype}{rate}{latency}>{_text(port.name)}</port>'


def _number(value: float) -> str:
    """Write the shortest decimal that is read as the same number, without an exponent."""
    text = format(Decimal(repr(value)), "f")
    return text.rstrip("0").rstrip(".") if "." in text else text


def _add_section(lines: List[str], name: str, items: List[str]) -> None:
    if items:
        lines.append(f"  <{name}>")
        lines.extend(f"    {item}" for item in items)
        lines.append(f"  </{name}>")


def _text(text: str) -> str:
    # In a specification `${` opens a variable, and `$${` stands for `${` itself.
    return _escaped(text.replace("${", "$${"))


def _escaped(text: str) -> str:
    from xml.sax.saxutils import escape  # here: it imports urllib, for which nodes would wait

    return escape(text, {"\r": "&#13;"})


def _attribute(text: str) -> str:
    from xml.sax.saxutils import quoteattr

    return quoteattr(text.replace("${", "$${"), {"\r": "&#13;"})
