"""Reads specification XML into drafts, by the rules of the schema, and safely.

The text may come from anybody who reaches the manager's service, so the reader streams: it
builds no tree, knows the exact line of everything, and stops at a DOCTYPE before anything in it
is looked at. Without a DOCTYPE there are no entities to expand; nothing is ever fetched.
"""

from __future__ import annotations

from sys import intern
from textwrap import dedent
from typing import Callable, Dict, Iterator, List, Optional, Tuple, Union
from xml.parsers import expat

from dyknow.manager.specifications.draft import (
    BLANK,
    ArgDraft,
    ParameterDraft,
    PortDraft,
    TagDraft,
    TransformationDraft,
)
from dyknow.manager.specifications.expectations import (
    children_of,
    one_of,
    unexpected_attribute,
    unexpected_element,
)
from dyknow.manager.specifications.findings import Findings
from dyknow.manager.specifications.grammar import ElementRule, roots
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.wellformed import Unreadable, explain, to_utf8
from dyknow.manager.specifications.wording import shorten

_CHUNK = 2**18

_Attributes = Dict[str, Optional[str]]
_Frame = Tuple[ElementRule, _Attributes, int, Dict[str, int]]


def read(
    text: Union[str, bytes], findings: Findings, limits: SpecificationLimits
) -> Iterator[TransformationDraft]:
    """Read the transformations of a text one after the other.

    Args:
        text: The XML, as characters or as UTF-8.
        findings: Where problems and warnings are noted. Reading goes on after a problem for as
            long as the text is well-formed.
        limits: The caps to hold.

    Yields:
        A draft for each transformation that is complete, problems or not.
    """
    try:
        data = to_utf8(text, limits)
        yield from _Reader(findings, limits).drafts(data)
    except Unreadable as error:
        findings.problem(error.line, error.message)


class _Reader:
    """The handlers of one expat parser, and the elements that are open."""

    def __init__(self, findings: Findings, limits: SpecificationLimits) -> None:
        self._findings = findings
        self._limits = limits
        self._stack: List[_Frame] = [(ElementRule("", children=roots()), {}, 0, {})]
        self._unknown: List[Tuple[str, int]] = []
        self._texts: List[str] = []
        self._spoiled = False
        self._draft = TransformationDraft(0)
        self._ready: List[TransformationDraft] = []
        self._count = 0
        self._items = 0
        self._parser = expat.ParserCreate("utf-8")
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start  # type: ignore[assignment]
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._texts.append
        self._parser.StartDoctypeDeclHandler = self._doctype
        self._parser.ProcessingInstructionHandler = self._instruction
        self._parser.XmlDeclHandler = self._declaration
        self._take: Dict[str, Callable[[str, _Attributes, int], None]] = {
            "label": self._label,
            "source": self._source,
            "arg": self._arg,
            "param": self._param,
            "port": self._port,
            "tag": self._tag,
        }

    def drafts(self, data: bytes) -> Iterator[TransformationDraft]:
        view = memoryview(data)
        longest = self._limits.string_length + 2 * _CHUNK
        try:
            for start in range(0, len(data), _CHUNK):
                self._parser.Parse(view[start : start + _CHUNK], False)
                yield from self._ready
                self._ready.clear()
                # A tag without end is kept by expat until it ends: stop before it fills memory.
                if start - self._parser.CurrentByteIndex > 2 * longest:
                    raise Unreadable(self._line, "a tag or comment here is too long")
            self._parser.Parse(b"", True)
        except Unreadable:
            yield from self._ready
            raise
        except expat.ExpatError as error:
            yield from self._ready
            open_ = [(rule.name, line) for rule, _, line, _ in self._stack[1:]] + self._unknown
            raise explain(error, data, self._parser.ErrorByteIndex, open_) from None

    @property
    def _line(self) -> int:
        return self._parser.CurrentLineNumber

    def _start(self, name: str, attributes: _Attributes) -> None:
        line = self._parser.CurrentLineNumber
        if self._unknown:
            if len(self._unknown) + len(self._stack) > self._limits.nesting:
                raise Unreadable(line, f"elements nest deeper than {self._limits.nesting}")
            self._unknown.append((name, line))
            return
        parent, _, _, seen = self._stack[-1]
        if self._texts and not parent.text:
            self._refuse_text(parent)
        rule = parent.children.get(name)
        if rule is None:
            self._findings.problem(line, unexpected_element(name, parent))
            self._spoiled = True
            self._unknown.append((name, line))
            return
        if name not in seen:
            seen[name] = line
        elif name not in parent.repeated:
            self._findings.problem(
                line, f"a second <{name}>; expected one, which stands in line {seen[name]}"
            )
        if attributes or rule.attributes:
            self._check_attributes(rule, attributes, line)
        self._stack.append((rule, attributes, line, {}))
        self._spoiled = False
        if name == "transformation":
            self._begin_transformation(attributes, line)

    def _end(self, name: str) -> None:
        if self._unknown:
            self._unknown.pop()
            self._texts.clear()
            return
        rule, attributes, line, seen = self._stack.pop()
        if rule.text:
            text = "".join(self._texts)
            self._texts.clear()
            if attributes.get("type") == "yaml":
                # YAML means something by its indentation, relative to that of its first line.
                text = dedent(text)
            text = text.strip(BLANK)
            if len(text) > self._limits.string_length:
                self._spoiled = True
                self._too_long(line, f"<{name}>", len(text))
            if "${" in text:
                self._draft.has_variables = True
            self._take[name](text, attributes, line)
            self._items += 1
            if self._items > self._limits.items + 2:
                raise Unreadable(
                    line,
                    f"more than {self._limits.items} args, params, ports and tags in one "
                    "<transformation>",
                )
            return
        if self._texts:
            self._refuse_text(rule)
        for child in rule.required:
            if child not in seen:
                self._findings.problem(line, f"<{name}> has no <{child}>; expected one")
        if name == "transformation":
            self._ready.append(self._draft)

    def _refuse_text(self, rule: ElementRule) -> None:
        text = "".join(self._texts).lstrip(BLANK)
        self._texts.clear()
        if text:
            self._findings.problem(
                self._line - text.count("\n"),
                f"text '{shorten(text.rstrip(BLANK))}' directly in <{rule.name}>; expected "
                f"{children_of(rule)}",
            )

    def _check_attributes(self, rule: ElementRule, attributes: _Attributes, line: int) -> None:
        rules = rule.attributes
        for name, value in attributes.items():
            known = rules.get(name)
            if known is None:
                self._findings.problem(line, unexpected_attribute(name, rule))
                continue
            text = (value or "").strip(BLANK)
            attributes[name] = text
            if "${" in text:
                self._draft.has_variables = True
            if known.values is not None and text not in known.values:
                self._findings.problem(
                    line,
                    f'<{rule.name} {name}="{shorten(text)}">: expected {one_of(known.values)}',
                )
                attributes[name] = None
            elif len(text) > self._limits.string_length:
                self._too_long(line, f"attribute {name}", len(text))
                attributes[name] = None
        for name in rule.required_attributes:
            if name not in attributes:
                values = rules[name].values
                which = f", {one_of(values)}" if values else ""
                self._findings.problem(
                    line, f"<{rule.name}> has no attribute {name}; expected one{which}"
                )
                attributes[name] = None

    def _too_long(self, line: int, what: str, length: int) -> None:
        self._findings.problem(
            line,
            f"{what} has {length} characters; expected at most {self._limits.string_length}",
        )

    def _begin_transformation(self, attributes: _Attributes, line: int) -> None:
        self._count += 1
        self._items = 0
        if self._count > self._limits.transformations:
            raise Unreadable(
                line, f"more than {self._limits.transformations} transformations in one text"
            )
        self._draft = TransformationDraft(line)
        self._draft.type = attributes.get("type") or ""
        self._draft.cost = attributes.get("cost", "1") or ""
        self._draft.has_variables = "${" in self._draft.cost

    def _label(self, text: str, _: _Attributes, line: int) -> None:
        if not self._spoiled and self._draft.label is None:
            self._draft.label, self._draft.label_line = text, line

    def _source(self, text: str, _: _Attributes, line: int) -> None:
        if not self._spoiled and self._draft.source is None:
            self._draft.source, self._draft.source_line = text, line

    def _arg(self, text: str, attributes: _Attributes, line: int) -> None:
        label = attributes["label"]
        if label is not None:
            self._draft.args.append(ArgDraft(label, "" if self._spoiled else text, line))

    def _param(self, text: str, attributes: _Attributes, line: int) -> None:
        name, type_ = attributes["name"], attributes.get("type", "")
        if name is not None and type_ is not None and not self._spoiled:
            self._draft.parameters.append(ParameterDraft(intern(name), type_, text, line))

    def _port(self, text: str, attributes: _Attributes, line: int) -> None:
        direction, datatype = attributes["type"], attributes.get("datatype", "")
        if self._spoiled or direction is None or datatype is None:
            self._draft.ports_known = False
        else:
            self._draft.ports.append(PortDraft(intern(text), direction, intern(datatype), line))

    def _tag(self, text: str, attributes: _Attributes, line: int) -> None:
        port = attributes["port"]
        if port is not None and not self._spoiled:
            self._draft.tags.append(TagDraft(port, text, line))

    def _doctype(self, *_: object) -> None:
        raise Unreadable(self._line, "a DOCTYPE is refused; expected <transformation(s)> alone")

    def _instruction(self, target: str, _: str) -> None:
        self._findings.problem(
            self._line,
            f"the processing instruction <?{shorten(target)}?> is refused; expected none",
        )

    def _declaration(self, _: str, encoding: Optional[str], __: int) -> None:
        if encoding is not None and encoding.lower() not in ("utf-8", "utf8", "us-ascii"):
            self._findings.problem(
                self._line, f"the encoding {shorten(encoding)} is declared; expected UTF-8"
            )
