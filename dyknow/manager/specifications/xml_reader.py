# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads XML by the rules of its elements, safely, and explains problems in plain words.

The text may come from any client of the manager's service, so the reader streams: it builds no
tree, knows the exact line of everything, and stops at a DOCTYPE before anything in it is looked
at. Without a DOCTYPE there are no entities to expand; nothing is ever fetched.
"""

from __future__ import annotations

from textwrap import dedent
from typing import Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple, Union
from xml.parsers import expat

from dyknow.manager.specifications.findings import Findings, meant, shorten
from dyknow.manager.specifications.limits import SpecificationLimits

#: Reasons of expat when an element is not closed.
_UNFINISHED = (
    expat.errors.XML_ERROR_TAG_MISMATCH,
    expat.errors.XML_ERROR_NO_ELEMENTS,
    expat.errors.XML_ERROR_UNCLOSED_TOKEN,
    expat.errors.XML_ERROR_UNCLOSED_CDATA_SECTION,
)


class Unreadable(Exception):
    """The text cannot be read beyond this line."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(line, message)
        self.line = line
        self.message = message


def to_utf8(text: Union[str, bytes], limits: SpecificationLimits) -> bytes:
    """Encode a text, or make sure that it is UTF-8 already.

    Args:
        text: The characters, or the bytes of a file.
        limits: The cap on its size.

    Raises:
        Unreadable: It is too large, or not UTF-8.
    """
    _check_size(len(text), limits)
    if isinstance(text, str):
        try:
            data = text.encode("utf-8")
        except UnicodeEncodeError as error:
            line = text.count("\n", 0, error.start) + 1
            raise Unreadable(line, "half of a surrogate pair; expected UTF-8") from None
        _check_size(len(data), limits)
        return data
    try:
        text.decode("utf-8")
    except UnicodeDecodeError as error:
        line = text.count(b"\n", 0, error.start) + 1
        found = text[error.start]
        raise Unreadable(line, f"the byte 0x{found:02x} is not UTF-8; expected UTF-8") from None
    return text


def _check_size(size: int, limits: SpecificationLimits) -> None:
    if size > limits.text_size:
        raise Unreadable(0, f"the text has {size} bytes; expected at most {limits.text_size}")


def explain(
    error: expat.ExpatError, open_elements: List[Tuple[str, int]], roots: str
) -> Unreadable:
    """Return an error with the place and the expected text.

    Args:
        error: The error of expat.
        open_elements: Names and lines of the open elements, outermost first.
        roots: The elements that the text may start with, in words.
    """
    reason = expat.errors.messages[error.code]
    expected = f"well-formed XML with one root element, {roots}"
    if open_elements and reason in _UNFINISHED:
        name, line = open_elements[-1]
        expected = f"the end </{name}> of the element in line {line}"
    return Unreadable(error.lineno, f"{reason} at column {error.offset + 1}; expected {expected}")


BLANK = " \t\r\n"
"""XML's white space, which is stripped from both ends of every value and term."""

_CHUNK = 2**18

Attributes = Dict[str, Optional[str]]
"""The attributes of an element by name; a wrong or missing one, which was noted, is None."""

TextHandler = Callable[[Optional[str], Attributes, int], None]
"""Takes the text of an element, None if it was wrong, its attributes and its line."""


class Attribute(NamedTuple):
    """The rule of an attribute.

    Attributes:
        values: the values it may have; empty if it may have any.
        is_required: whether its element must have it.
    """

    values: Tuple[str, ...] = ()
    is_required: bool = False


ANY = Attribute()
NEEDED = Attribute(is_required=True)


class Element:
    """The rule of an element.

    Attributes:
        name: its name.
        children: the rules of its children, by name.
        required: the names of the children that must be there.
        attributes: the rules of its attributes, by name.
        holds_text: whether it holds text; if not, it holds only elements.
        is_required: whether it must be in its parent.
        unless: attribute of its parent with which it need not be there; empty for none.
        may_repeat: whether it may be in its parent more than once.
    """

    __slots__ = (
        "attributes",
        "children",
        "holds_text",
        "is_required",
        "may_repeat",
        "name",
        "required",
        "unless",
    )

    def __init__(
        self,
        name: str,
        *children: Element,
        attributes: Optional[Mapping[str, Attribute]] = None,
        holds_text: bool = False,
        is_required: bool = False,
        unless: str = "",
        may_repeat: bool = False,
    ) -> None:
        self.name = name
        self.attributes: Mapping[str, Attribute] = attributes or {}
        self.holds_text = holds_text
        self.is_required = is_required
        self.unless = unless
        self.may_repeat = may_repeat
        self.children = {child.name: child for child in children}
        self.required = tuple(child for child in children if child.is_required)

    @property
    def expected(self) -> str:
        """Its children, in words."""
        names = " or ".join(f"<{name}>" for name in sorted(self.children))
        return names or ("text alone" if self.holds_text else "nothing")


_Frame = Tuple[Element, Attributes, int, Dict[str, int]]


class XmlReader:
    """Reads one text. A subclass fills in the handlers of elements.

    Attributes:
        on_start: called with attributes and line when an element begins, by its name.
        on_text: called when an element that holds text ends, by its name.
        on_end: called with attributes and line when another element ends, by its name.
        has_variables: whether `${` was in a text or attribute since a handler set it to False.
    """

    def __init__(self, findings: Findings, limits: SpecificationLimits, *roots: Element) -> None:
        """Prepare to read.

        Args:
            findings: where problems and warnings are noted. Reading goes on after a problem for
                as long as the text is well-formed.
            limits: the caps to hold.
            roots: the rules of the elements that the text may start with.
        """
        self.on_start: Dict[str, Callable[[Attributes, int], None]] = {}
        self.on_text: Dict[str, TextHandler] = {}
        self.on_end: Dict[str, Callable[[Attributes, int], None]] = {}
        self.has_variables = False
        self._findings = findings
        self._limits = limits
        self._top = Element("", *roots)
        self._stack: List[_Frame] = [(self._top, {}, 0, {})]
        self._unknown: List[Tuple[str, int]] = []
        self._texts: List[str] = []
        self._is_spoiled = False
        self._parser = expat.ParserCreate("utf-8")
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start  # type: ignore[assignment]
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._texts.append
        self._parser.StartDoctypeDeclHandler = self._doctype
        self._parser.ProcessingInstructionHandler = self._instruction
        self._parser.XmlDeclHandler = self._declaration

    def read(self, text: Union[str, bytes]) -> Iterator[None]:
        """Read a text; yield after each part, so that the caller can take its content.

        Args:
            text: the XML, as characters or as UTF-8.
        """
        try:
            data = to_utf8(text, self._limits)
            view = memoryview(data)
            longest = self._limits.string_length + 2 * _CHUNK
            for start in range(0, len(data), _CHUNK):
                self._parser.Parse(view[start : start + _CHUNK], False)
                yield
                # expat keeps a tag until it ends: stop before one without an end fills the memory.
                if start - self._parser.CurrentByteIndex > 2 * longest:
                    raise Unreadable(self._line, "a tag or comment here is too long")
            self._parser.Parse(b"", True)
            yield
        except (Unreadable, expat.ExpatError) as error:
            yield
            if isinstance(error, expat.ExpatError):
                open_ = [(rule.name, line) for rule, _, line, _ in self._stack[1:]]
                error = explain(error, open_ + self._unknown, self._top.expected)
            self._findings.problem(error.line, error.message)

    @property
    def _line(self) -> int:
        return self._parser.CurrentLineNumber

    def _start(self, name: str, attributes: Attributes) -> None:
        line = self._parser.CurrentLineNumber
        if self._unknown:
            if len(self._unknown) + len(self._stack) > self._limits.nesting:
                raise Unreadable(line, f"elements nest deeper than {self._limits.nesting}")
            self._unknown.append((name, line))
            return
        parent, _, _, seen = self._stack[-1]
        if self._texts and not parent.holds_text:
            self._refuse_text(parent)
        rule = parent.children.get(name)
        if rule is None:
            self._findings.problem(line, _unexpected_element(name, parent))
            self._is_spoiled = True
            self._unknown.append((name, line))
            return
        if name not in seen:
            seen[name] = line
        elif not rule.may_repeat:
            self._findings.problem(
                line, f"a second <{name}>; expected one, which stands in line {seen[name]}"
            )
        if attributes or rule.attributes:
            self._check_attributes(rule, attributes, line)
        self._stack.append((rule, attributes, line, {}))
        self._is_spoiled = False
        if name in self.on_start:
            self.on_start[name](attributes, line)

    def _end(self, name: str) -> None:
        if self._unknown:
            self._unknown.pop()
            self._texts.clear()
            return
        rule, attributes, line, seen = self._stack.pop()
        if rule.holds_text:
            text = "".join(self._texts)
            self._texts.clear()
            if attributes.get("type") == "yaml":
                # The indentation of YAML has a meaning, relative to that of its first line.
                text = dedent(text)
            text = text.strip(BLANK)
            if len(text) > self._limits.string_length:
                self._is_spoiled = True
                self._too_long(line, f"<{name}>", len(text))
            if "${" in text:
                self.has_variables = True
            self.on_text[name](None if self._is_spoiled else text, attributes, line)
            return
        if self._texts:
            self._refuse_text(rule)
        for child in rule.required:
            if child.name not in seen and child.unless not in attributes:
                self._findings.problem(line, f"<{name}> has no <{child.name}>; expected one")
        if name in self.on_end:
            self.on_end[name](attributes, line)

    def _refuse_text(self, rule: Element) -> None:
        text = "".join(self._texts).lstrip(BLANK)
        self._texts.clear()
        if text:
            self._findings.problem(
                self._line - text.count("\n"),
                f"text '{shorten(text.rstrip(BLANK))}' directly in <{rule.name}>; expected "
                f"{rule.expected}",
            )

    def _check_attributes(self, rule: Element, attributes: Attributes, line: int) -> None:
        rules = rule.attributes
        for name, value in attributes.items():
            known = rules.get(name)
            if known is None:
                self._findings.problem(line, _unexpected_attribute(name, rule))
                continue
            text = (value or "").strip(BLANK)
            attributes[name] = text
            if "${" in text:
                self.has_variables = True
            if known.values and text not in known.values:
                self._findings.problem(
                    line,
                    f'<{rule.name} {name}="{shorten(text)}">: expected {_one_of(known.values)}',
                )
                attributes[name] = None
            elif len(text) > self._limits.string_length:
                self._too_long(line, f"attribute {name}", len(text))
                attributes[name] = None
        for name, (values, is_required) in rules.items():
            if is_required and name not in attributes:
                which = f", {_one_of(values)}" if values else ""
                self._findings.problem(
                    line, f"<{rule.name}> has no attribute {name}; expected one{which}"
                )
                attributes[name] = None

    def _too_long(self, line: int, what: str, length: int) -> None:
        self._findings.problem(
            line,
            f"{what} has {length} characters; expected at most {self._limits.string_length}",
        )

    def _doctype(self, *_: object) -> None:
        raise Unreadable(self._line, f"a DOCTYPE is refused; expected {self._top.expected} alone")

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


def _one_of(values: Tuple[str, ...]) -> str:
    return " or ".join(f"'{value}'" for value in values)


def _unexpected_element(name: str, parent: Element) -> str:
    where = f"in <{parent.name}>" if parent.name else "as the root"
    foreign = "; elements of other namespaces are refused" if ":" in name else ""
    hint = foreign or meant(name, parent.children)
    return f"unexpected <{shorten(name)}> {where}; expected {parent.expected}{hint}"


def _unexpected_attribute(name: str, rule: Element) -> str:
    expected = " or ".join(sorted(rule.attributes)) or "none"
    foreign = "; namespaces are refused" if name.split(":")[0] == "xmlns" else ""
    hint = foreign or meant(name, rule.attributes)
    return f"unexpected attribute {shorten(name)} of <{rule.name}>; expected {expected}{hint}"
