"""Reads a wiring from XML, or finds every problem of the file.

The file may come from anybody: it is streamed, a DOCTYPE is refused before anything in it is
looked at, nothing is fetched, and the transformations inside go to the parser of specifications
with its limits.
"""

from __future__ import annotations

from typing import Callable, Dict, List, Mapping, Optional, Tuple
from xml.parsers import expat
from xml.parsers.expat import errors as expat_errors

from dyknow import names
from dyknow.errors import InvalidName, Problem, SpecificationError
from dyknow.manager.specifications.limits import DEFAULT_LIMITS
from dyknow.manager.specifications.specification import parse
from dyknow.model.transformation import Transformation
from dyknow.wiring.wiring import VERSION, WiredNodelet, Wiring

_CHILDREN: Mapping[str, Tuple[str, ...]] = {
    "": ("wiring",),
    "wiring": ("transformations", "nodelets"),
    "nodelets": ("nodelet",),
    "nodelet": ("connection",),
    "connection": (),
}
_ATTRIBUTES: Mapping[str, Tuple[Tuple[str, ...], Tuple[str, ...]]] = {
    "wiring": (("version",), ()),
    "transformations": ((), ()),
    "nodelets": ((), ()),
    "nodelet": (("name", "transformation"), ("manager", "protected", "isolated")),
    "connection": (("port", "topic"), ()),
}
_BOOLS = {"true": True, "1": True, "false": False, "0": False}

_Attributes = Dict[str, str]


class _Stop(Exception):
    """Nothing behind this line can be read."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(line, message)
        self.line = line
        self.message = message


def read_wiring(data: bytes, file: str) -> Wiring:
    """Read a wiring.

    Args:
        data: The XML, in UTF-8.
        file: The name to use in messages.

    Raises:
        SpecificationError: with every problem of the file.
    """
    reader = _Reader(data, file)
    try:
        reader.read()
    except _Stop as stop:
        reader.problem(stop.line, stop.message)
    if reader.problems:
        raise SpecificationError(sorted(reader.problems, key=lambda problem: problem.line))
    return Wiring(
        tuple(sorted(reader.transformations, key=lambda each: each.label)),
        tuple(sorted(reader.nodelets, key=lambda each: each.name)),
    )


class _Reader:
    """The handlers of one expat parser, the elements that are open, and what was found."""

    def __init__(self, data: bytes, file: str) -> None:
        self.problems: List[Problem] = []
        self.transformations: Tuple[Transformation, ...] = ()
        self.nodelets: List[WiredNodelet] = []
        self._data = data
        self._file = file
        self._stack: List[str] = [""]
        self._seen: Dict[Tuple[str, str], int] = {}
        self._foreign = 0
        self._inside: Optional[Tuple[int, int]] = None
        self._nodelet: Optional[_Attributes] = None
        self._nodelet_line = 0
        self._connections: Dict[str, str] = {}
        self._parser = expat.ParserCreate("UTF-8")
        self._parser.StartElementHandler = self._guarded(self._start)
        self._parser.EndElementHandler = self._guarded(self._end)
        self._parser.CharacterDataHandler = self._text
        self._parser.StartDoctypeDeclHandler = self._doctype

    def read(self) -> None:
        """Read all of it.

        Raises:
            _Stop: what follows cannot be read.
        """
        if len(self._data) > DEFAULT_LIMITS.text_size:
            raise _Stop(0, f"{len(self._data)} bytes; expected at most {DEFAULT_LIMITS.text_size}")
        try:
            self._parser.Parse(self._data, True)
        except expat.ExpatError as error:
            reason = expat_errors.messages[error.code]
            raise _Stop(error.lineno, f"{reason}; expected well-formed XML in UTF-8") from None

    def problem(self, line: int, message: str) -> None:
        """Note a problem."""
        self.problems.append(Problem(self._file, line, message))

    # Handlers

    def _guarded(self, handler: Callable[..., None]) -> Callable[..., None]:
        """Leave elements alone that stand inside an unknown one or a transformation."""

        def handle(name: str, *rest: _Attributes) -> None:
            if handler == self._start and (self._foreign or self._inside):
                self._foreign += 1
            elif handler == self._end and self._foreign:
                self._foreign -= 1
            else:
                handler(name, *rest)

        return handle

    def _start(self, name: str, attributes: _Attributes) -> None:
        line = self._parser.CurrentLineNumber
        parent = self._stack[-1]
        if name not in _CHILDREN[parent]:
            expected = " or ".join(f"<{child}>" for child in _CHILDREN[parent]) or "nothing"
            where = f" in <{parent}>" if parent else ""
            self.problem(line, f"<{name}>{where}; expected {expected}")
            self._foreign += 1
            return
        self._check_attributes(name, attributes, line)
        if name in ("transformations", "nodelets") and self._earlier(name, "", line):
            self.problem(line, f"a second <{name}>; expected one")
        if name == "wiring" and attributes.get("version", VERSION) != VERSION:
            raise _Stop(line, f"version '{attributes['version']}'; expected '{VERSION}'")
        if name == "transformations":
            self._inside = (self._parser.CurrentByteIndex, line)
        elif name == "nodelet":
            self._nodelet, self._nodelet_line, self._connections = attributes, line, {}
        elif name == "connection":
            self._connect(attributes, line)
        if name != "transformations":
            self._stack.append(name)

    def _end(self, name: str) -> None:
        if self._inside is not None:
            self._read_transformations(*self._inside)
            self._inside = None
            return
        if name == "nodelet":
            self._finish_nodelet()
        self._stack.pop()

    def _text(self, text: str) -> None:
        if text.strip() and not self._foreign and not self._inside:
            line = self._parser.CurrentLineNumber
            self.problem(line, f"the text '{text.strip()[:40]}'; expected elements only")

    def _doctype(self, *_: object) -> None:
        raise _Stop(self._parser.CurrentLineNumber, "a DOCTYPE is refused; expected none")

    # What the elements say

    def _earlier(self, what: str, key: str, line: int) -> int:
        """Line in which this was seen before, or 0."""
        earlier = self._seen.get((what, key), 0)
        self._seen.setdefault((what, key), line)
        return earlier

    def _check_attributes(self, name: str, attributes: _Attributes, line: int) -> None:
        required, optional = _ATTRIBUTES[name]
        for key in required:
            if not attributes.get(key):
                self.problem(line, f'<{name}> without {key}="..."; expected it')
        known = required + optional
        for key in attributes:
            if key not in known:
                expected = ", ".join(known) or "none"
                self.problem(line, f"attribute {key} of <{name}>; expected attributes: {expected}")

    def _read_transformations(self, begin: int, line: int) -> None:
        end = self._parser.CurrentByteIndex
        if end <= begin:  # <transformations/>
            return
        closing = b"</transformations>"
        inside = self._data[begin:end] + closing
        if b"<transformation" not in inside[1:]:
            return
        # As many empty lines before it as the file has, so that messages name the file's lines.
        text = b"\n" * (line - 1) + inside
        try:
            self.transformations = parse(text, self._file).transformations
        except SpecificationError as error:
            self.problems.extend(error.problems)

    def _connect(self, attributes: _Attributes, line: int) -> None:
        port, topic = attributes.get("port", ""), attributes.get("topic", "")
        if port in self._connections:
            self.problem(line, f"the port '{port}' is there already; expected it once")
        if topic:
            self._check_global(topic, "topic name", line)
        if port and topic:
            self._connections[port] = topic

    def _finish_nodelet(self) -> None:
        attributes, line = self._nodelet or {}, self._nodelet_line
        name, manager = attributes.get("name", ""), attributes.get("manager", "")
        if name:
            self._check_global(name, "nodelet name", line)
            first = self._earlier("nodelet", name, line)
            if first:
                self.problem(line, f"the nodelet '{name}' is there already, in line {first}")
        if manager:
            self._check_global(manager, "nodelet manager", line)
        self.nodelets.append(
            WiredNodelet(
                name,
                attributes.get("transformation", ""),
                self._bool(attributes, "protected", line),
                self._bool(attributes, "isolated", line),
                manager,
                tuple(sorted(self._connections.items())),
            )
        )

    def _bool(self, attributes: _Attributes, key: str, line: int) -> bool:
        text = attributes.get(key, "false")
        if text not in _BOOLS:
            self.problem(line, f'{key}="{text}"; expected true or false')
        return _BOOLS.get(text, False)

    def _check_global(self, name: str, what: str, line: int) -> None:
        try:
            if not names.check(name, what).startswith("/"):
                self.problem(line, f"{what} '{name}'; expected a global one, '/{name}'")
        except InvalidName as error:
            self.problem(line, str(error))
