# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Limits of specifications, so that a hostile text cannot exhaust the manager's memory.

``dyknow.guards.Guards`` limits requests in general; the page on security lists all limits.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SpecificationLimits:
    """The limits of specifications, wirings and ontologies, checked before memory is used."""

    text_size: int = 64 * 2**20  # Size of the XML text in bytes
    transformations: int = 200_000  # Number of transformations, templates expanded
    #: Parameters, ports and tags in all expanded transformations of one text.
    expanded_items: int = 4_000_000
    #: Characters in all expanded transformations of one text together.
    expanded_size: int = 256 * 2**20
    items: int = 10_000  # Args, parameters, ports and tags of one transformation together
    string_length: int = 2**20  # Characters in one value: a label, a parameter, a tag
    #: Depth to which elements, or the lists and mappings of a YAML value, may nest.
    nesting: int = 32
    yaml_nodes: int = 100_000  # Scalars, lists and mappings in one YAML value
    #: Characters in all YAML values of one text together, equal ones counted once.
    yaml_size: int = 16 * 2**20
    problems: int = 1000  # Problems that are listed; reading ends when there are more
    ontology_size: int = 256 * 2**20  # Size of one file of an ontology in bytes
    ontology_files: int = 1000  # Files of an ontology, those that are imported included
    #: Bytes that the entities of one RDF/XML file may expand to.
    expanded_entities: int = 16 * 2**20


DEFAULT_LIMITS = SpecificationLimits()
"""The limits of a manager without other settings."""
