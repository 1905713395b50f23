# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tags: terms such as ``FieldPosition(ball)`` that describe streams.

A supplied tag matches a demanded one if its functor is the same or a subclass, and each argument
is equal to the demanded one, an instance or a subclass of it, or bound to a variable ``?x``. A
variable stands for one name throughout its term, and only demanded terms have variables.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Dict, NamedTuple, Protocol, Tuple

from dyknow.errors import InvalidTag

_TERM = re.compile(r"\s*([^(),?]*[^(),?\s])\s*(?:\(([^()]*)\)\s*)?\Z")
_ARGUMENT = re.compile(r"\??[^(),?]*[^(),?\s]\Z")

#: Lists of tags whose terms are remembered.
_REMEMBERED = 20_000

#: Longest tag that is read, in characters, and most arguments.
MAX_LENGTH = 4096
MAX_ARGUMENTS = 16


class Term(NamedTuple):
    """A functor and its arguments; an argument that begins with ``?`` is a variable."""

    functor: str
    args: Tuple[str, ...] = ()

    def __str__(self) -> str:
        """Write the term as ``parse_tag`` reads it."""
        return f"{self.functor}({', '.join(self.args)})" if self.args else self.functor

    @property
    def is_ground(self) -> bool:
        """Whether it has no variable."""
        return not [arg for arg in self.args if arg[:1] == "?"]  # a list is quicker than any()


class Subsumption(Protocol):
    """The subsumption of names, as an ontology knows it."""

    def names_above(self, name: str) -> frozenset[str]:
        """Every name that subsumes ``name``, itself included."""


class NoOntology:
    """Without an ontology a name subsumes only itself."""

    def names_above(self, name: str) -> frozenset[str]:
        """The name alone."""
        return frozenset((name,))


NO_ONTOLOGY = NoOntology()
"""What is there without an ontology."""


def parse_tag(text: str) -> Term:
    """Read a term.

    Raises:
        InvalidTag: it is no term; the error says what was expected.
    """
    if len(text) > MAX_LENGTH:
        raise InvalidTag(text[:40] + "…", f"expected at most {MAX_LENGTH} characters")
    found = _TERM.match(text)
    if found is None:
        raise InvalidTag(text, "expected Functor or Functor(arg, …)")
    functor, inner = found.groups()
    if inner is None:
        return Term(functor.strip())
    args = tuple(arg.strip() for arg in inner.split(","))
    if len(args) > MAX_ARGUMENTS:
        raise InvalidTag(text, f"expected at most {MAX_ARGUMENTS} arguments")
    for arg in args:
        if not _ARGUMENT.match(arg):
            raise InvalidTag(text, f"expected a name or a ?variable as argument, not '{arg}'")
    return Term(functor.strip(), args)


@lru_cache(maxsize=_REMEMBERED)
def read_tags(texts: Tuple[str, ...]) -> Tuple[Term, ...]:
    """Read the tags of a port; a text that is no term is ignored."""
    found = []
    for text in texts:
        try:
            found.append(parse_tag(text))
        except InvalidTag:
            continue
    return tuple(found)


def matches(supplied: Term, demanded: Term, ontology: Subsumption) -> bool:
    """Whether a supplied tag matches a demanded one."""
    if len(supplied.args) != len(demanded.args):
        return False
    if demanded.functor not in ontology.names_above(supplied.functor):
        return False
    bound: Dict[str, str] = {}
    for have, want in zip(supplied.args, demanded.args):
        if want.startswith("?"):
            if bound.setdefault(want, have) != have:
                return False
        elif want not in ontology.names_above(have):
            return False
    return True
