# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Makes transformations from drafts, with the checks that a grammar cannot make."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Dict, List, Optional, Set, Tuple

from dyknow.errors import InvalidTag, InvalidType
from dyknow.manager.specifications.findings import EnoughProblems, Findings, listed, meant, shorten
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.reader import TransformationDraft
from dyknow.manager.specifications.tags import parse_tag, with_variables
from dyknow.manager.specifications.template import Concepts
from dyknow.manager.specifications.values import BadValue, infer_type, parse_value
from dyknow.model.placeholders import fill, variables_of
from dyknow.model.transformation import (
    IN,
    NODE,
    NODELET,
    OUT,
    TOPIC,
    Parameter,
    Port,
    Program,
    Transformation,
)

MAX_COST = 2**32 - 1

_ROS_NAME = re.compile(r"[A-Za-z~/][A-Za-z0-9_/]*\Z")
_GLOBAL_NAME = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+\Z")
_DATATYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*\Z")
#: Rates and latencies have at most six decimal places, and are no larger than this.
_DECIMAL = re.compile(r"(?=.{1,20}\Z)\+?([0-9]+(\.[0-9]{0,6})?|\.[0-9]{1,6})\Z")
_MAX_DECIMAL = 1_000_000
#: Numbers that out-ports may state, each with the least value and the expected text.
_STATED = {
    "rate": (1e-6, "Hz above 0, such as 30 or 0.5"),
    "latency": (0.0, "seconds from 0, such as 0.05"),
}
_COST = re.compile(r"\+?[0-9]+\Z")


class Builder:
    """Builds the transformations of one text; their labels must differ."""

    def __init__(
        self,
        findings: Findings,
        limits: SpecificationLimits,
        ontology: Optional[Concepts] = None,
    ) -> None:
        self._findings = findings
        self._ontology = ontology
        self._limits = limits
        self._labels: Dict[str, int] = {}
        self._nodes: Dict[str, int] = {}
        self._good_yaml: Set[str] = set()
        self._yaml_size = 0

    def build(self, draft: TransformationDraft) -> Optional[Transformation]:
        """Check a draft and make the transformation.

        Returns:
            The transformation, to be used only if no problem was noted; None if the draft has
            no label, or neither a source nor a node.
        """
        self._check_label(draft)
        self._check_source(draft)
        self._check_node(draft)
        cost = self._cost(draft)
        parameters = self._parameters(draft)
        ports = self._ports(draft)
        _check_variables(draft, self._findings, self._ontology)
        if draft.label is None or (draft.source is None and draft.node is None):
            return None
        return Transformation(
            draft.label,
            draft.source or "",
            draft.type or NODELET,
            cost,
            parameters,
            ports,
            draft.isolated,
            draft.node or "",
        )

    def _check_label(self, draft: TransformationDraft) -> None:
        label, line = draft.label, draft.label_line
        if label is None:
            return
        if not label:
            self._findings.problem(line, "<label> is empty; expected the transformation's name")
        elif label in self._labels:
            first = self._labels[label]
            place = "results twice" if first == line else f"is there already, in line {first}"
            self._findings.problem(
                line, f"the label '{shorten(label)}' {place}; expected labels that differ"
            )
        else:
            self._labels[label] = line

    def _check_source(self, draft: TransformationDraft) -> None:
        if draft.source is None:
            return
        if draft.type == TOPIC:
            self._check_name("topic", draft.source, draft.source_line)
        elif draft.type == NODE:
            try:
                Program.of(draft.source)
            except ValueError as error:
                self._findings.problem(
                    draft.source_line,
                    f"<source> '{shorten(draft.source)}': {shorten(str(error))}; expected the "
                    "program of the node, package/executable, and its arguments",
                )
        else:
            trouble, _ = _name_trouble(draft.source)
            if trouble:
                self._findings.problem(
                    draft.source_line, f"<source> {trouble}; expected the nodelet, package/Class"
                )

    def _check_node(self, draft: TransformationDraft) -> None:
        """Check that it describes a node that no other one describes, if it describes one."""
        node, line = draft.node, draft.line
        if draft.type == TOPIC and draft.isolated:
            self._findings.warning(line, "a topic has no process; isolated has no effect")
        if node is None:
            return
        if draft.type != NODE:
            self._findings.problem(
                line, f'node="{shorten(node)}": expected it with type="node" alone'
            )
        elif not _GLOBAL_NAME.match(node):
            self._findings.problem(
                line,
                f'node="{shorten(node)}": expected the global name of a node that others start, '
                "such as /robot/camera_driver",
            )
        elif node in self._nodes:
            self._findings.problem(
                line,
                f"the node '{shorten(node)}' is described already, in line {self._nodes[node]}; "
                "expected one transformation for it, with all of its ports",
            )
        elif draft.isolated:
            self._findings.warning(
                line, "a node that others start is as they start it; isolated has no effect"
            )
        self._nodes.setdefault(node, line)

    def _cost(self, draft: TransformationDraft) -> int:
        if not _COST.match(draft.cost) or len(draft.cost) > 20 or int(draft.cost) > MAX_COST:
            self._findings.problem(
                draft.line,
                f'cost="{shorten(draft.cost)}": expected an integer from 0 to {MAX_COST}',
            )
            return 1
        return int(draft.cost)

    def _parameters(self, draft: TransformationDraft) -> Tuple[Parameter, ...]:
        made: List[Parameter] = []
        lines: Dict[str, int] = {}
        for name, type_, text, line in draft.parameters:
            self._check_name("parameter", name, line)
            if name[:1] in ("/", "~"):
                self._findings.problem(
                    line,
                    f"the parameter '{shorten(name)}' is set in the nodelet's own namespace; "
                    f"expected '{shorten(name.lstrip('~/'))}'",
                )
            if name in lines:
                self._findings.problem(
                    line,
                    f"the parameter '{shorten(name)}' is there already, in line {lines[name]}",
                )
            lines[name] = line
            type_ = type_ or infer_type(text)
            self._check_value(name, type_, text, line)
            made.append(Parameter(name, type_, text))
        if made and (draft.type == TOPIC or draft.node is not None):
            what = "a topic" if draft.type == TOPIC else "a node that others start"
            self._findings.warning(
                draft.line, f"{what} has no parameters; these will never be set"
            )
        return tuple(made)

    def _check_value(self, name: str, type_: str, text: str, line: int) -> None:
        if type_ == "yaml":
            if text in self._good_yaml:
                return
            self._yaml_size += len(text)
            if self._yaml_size > self._limits.yaml_size:
                limit = self._limits.yaml_size
                self._findings.problem(line, f"more than {limit} characters of YAML in this text")
                raise EnoughProblems
        names = dict.fromkeys(variables_of(text), "name")
        if names and type_ not in ("string", "yaml"):
            return  # it is checked when the name is known
        try:
            parse_value(type_, fill(text, names), self._limits)
        except BadValue as error:
            self._findings.problem(line, f"the parameter '{shorten(name)}': {error}")
            return
        if type_ == "yaml":
            self._good_yaml.add(text)

    def check_template(self, draft: TransformationDraft) -> None:
        """Check the ports and tags of a template that cannot be expanded."""
        self._ports(draft, is_template=True)

    def _ports(self, draft: TransformationDraft, is_template: bool = False) -> Tuple[Port, ...]:
        lines: Dict[str, int] = {}
        tags: Dict[str, List[str]] = {}
        stated: Dict[str, Tuple[float, float]] = {}
        for name, direction, datatype, line, rate, latency in draft.ports:
            if not is_template:
                self._check_name("port", name, line)
                self._check_datatype(datatype, line)
                if rate or latency:
                    stated[name] = (
                        self._stated("rate", rate, direction, line),
                        self._stated("latency", latency, direction, line),
                    )
            if name in lines:
                self._findings.problem(
                    line,
                    f"the port '{shorten(name)}' is there already, in line {lines[name]}; "
                    "expected names that differ, also between in and out",
                )
            else:
                lines[name] = line
                tags[name] = []
        self._distribute_tags(draft, tags)
        one_out = len(draft.ports) == 1 and draft.ports[0].direction == OUT
        if draft.type == TOPIC and draft.ports_known and not one_out:
            self._findings.problem(
                draft.line,
                f"a topic with {_count_ports(draft)}; expected exactly one port, of type out",
            )
        return tuple(
            Port(name, direction, datatype, tuple(tags[name]), *stated.get(name, ()))
            for name, direction, datatype, *_ in draft.ports
        )

    def _stated(self, name: str, text: str, direction: str, line: int) -> float:
        """Read a number that an out-port states; 0 if it does not."""
        if not text:
            return 0.0
        if direction != OUT:
            self._findings.problem(
                line, f"an in-port with a {name}; expected one of out-ports alone"
            )
        least, expected = _STATED[name]
        value = float(text) if _DECIMAL.match(text) else -1.0
        if not least <= value <= _MAX_DECIMAL:
            self._findings.problem(
                line,
                f'{name}="{shorten(text)}": expected {expected}, at most {_MAX_DECIMAL} and '
                "with at most six decimal places",
            )
        return value

    def _distribute_tags(self, draft: TransformationDraft, tags: Dict[str, List[str]]) -> None:
        for port, text, line in draft.tags:
            if not text:
                self._findings.problem(line, "<tag> is empty; expected a term such as Image(cam1)")
            of_port = tags.get(port)
            if of_port is not None:
                if text in of_port:
                    self._findings.warning(
                        line, f"the port '{shorten(port)}' has this tag already"
                    )
                else:
                    of_port.append(text)
                    self._check_tag(text, line)
            elif draft.ports_known:
                self._findings.problem(
                    line,
                    f"the tag is for the port '{shorten(port)}', which is not declared; known "
                    f"ports: {listed(tags)}{meant(port, tags)}",
                )

    def _check_tag(self, text: str, line: int) -> None:
        if not text:
            return
        try:
            parse_tag(text)
        except InvalidType as error:
            self._findings.problem(line, f"the tag '{shorten(text)}': {error.expected}")
        except InvalidTag as error:
            self._findings.warning(
                line,
                f"the tag '{shorten(text)}' is passed over by the planner: {error.expected}",
            )

    def _check_datatype(self, datatype: str, line: int) -> None:
        if datatype and not _DATATYPE.match(datatype):
            self._findings.problem(
                line,
                f'datatype="{shorten(datatype)}": expected a ROS type such as sensor_msgs/Image',
            )

    def _check_name(self, what: str, name: str, line: int) -> None:
        trouble, doubt = _name_trouble(name)
        if trouble:
            self._findings.problem(line, f"the name of a {what} {trouble}; expected a ROS name")
        elif doubt:
            self._findings.warning(
                line, f"the {what} '{shorten(name)}' {doubt}; some tools will not find it"
            )


@lru_cache(maxsize=4096)
def _name_trouble(name: str) -> Tuple[str, str]:
    """Return the fault of a name and the doubt about it; empty texts for a ROS name."""
    if not name:
        return "is empty", ""
    if name.split() != [name]:
        return f"has white space in it, '{shorten(name)}'", ""
    if _ROS_NAME.match(name) and "//" not in name:
        return "", ""
    return "", "is no ROS name (a letter, then letters, digits, '_' and '/')"


def _count_ports(draft: TransformationDraft) -> str:
    ins = sum(port.direction != OUT for port in draft.ports)
    outs = len(draft.ports) - ins
    return f"{ins} in-port{'s' * (ins != 1)} and {outs} out-port{'s' * (outs != 1)}"


def _check_variables(
    draft: TransformationDraft, findings: Findings, ontology: Optional[Concepts] = None
) -> None:
    """Note unbound variables, and types that are not classes.

    The streams at the in-ports of a nodelet bind its variables, so tags of out-ports and texts of
    parameters may use only variables that stand in the tags of in-ports.
    """
    directions = {port.name: port.direction for port in draft.ports}
    used: List[Tuple[str, str, int]] = []  # variable, where, line
    bound: Dict[str, None] = {}
    for tag in draft.tags:
        term, where = with_variables(tag.text), f"the tag '{shorten(tag.text)}'"
        if term is None:
            continue
        for type_ in term.types:
            if type_ and ontology is not None and not ontology.is_class(type_):
                unknown = f"{where} has the type '{shorten(type_)}', which is no class"
                findings.warning(tag.line, f"{unknown} of the ontology")
        if directions.get(tag.port) == IN:
            bound.update(dict.fromkeys(term.variables))
        else:
            used += [(each, where, tag.line) for each in term.variables]
    for name, _, text, line in draft.parameters:
        used += [(each, f"the parameter '{shorten(name)}'", line) for each in variables_of(text)]
    for variable, where, line in used:
        if draft.type == TOPIC:
            findings.problem(
                line,
                f"{where} of a topic has the variable {shorten(variable)}; expected names, as "
                "nothing binds it",
            )
        elif variable not in bound and draft.ports_known:
            findings.problem(
                line,
                f"{where} has the variable {shorten(variable)}, which no tag of an in-port binds; "
                f"known variables: {listed(bound)}{meant(variable, bound)}",
            )
