# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads XML by the rules of its elements, safely, and explains problems in plain words.

The text may come from any client of the manager's service, so the reader streams: it keeps one
transformation or nodelet at a time, knows the exact line of everything, and stops at a DOCTYPE
before anything in it is looked at. Without a DOCTYPE there are no entities to expand; nothing is
ever fetched.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from textwrap import dedent
from typing import Callable, Iterator, Mapping, NamedTuple, NoReturn
from xml.parsers import expat

from dyknow.manager.specifications.findings import EnoughProblems, Findings, meant, shorten

BLANK = " \t\r\n"
"""XML's white space, which is stripped from both ends of every value and term."""

_CHUNK = 2**16

#: Reasons of expat when an element is not closed.
_UNFINISHED = (
    expat.errors.XML_ERROR_TAG_MISMATCH,
    expat.errors.XML_ERROR_NO_ELEMENTS,
    expat.errors.XML_ERROR_UNCLOSED_TOKEN,
    expat.errors.XML_ERROR_UNCLOSED_CDATA_SECTION,
)


class Attribute(NamedTuple):
    """The rule of an attribute.

    It may have any value if ``values`` is empty. Reading ends at another version. White space
    around the value of a verbatim one belongs to it.
    """

    values: tuple[str, ...] = ()
    is_required: bool = False
    is_version: bool = False
    is_verbatim: bool = False


ANY = Attribute()
NEEDED = Attribute(is_required=True)


@dataclass
class Element:
    """The rule of an element, which holds text or elements."""

    name: str
    children: tuple[Element, ...] = ()
    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    holds_text: bool = False
    is_required: bool = False
    #: Attribute of its parent, or other child, with which it is not required.
    unless: tuple[str, ...] = ()
    may_repeat: bool = False
    is_unit: bool = False  # whether the reader returns it by itself, instead of in its parent

    def __post_init__(self) -> None:
        self.by_name = {child.name: child for child in self.children}
        self.required = [child for child in self.children if child.is_required]

    @property
    def expected(self) -> str:
        """Its children, in words."""
        names = " or ".join(f"<{name}>" for name in sorted(self.by_name))
        return names or ("text alone" if self.holds_text else "nothing")


class XmlNode:
    """An element as it was read; its line is that of its start tag."""

    __slots__ = ("attributes", "children", "has_variables", "is_good", "line", "name", "text")

    def __init__(self, name: str, line: int, attributes: dict[str, str]) -> None:
        self.name = name
        self.line = line
        self.attributes = attributes  # those without problems
        self.text = ""
        self.children: list[XmlNode] = []
        #: Whether its text and its attributes can be used; False if one is missing.
        self.is_good = True
        self.has_variables = False  # of a unit, whether `${` is in one of its texts

    def get(self, attribute: str, default: str = "") -> str:
        return self.attributes.get(attribute, default)

    def child(self, name: str) -> XmlNode | None:
        """Return the first child of that name that can be used."""
        return next((each for each in self.children if each.name == name and each.is_good), None)

    def all(self, section: str) -> list[XmlNode]:
        """Return the usable elements of a section."""
        return [
            each
            for part in self.children
            if part.name == section
            for each in part.children
            if each.is_good
        ]

    def texts(self) -> Iterator[tuple[str, int, bool]]:
        """Return texts and attributes: the line of each, and whether it is a parameter's text."""
        yield self.text, self.line, self.name == "param"
        for text in self.attributes.values():
            yield text, self.line, False
        for child in self.children:
            yield from child.texts()

    def rendered(self, render: Callable[[str, bool], str]) -> XmlNode:
        """Make a copy in which all of ``texts`` are rendered."""
        attributes = {name: render(text, False) for name, text in self.attributes.items()}
        made = XmlNode(self.name, self.line, attributes)
        made.text = render(self.text, self.name == "param")
        made.children = [child.rendered(render) for child in self.children]
        made.is_good = self.is_good
        return made


class XmlReader:
    """Reads one text."""

    def __init__(self, findings: Findings, *roots: Element) -> None:
        """Prepare to read a text that begins with one of the elements of ``roots``.

        Reading goes on after a problem for as long as the text is well-formed.
        """
        self._findings = findings
        self._limits = findings.limits
        self._top = Element("", roots)
        #: Open elements, each with its rule if it has one.
        self._stack: list[tuple[Element | None, XmlNode]] = [(self._top, XmlNode("", 0, {}))]
        self._texts: list[str] = []
        self._items = 0
        self._has_variables = False
        self._units: list[XmlNode] = []
        self._parser = expat.ParserCreate("utf-8")
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._texts.append
        self._parser.StartDoctypeDeclHandler = self._doctype
        self._parser.ProcessingInstructionHandler = self._instruction
        self._parser.XmlDeclHandler = self._declaration

    def read(self, text: str | bytes) -> Iterator[XmlNode]:
        """Return the units of a text (characters or UTF-8) that are complete, problems or not.

        EnoughProblems: it cannot be read beyond a problem, which was noted.
        """
        data = self._utf8(text)
        view = memoryview(data)
        longest = self._limits.string_length + 2**19
        try:
            for start in range(0, len(data), _CHUNK):
                self._parser.Parse(view[start : start + _CHUNK], False)
                yield from self._take_units()
                # expat keeps a tag until it ends: stop before one without an end fills the memory.
                if start - self._parser.CurrentByteIndex > 2 * longest:
                    self._stop(self._line, "a tag or comment here is too long")
            self._parser.Parse(b"", True)
            yield from self._take_units()
        except EnoughProblems:
            yield from self._take_units()
            raise
        except expat.ExpatError as error:
            yield from self._take_units()
            self._explain(error)

    def _take_units(self) -> list[XmlNode]:
        units, self._units = self._units, []
        return units

    def _stop(self, line: int, message: str) -> NoReturn:
        self._findings.problem(line, message)
        raise EnoughProblems

    def _explain(self, error: expat.ExpatError) -> None:
        reason = expat.errors.messages[error.code]
        expected = f"well-formed XML with one root element, {self._top.expected}"
        if len(self._stack) > 1 and reason in _UNFINISHED:
            _, node = self._stack[-1]
            expected = f"the end </{node.name}> of the element in line {node.line}"
        message = f"{reason} at column {error.offset + 1}; expected {expected}"
        self._findings.problem(error.lineno, message)

    def _utf8(self, text: str | bytes) -> bytes:
        """Encode a text, or make sure that it is UTF-8 already."""
        self._check_size(len(text))
        try:
            if isinstance(text, bytes):
                text.decode("utf-8")
                return text
            data = text.encode("utf-8")
        except UnicodeEncodeError as error:
            line = error.object.count("\n", 0, error.start) + 1
            self._stop(line, "half of a surrogate pair; expected UTF-8")
        except UnicodeDecodeError as error:
            line = error.object.count(b"\n", 0, error.start) + 1
            found = error.object[error.start]
            self._stop(line, f"the byte 0x{found:02x} is not UTF-8; expected UTF-8")
        self._check_size(len(data))
        return data

    def _check_size(self, size: int) -> None:
        if size > self._limits.text_size:
            self._stop(0, f"the text has {size} bytes; expected at most {self._limits.text_size}")

    @property
    def _line(self) -> int:
        return self._parser.CurrentLineNumber

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        parent, above = self._stack[-1]
        node = XmlNode(name, line, attributes)
        if parent is None:
            if len(self._stack) > self._limits.nesting:
                self._stop(line, f"elements nest deeper than {self._limits.nesting}")
            self._stack.append((None, node))
            return
        if self._texts and not parent.holds_text:
            self._refuse_text(parent)
        rule = parent.by_name.get(name)
        if rule is None:
            self._findings.problem(line, _unexpected_element(name, parent))
            above.is_good = False
            self._stack.append((None, node))
            return
        if not rule.may_repeat:
            first = next((each.line for each in above.children if each.name == name), None)
            if first is not None:
                self._findings.problem(
                    line, f"a second <{name}>; expected one, which stands in line {first}"
                )
        if rule.is_unit:
            self._items, self._has_variables = 0, False
        else:
            above.children.append(node)
        if attributes or rule.attributes:
            self._check_attributes(rule, node)
        self._stack.append((rule, node))

    def _end(self, name: str) -> None:
        rule, node = self._stack.pop()
        if rule is None:
            self._texts.clear()
            return
        if rule.holds_text:
            self._end_text(rule, node)
            return
        if self._texts:
            self._refuse_text(rule)
        present = {child.name for child in node.children}
        for child in rule.required:
            if child.name not in present and not {*child.unless} & {*node.attributes, *present}:
                self._findings.problem(node.line, f"<{name}> has no <{child.name}>; expected one")
        if rule.is_unit:
            node.has_variables = self._has_variables
            self._units.append(node)

    def _end_text(self, rule: Element, node: XmlNode) -> None:
        text = "".join(self._texts)
        self._texts.clear()
        if node.attributes.get("type") == "yaml":
            # The indentation of YAML has a meaning, relative to that of its first line.
            text = dedent(text)
        node.text = text.strip(BLANK)
        if "${" in text:
            self._has_variables = True
        if len(node.text) > self._limits.string_length:
            self._refuse_length(node, f"<{node.name}>", node.text)
        self._items += rule.may_repeat
        if self._items > self._limits.items:
            what = "args, params, ports and tags in one <transformation>"
            self._stop(node.line, f"more than {self._limits.items} {what}")

    def _refuse_text(self, rule: Element) -> None:
        text = "".join(self._texts).lstrip(BLANK)
        self._texts.clear()
        if text:
            self._findings.problem(
                self._line - text.count("\n"),
                f"text '{shorten(text.rstrip(BLANK))}' directly in <{rule.name}>; expected "
                f"{rule.expected}",
            )

    def _check_attributes(self, rule: Element, node: XmlNode) -> None:
        attributes = node.attributes
        given = list(attributes)
        for name in given:
            known = rule.attributes.get(name)
            if known is None or not known.is_verbatim:
                attributes[name] = attributes[name].strip(BLANK)
            text = attributes[name]
            if "${" in text:
                self._has_variables = True
            if known is None:
                self._findings.problem(node.line, _unexpected_attribute(name, rule))
                del attributes[name]
                continue
            if known.values and text not in known.values:
                self._findings.problem(
                    node.line,
                    f'<{rule.name} {name}="{shorten(text)}">: expected {_one_of(known.values)}',
                )
                self._drop_attribute(node, name, known)
            elif len(text) > self._limits.string_length:
                self._refuse_length(node, f"attribute {name}", text)
                del attributes[name]
        for name, known in rule.attributes.items():
            if known.is_required and name not in given:
                which = f", {_one_of(known.values)}" if known.values else ""
                self._findings.problem(
                    node.line, f"<{rule.name}> has no attribute {name}; expected one{which}"
                )
                self._drop_attribute(node, name, known)

    def _drop_attribute(self, node: XmlNode, name: str, rule: Attribute) -> None:
        if rule.is_version:
            raise EnoughProblems
        node.attributes.pop(name, None)
        node.is_good = False

    def _refuse_length(self, node: XmlNode, what: str, text: str) -> None:
        node.is_good = False
        self._findings.problem(
            node.line,
            f"{what} has {len(text)} characters; expected at most {self._limits.string_length}",
        )

    def _doctype(self, *_: object) -> None:
        self._stop(self._line, f"a DOCTYPE is refused; expected {self._top.expected} alone")

    def _instruction(self, target: str, _: str) -> None:
        self._findings.problem(
            self._line,
            f"the processing instruction <?{shorten(target)}?> is refused; expected none",
        )

    def _declaration(self, _: str, encoding: str | None, __: int) -> None:
        if encoding is not None and encoding.lower() not in ("utf-8", "utf8", "us-ascii"):
            self._findings.problem(
                self._line, f"the encoding {shorten(encoding)} is declared; expected UTF-8"
            )


def _one_of(values: tuple[str, ...]) -> str:
    return " or ".join(f"'{value}'" for value in values)


def _unexpected_element(name: str, parent: Element) -> str:
    where = f"in <{parent.name}>" if parent.name else "as the root"
    foreign = "; elements of other namespaces are refused" if ":" in name else ""
    hint = foreign or meant(name, parent.by_name)
    return f"unexpected <{shorten(name)}> {where}; expected {parent.expected}{hint}"


def _unexpected_attribute(name: str, rule: Element) -> str:
    expected = " or ".join(sorted(rule.attributes)) or "none"
    foreign = "; namespaces are refused" if name.split(":")[0] == "xmlns" else ""
    hint = foreign or meant(name, rule.attributes)
    return f"unexpected attribute {shorten(name)} of <{rule.name}>; expected {expected}{hint}"
