# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Makes transformations, with the checks that a grammar cannot make."""

from __future__ import annotations

import re
from functools import lru_cache
from sys import intern

from dyknow.errors import InvalidTag, InvalidType
from dyknow.formulas.types import Lookup
from dyknow.manager.specifications.findings import EnoughProblems, Findings, listed, meant, shorten
from dyknow.manager.specifications.formula_parts import FormulaParts
from dyknow.manager.specifications.tags import Term, parse_tag
from dyknow.manager.specifications.template import Concepts
from dyknow.manager.specifications.values import BadValue, filled, infer_type, parse_value
from dyknow.manager.specifications.xml_reader import XmlNode
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import (
    FORMULA,
    FORMULA_CLASS,
    IN,
    NODE,
    NODELET,
    OUT,
    TOPIC,
    Parameter,
    Port,
    Program,
    Requirement,
    Transformation,
)

_MAX_COST = 2**32 - 1

_ROS_NAME = re.compile(r"[A-Za-z~/][A-Za-z0-9_/]*\Z")
_GLOBAL_NAME = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+\Z")
_DATATYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*\Z")
_COST = re.compile(r"\+?[0-9]{1,20}\Z")
#: Rates and latencies have at most six decimal places, and are no larger than this.
_DECIMAL = re.compile(r"(?=.{1,20}\Z)\+?([0-9]+(\.[0-9]{0,6})?|\.[0-9]{1,6})\Z")
_MAX_DECIMAL = 1_000_000
#: Numbers that out-ports may state, each with the least value and the expected text.
_STATED = {
    "rate": (1e-6, "Hz above 0, such as 30 or 0.5"),
    "latency": (0.0, "seconds from 0, such as 0.05"),
}


class Builder:
    """Builds the transformations of one text; their labels must differ."""

    def __init__(self, findings: Findings, ontology: Concepts | None, types: Lookup) -> None:
        self._findings = findings
        self._types = types
        self._ontology = ontology
        self._limits = findings.limits
        self._labels: dict[str, int] = {}
        self._nodes: dict[str, int] = {}
        self._good_yaml: set[str] = set()
        self._yaml_size = 0

    def build(self, node: XmlNode) -> Transformation | None:
        """Check a `<transformation>` without variables, and make the transformation.

        It is to be used only if no problem was noted; None if there is no label, or neither a
        source nor a node.
        """
        kind = node.get("type") or NODELET
        label, source = node.child("label"), node.child("source")
        if label is not None:
            self._check_label(label)
        if source is not None:
            self._check_source(kind, source)
        isolated = node.get("isolated") == "true"
        if kind == TOPIC and isolated:
            self._warning(node, "a topic has no process; isolated has no effect")
        external = node.attributes.get("node")
        if external is not None:
            self._check_external(node, kind, external, isolated)
        cost = self._cost(node)
        parameters = self._parameters(node, kind, external)
        ports = self.ports(node)
        source_text = "" if source is None else source.text
        if kind == FORMULA or node.child("formula") is not None:
            ports, parameters = self._formula(node, kind, ports)
            source_text = FORMULA_CLASS
        requires = self._requirements(node)
        self._check_variables(node, kind, ports, parameters)
        if label is None or (not source_text and external is None):
            return None
        return Transformation(
            label.text,
            source_text,
            kind,
            cost,
            parameters,
            ports,
            isolated,
            external or "",
            requires,
        )

    def _formula(
        self, node: XmlNode, kind: str, ports: tuple[Port, ...]
    ) -> tuple[tuple[Port, ...], tuple[Parameter, ...]]:
        """Return the ports and parameters of the nodelet of a formula."""
        element = node.child("formula")
        if kind != FORMULA:
            self._problem(node, 'a <formula>: expected it with type="formula" alone')
            return ports, ()
        if element is None:
            self._problem(node, 'type="formula": expected a <formula>')
            return ports, ()
        for name in ("source", "params"):
            if any(each.name == name for each in node.children):
                self._problem(element, f"a formula has no <{name}>; expected <formula> alone")
        if not _ports_are_known(node):
            return (), ()
        parts = FormulaParts(node, element, self._problem, self._types)
        for concept in parts.concepts:
            if self._ontology is not None and not self._ontology.is_class(concept):
                unknown = f"a quantifier has the concept '{shorten(concept)}', which is no class"
                self._warning(element, f"{unknown} of the ontology")
        return parts.built(ports)

    def _requirements(self, node: XmlNode) -> tuple[Requirement, ...]:
        found = []
        for each in node.children:
            if each.name == "requires" and each.is_good:
                term = _read_tag(each.text)
                if isinstance(term, InvalidTag):
                    self._problem(each, f"<requires> '{shorten(each.text)}': {term.expected}")
                found.append(Requirement(each.text, each.get("initially", "true") == "true"))
        return tuple(dict.fromkeys(found))

    def _problem(self, node: XmlNode, message: str) -> None:
        self._findings.problem(node.line, message)

    def _warning(self, node: XmlNode, message: str) -> None:
        self._findings.warning(node.line, message)

    def _check_label(self, label: XmlNode) -> None:
        if not label.text:
            self._problem(label, "<label> is empty; expected the transformation's name")
            return
        first = self._labels.get(label.text)
        if first is not None:
            is_template = first == label.line
            place = "results twice" if is_template else f"is there already, in line {first}"
            self._problem(
                label, f"the label '{shorten(label.text)}' {place}; expected labels that differ"
            )
        self._labels.setdefault(label.text, label.line)

    def _check_source(self, kind: str, source: XmlNode) -> None:
        if kind == TOPIC:
            self._check_name("topic", source)
        elif kind == NODE:
            try:
                Program.of(source.text)
            except ValueError as error:
                self._problem(
                    source,
                    f"<source> '{shorten(source.text)}': {shorten(str(error))}; expected the "
                    "program of the node, package/executable, and its arguments",
                )
        else:
            trouble, _ = _name_trouble(source.text)
            if trouble:
                self._problem(source, f"<source> {trouble}; expected the nodelet, package/Class")

    def _check_external(self, node: XmlNode, kind: str, name: str, isolated: bool) -> None:
        """Check that the transformation is the only one that describes an external node."""
        if kind != NODE:
            self._problem(node, f'node="{shorten(name)}": expected it with type="node" alone')
        elif not _GLOBAL_NAME.match(name):
            self._problem(
                node,
                f'node="{shorten(name)}": expected the global name of a node that others start, '
                "such as /robot/camera_driver",
            )
        elif name in self._nodes:
            self._problem(
                node,
                f"the node '{shorten(name)}' is described already, in line {self._nodes[name]}; "
                "expected one transformation for it, with all of its ports",
            )
        elif isolated:
            self._warning(
                node, "a node that others start is as they start it; isolated has no effect"
            )
        self._nodes.setdefault(name, node.line)

    def _cost(self, node: XmlNode) -> int:
        text = node.get("cost", "1")
        cost = int(text) if _COST.match(text) else _MAX_COST + 1
        if cost > _MAX_COST:
            self._problem(
                node, f'cost="{shorten(text)}": expected an integer from 0 to {_MAX_COST}'
            )
        return cost

    def _parameters(self, node: XmlNode, kind: str, external: str | None) -> tuple[Parameter, ...]:
        made: list[Parameter] = []
        lines: dict[str, int] = {}
        for param in node.all("params"):
            name = param.get("name")
            self._check_name("parameter", param, name)
            if name[:1] in ("/", "~"):
                self._problem(
                    param,
                    f"the parameter '{shorten(name)}' is set in the nodelet's own namespace; "
                    f"expected '{shorten(name.lstrip('~/'))}'",
                )
            if name in lines:
                self._problem(
                    param,
                    f"the parameter '{shorten(name)}' is there already, in line {lines[name]}",
                )
            lines[name] = param.line
            type_ = param.get("type") or infer_type(param.text)
            self._check_value(name, type_, param)
            made.append(Parameter(intern(name), type_, param.text))
        if made and (kind == TOPIC or external is not None):
            what = "a topic" if kind == TOPIC else "a node that others start"
            self._warning(node, f"{what} has no parameters; these will never be set")
        return tuple(made)

    def _check_value(self, name: str, type_: str, param: XmlNode) -> None:
        text = param.text
        if type_ == "yaml":
            if text in self._good_yaml:
                return
            self._yaml_size += len(text)
            if self._yaml_size > self._limits.yaml_size:
                limit = self._limits.yaml_size
                self._problem(param, f"more than {limit} characters of YAML in this text")
                raise EnoughProblems
        names = dict.fromkeys(variables_of(text), "name")
        if names and type_ not in ("string", "yaml"):
            return  # it is checked when the name is known
        try:
            parse_value(type_, filled(type_, text, names, self._limits), self._limits)
        except BadValue as error:
            self._problem(param, f"the parameter '{shorten(name)}': {error}")
            return
        if type_ == "yaml":
            self._good_yaml.add(text)

    def ports(self, node: XmlNode, is_template: bool = False) -> tuple[Port, ...]:
        """Check the ports and tags, also of a template that cannot be expanded."""
        ports = node.all("ports")
        lines: dict[str, int] = {}
        stated: dict[str, tuple[float, float]] = {}
        for port in ports:
            name = port.text
            if not is_template:
                self._check_name("port", port)
                datatype = port.get("datatype")
                if datatype and not _DATATYPE.match(datatype):
                    expected = "expected a ROS type such as sensor_msgs/Image"
                    self._problem(port, f'datatype="{shorten(datatype)}": {expected}')
                if not _STATED.keys().isdisjoint(port.attributes):
                    stated[name] = (self._stated("rate", port), self._stated("latency", port))
            if name in lines:
                self._problem(
                    port,
                    f"the port '{shorten(name)}' is there already, in line {lines[name]}; "
                    "expected names that differ, also between in and out",
                )
            lines.setdefault(name, port.line)
        tags: dict[str, list[str]] = {name: [] for name in lines}
        self._distribute_tags(node, tags)
        outs = sum(port.get("type") == OUT for port in ports)
        ins = len(ports) - outs
        if node.get("type") == TOPIC and _ports_are_known(node) and (ins, outs) != (0, 1):
            self._problem(
                node,
                f"a topic with {ins} in-port{'s' * (ins != 1)} and {outs} "
                f"out-port{'s' * (outs != 1)}; expected exactly one port, of type out",
            )
        return tuple(
            Port(
                intern(port.text),
                intern(port.get("type")),
                intern(port.get("datatype")),
                tuple(tags[port.text]),
                *stated.get(port.text, ()),
            )
            for port in ports
        )

    def _stated(self, name: str, port: XmlNode) -> float:
        """Read a number that an out-port states; 0 if it does not."""
        text = port.attributes.get(name)
        if text is None:
            return 0.0
        if port.get("type") != OUT:
            self._problem(port, f"an in-port with a {name}; expected one of out-ports alone")
        least, expected = _STATED[name]
        value = float(text) if _DECIMAL.match(text) else -1.0
        if not least <= value <= _MAX_DECIMAL:
            self._problem(
                port,
                f'{name}="{shorten(text)}": expected {expected}, at most {_MAX_DECIMAL} and '
                "with at most six decimal places",
            )
        return value

    def _distribute_tags(self, node: XmlNode, tags: dict[str, list[str]]) -> None:
        for tag in node.all("tags"):
            port, text = tag.get("port"), tag.text
            if not text:
                self._problem(tag, "<tag> is empty; expected a term such as Image(cam1)")
            of_port = tags.get(port)
            if of_port is None:
                if _ports_are_known(node):
                    self._problem(
                        tag,
                        f"the tag is for the port '{shorten(port)}', which is not declared; known "
                        f"ports: {listed(tags)}{meant(port, tags)}",
                    )
            elif text in of_port:
                self._warning(tag, f"the port '{shorten(port)}' has this tag already")
            else:
                of_port.append(text)
                found, quoted = _read_tag(text), f"the tag '{shorten(text)}'"
                if isinstance(found, InvalidType):
                    self._problem(tag, f"{quoted}: {found.expected}")
                elif isinstance(found, InvalidTag) and text:
                    self._warning(tag, f"{quoted} is passed over by the planner: {found.expected}")

    def _check_name(self, what: str, node: XmlNode, name: str | None = None) -> None:
        name = node.text if name is None else name
        trouble, doubt = _name_trouble(name)
        if trouble:
            self._problem(node, f"the name of a {what} {trouble}; expected a ROS name")
        elif doubt:
            self._warning(
                node, f"the {what} '{shorten(name)}' {doubt}; some tools will not find it"
            )

    def _check_variables(
        self, node: XmlNode, kind: str, ports: tuple[Port, ...], parameters: tuple[Parameter, ...]
    ) -> None:
        """Note unbound variables, and types that are not classes.

        The streams at the in-ports of a nodelet bind its variables, so tags of out-ports, texts
        of parameters and requirements may use only variables that stand in the tags of in-ports.
        """
        directions = {port.name: port.direction for port in ports}
        used: list[tuple[str, str, XmlNode]] = []  # variable, where, element
        bound: dict[str, None] = {}
        for tag in node.all("tags"):
            term = _read_tag(tag.text) if "?" in tag.text else None
            if not isinstance(term, Term):
                continue
            where = f"the tag '{shorten(tag.text)}'"
            for type_ in term.types:
                if type_ and self._ontology is not None and not self._ontology.is_class(type_):
                    unknown = f"{where} has the type '{shorten(type_)}', which is no class"
                    self._warning(tag, f"{unknown} of the ontology")
            direction = directions.get(tag.get("port"), "")
            if direction == IN:
                bound.update(dict.fromkeys(term.variables))
            elif direction or kind != FORMULA:  # else it is of individuals
                used += [(each, where, tag) for each in term.variables]
        for each in node.children:
            term = _read_tag(each.text) if each.name == "requires" else None
            if isinstance(term, Term):
                where = f"<requires> '{shorten(each.text)}'"
                used += [(variable, where, each) for variable in term.variables]
        texts = [(param.get("name"), param.text, param) for param in node.all("params")]
        if kind == FORMULA:
            texts += [(name, text, node) for name, _, text in parameters]
        for name, text, element in texts:
            where = f"the parameter '{shorten(name)}'"
            used += [(variable, where, element) for variable in variables_of(text)]
        for variable, where, element in used:
            if kind == TOPIC:
                self._problem(
                    element,
                    f"{where} of a topic has the variable {shorten(variable)}; expected names, as "
                    "nothing binds it",
                )
            elif variable not in bound and _ports_are_known(node):
                self._problem(
                    element,
                    f"{where} has the variable {shorten(variable)}, which no tag of an in-port "
                    f"binds; known variables: {listed(bound)}{meant(variable, bound)}",
                )


def _ports_are_known(node: XmlNode) -> bool:
    """Whether all ports could be read."""
    sections = (each for each in node.children if each.name == "ports")
    return all(port.is_good for section in sections for port in section.children)


@lru_cache(maxsize=4096)
def _read_tag(text: str) -> Term | InvalidTag:
    """Read a tag, which is read several times, or return its fault."""
    try:
        return parse_tag(text)
    except InvalidTag as error:
        return error


@lru_cache(maxsize=4096)
def _name_trouble(name: str) -> tuple[str, str]:
    """Return the fault of a name and the doubt about it; empty texts for a ROS name."""
    if not name:
        return "is empty", ""
    if name.split() != [name]:
        return f"has white space in it, '{shorten(name)}'", ""
    if _ROS_NAME.match(name) and "//" not in name:
        return "", ""
    return "", "is no ROS name (a letter, then letters, digits, '_' and '/')"
