# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes of an RDF graph as plain texts, and the lists that OWL writes with them."""

from __future__ import annotations

from typing import List, Set

import rdflib
from rdflib import RDF

_BLANK = "_:"


def node_key(node: rdflib.term.Node) -> str:
    """Return the URI of a node, or `_:` and a name of its own if it is blank."""
    return str(node) if isinstance(node, rdflib.URIRef) else f"{_BLANK}{node}"


def is_blank(key: str) -> bool:
    """Whether a key is that of a blank node; no URI begins so."""
    return key.startswith(_BLANK)


def local_name(uri: str) -> str:
    """Return the last part of a URI; all of it if there is no such part."""
    return uri.rsplit("#", 1)[-1].rsplit("/", 1)[-1] or uri


def list_members(
    graph: rdflib.Graph, head: rdflib.term.Node, seen: Set[rdflib.term.Node]
) -> List[rdflib.term.Node]:
    """Return the members of an RDF list.

    Args:
        graph: where it is.
        head: its first node.
        seen: the nodes of the lists that were read; those of this one are added.

    Raises:
        ValueError: it is no complete list, or shares nodes with another one or itself.
    """
    members: List[rdflib.term.Node] = []
    while head != RDF.nil:
        firsts, rests = list(graph.objects(head, RDF.first)), list(graph.objects(head, RDF.rest))
        if len(firsts) != 1 or len(rests) != 1:
            raise ValueError(
                f"{len(firsts)} rdf:first and {len(rests)} rdf:rest after {len(members)} members; "
                "expected one of each until rdf:nil"
            )
        if head in seen:
            raise ValueError("a list that goes in a circle, or is part of two; expected its own")
        seen.add(head)
        members.append(firsts[0])
        head = rests[0]
    return members
