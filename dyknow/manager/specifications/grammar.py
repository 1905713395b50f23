"""The rules of a specification's elements, taken from the shipped RelaxNG schema.

libxml2 can validate against the schema, but it stops at the first surprise, speaks of
"interleave" where a person needs to hear "expected <port>", and wants the whole document in
memory. So the reader streams, and this module turns the schema into the table the reader goes
by. The schema stays the one place where the grammar is written down.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Dict, Optional, Tuple

SCHEMA = Path(__file__).with_name("transformations.rng")
_RNG = "{http://relaxng.org/ns/structure/1.0}"


@dataclass
class AttributeRule:
    """What the grammar says of the value of one attribute.

    Attributes:
        values: The values it may have; None when the grammar leaves them open.
    """

    values: Optional[Tuple[str, ...]]


@dataclass
class ElementRule:
    """What the grammar says of one element.

    Attributes:
        name: The element's name.
        text: Whether it holds text; if not, it holds only elements.
        attributes: The rules of its attributes, by name.
        children: The rules of its child elements, by name.
        required_attributes: The names of the attributes that have to be there.
        required: The names of the children that have to be there.
        repeated: The names of the children that may stand more than once.
    """

    name: str
    text: bool = False
    attributes: Dict[str, AttributeRule] = field(default_factory=dict)
    children: Dict[str, ElementRule] = field(default_factory=dict)
    required_attributes: Tuple[str, ...] = ()
    required: Tuple[str, ...] = ()
    repeated: Tuple[str, ...] = ()


class UnsupportedSchema(Exception):
    """The schema uses a part of RelaxNG that this module does not know."""


@lru_cache(maxsize=None)
def roots(schema: Path = SCHEMA) -> Dict[str, ElementRule]:
    """Read the schema.

    Args:
        schema: The file, in RelaxNG's XML syntax.

    Returns:
        The rules of the elements a document may start with, by name.

    Raises:
        UnsupportedSchema: The schema uses a pattern outside the subset that is understood.
    """
    grammar = ElementTree.parse(str(schema)).getroot()
    return _SchemaReader(grammar).roots()


class _SchemaReader:
    """Collects element rules from a RelaxNG grammar whose definitions are one element each."""

    def __init__(self, grammar: ElementTree.Element) -> None:
        self._defines = {d.get("name"): d for d in grammar.iter(f"{_RNG}define")}
        self._rules: Dict[int, ElementRule] = {}
        self._start = grammar.find(f"{_RNG}start")

    def roots(self) -> Dict[str, ElementRule]:
        top = ElementRule("")
        if self._start is not None:
            self._read(self._start, top, required=True, repeated=False)
        return top.children

    def _read(
        self, patterns: ElementTree.Element, rule: ElementRule, required: bool, repeated: bool
    ) -> None:
        """Add what is written inside `patterns` to the rule of the element around them."""
        for pattern in patterns:
            kind = pattern.tag.replace(_RNG, "")
            if kind == "interleave":
                self._read(pattern, rule, required, repeated)
            elif kind in ("optional", "choice"):
                self._read(pattern, rule, False, repeated)
            elif kind == "zeroOrMore":
                self._read(pattern, rule, False, True)
            elif kind == "oneOrMore":
                self._read(pattern, rule, required, True)
            elif kind == "ref":
                self._read(self._defines[pattern.get("name")], rule, required, repeated)
            elif kind == "text":
                rule.text = True
            elif kind == "attribute":
                self._add_attribute(pattern, rule, required)
            elif kind == "element":
                self._add_child(pattern, rule, required, repeated)
            else:
                raise UnsupportedSchema(f"<{kind}> in the rules of <{rule.name}>")

    def _add_attribute(
        self, pattern: ElementTree.Element, rule: ElementRule, required: bool
    ) -> None:
        name = pattern.get("name", "")
        rule.attributes[name] = AttributeRule(_values(pattern))
        if required:
            rule.required_attributes += (name,)

    def _add_child(
        self, pattern: ElementTree.Element, rule: ElementRule, required: bool, repeated: bool
    ) -> None:
        name = pattern.get("name", "")
        child = self._rules.get(id(pattern))
        if child is None:
            child = self._rules[id(pattern)] = ElementRule(name)
            self._read(pattern, child, required=True, repeated=False)
        rule.children[name] = child
        if required:
            rule.required += (name,)
        if repeated:
            rule.repeated += (name,)


def _values(attribute: ElementTree.Element) -> Optional[Tuple[str, ...]]:
    values = attribute.findall(f"{_RNG}choice/{_RNG}value") + attribute.findall(f"{_RNG}value")
    return tuple((value.text or "").strip() for value in values) or None
