"""How large a specification may be, so that a hostile one cannot take the manager's memory."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """The caps that hold while a specification is read; each is checked before it would hurt.

    Attributes:
        text_size: Size of the XML text in bytes.
        transformations: Number of transformations, templates expanded.
        expanded_size: Characters in all expanded transformations of one text together.
        string_length: Characters in one value: a label, a parameter, a tag.
        nesting: Depth to which elements, or the lists and mappings of a YAML value, may nest.
        yaml_nodes: Scalars, lists and mappings in one YAML value.
        problems: Problems that are listed; reading ends when there are more.
    """

    text_size: int = 64 * 2**20
    transformations: int = 200_000
    expanded_size: int = 256 * 2**20
    string_length: int = 2**20
    nesting: int = 32
    yaml_nodes: int = 100_000
    problems: int = 1000


DEFAULT_LIMITS = Limits()
"""The limits of a manager that is told no others."""
