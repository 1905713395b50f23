# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Explains in plain words why a text is not well-formed XML."""

from __future__ import annotations

from typing import List, Tuple, Union
from xml.parsers import expat
from xml.parsers.expat import errors

from dyknow.manager.specifications.limits import SpecificationLimits

_UNFINISHED = (
    errors.XML_ERROR_TAG_MISMATCH,
    errors.XML_ERROR_NO_ELEMENTS,
    errors.XML_ERROR_UNCLOSED_TOKEN,
    errors.XML_ERROR_UNCLOSED_CDATA_SECTION,
)
_REASONS = {
    errors.XML_ERROR_NO_ELEMENTS: "no element; expected {roots}",
    errors.XML_ERROR_SYNTAX: "no XML; expected {roots}",
    errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: (
        "text after the root element; expected the end: one root element, {roots}"
    ),
    errors.XML_ERROR_UNDEFINED_ENTITY: (
        "an entity is refused; expected none but &lt; &gt; &amp; &quot; and &apos;"
    ),
    errors.XML_ERROR_BAD_CHAR_REF: "a character reference is refused; expected text",
    errors.XML_ERROR_DUPLICATE_ATTRIBUTE: "an attribute is there twice; expected it once",
}


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
    error: expat.ExpatError,
    data: bytes,
    position: int,
    open_elements: List[Tuple[str, int]],
    roots: str,
) -> Unreadable:
    """Convert expat's error to one that says what was expected.

    Args:
        error: What expat raised.
        data: The whole text.
        position: Where in `data` expat stopped.
        open_elements: Names and lines of the elements that were open, outermost first.
        roots: The elements that the text may start with, in words.
    """
    reason = errors.messages[error.code]
    if reason == errors.XML_ERROR_INVALID_TOKEN:
        reason = _explain_character(data[position : position + 4].decode("utf-8", "ignore")[:1])
    elif reason in _UNFINISHED and open_elements:
        name, line = open_elements[-1]
        reason += f"; expected the end </{name}> of the element in line {line}"
    else:
        reason = _REASONS.get(reason, reason).format(roots=roots)
    return Unreadable(error.lineno, reason)


def _explain_character(character: str) -> str:
    if character and (character < " " or character in "\ufffe\uffff"):
        return f"the character U+{ord(character):04X} is not allowed in XML; expected text"
    return (
        f"not well-formed at {character!r}; expected XML, with attributes in quotes and &lt; and "
        "&amp; for < and &"
    )
