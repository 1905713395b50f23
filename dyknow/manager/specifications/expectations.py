"""What the grammar expects, in words."""

from __future__ import annotations

from typing import Tuple

from dyknow.manager.specifications.grammar import ElementRule
from dyknow.manager.specifications.wording import meant, shorten


def children_of(rule: ElementRule) -> str:
    """Say which children an element may have."""
    names = " or ".join(f"<{name}>" for name in sorted(rule.children))
    return names or "text alone"


def one_of(values: Tuple[str, ...]) -> str:
    """Say which values an attribute may have."""
    return " or ".join(f"'{value}'" for value in values)


def unexpected_element(name: str, parent: ElementRule) -> str:
    """Say that an element is not expected here, and which would be."""
    where = f"in <{parent.name}>" if parent.name else "as the root"
    foreign = "; elements of other namespaces are refused" if ":" in name else ""
    hint = foreign or meant(name, parent.children)
    return f"unexpected <{shorten(name)}> {where}; expected {children_of(parent)}{hint}"


def unexpected_attribute(name: str, rule: ElementRule) -> str:
    """Say that an attribute is not expected here, and which would be."""
    expected = " or ".join(sorted(rule.attributes)) or "none"
    foreign = "; namespaces are refused" if name.split(":")[0] == "xmlns" else ""
    hint = foreign or meant(name, rule.attributes)
    return f"unexpected attribute {shorten(name)} of <{rule.name}>; expected {expected}{hint}"
