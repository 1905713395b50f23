# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tags: terms such as ``FieldPosition(ball)`` that describe streams, and their unification.

A supplied tag matches a demanded one if its functor is the same or a subclass, and each argument
is equal to the demanded one, an instance or a subclass of it, or bound to a variable ``?x``, or to
``?x: Concept`` if the concept subsumes it. A variable stands for one individual wherever it
occurs, and its types add up.
"""

from __future__ import annotations

import re
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Iterable, Iterator, Mapping, NamedTuple, Protocol, Tuple

from dyknow.errors import DyKnowError, InvalidTag, InvalidType

if TYPE_CHECKING:
    from dyknow.formulas import Range

_TERM = re.compile(r"([^(),?]*[^(),?\s])\s*(?:\(([^()]*)\))?\Z")
_ARGUMENT = re.compile(r"\??[^(),?]*[^(),?\s]\Z")

#: Lists of tags whose terms are remembered.
_REMEMBERED = 2_000

#: Longest tag that is read, in characters, and most arguments.
MAX_LENGTH = 4096
MAX_ARGUMENTS = 16

Bindings = Tuple[Tuple[str, str], ...]
"""Variables, each with the name that it stands for, sorted."""
NO_BINDINGS: Mapping[str, str] = MappingProxyType({})
"""No variable stands for anything."""


def written_bindings(bindings: Bindings) -> str:
    """Write bindings for people: ``?camera=left, ?robot=nao``."""
    return ", ".join(f"{variable}={name}" for variable, name in bindings)


class Term(NamedTuple):
    """A functor and its arguments."""

    functor: str  # kind of the stream
    #: Names; an argument that begins with ``?`` is a variable, without its type.
    args: tuple[str, ...] = ()
    #: For each argument the concept that restricts it, or an empty text; nothing at all if no
    #: argument has a type.
    types: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Write the term as ``parse_tag`` reads it."""
        if not self.args:
            return self.functor
        types = self.types or ("",) * len(self.args)
        args = [f"{arg}: {type_}" if type_ else arg for arg, type_ in zip(self.args, types)]
        return f"{self.functor}({', '.join(args)})"

    @property
    def is_ground(self) -> bool:
        """Whether it has no variable."""
        return not [arg for arg in self.args if arg[:1] == "?"]  # a list is quicker than any()

    @property
    def variables(self) -> tuple[str, ...]:
        """Its variables, in the order written."""
        return tuple(dict.fromkeys([arg for arg in self.args if arg[:1] == "?"]))

    def substitute(self, bindings: Mapping[str, str]) -> Term:
        """Put names in the places of variables; unbound ones stay, with their types."""
        args = tuple(bindings.get(arg, arg) for arg in self.args)
        types = tuple("" if arg[:1] != "?" else type_ for arg, type_ in zip(args, self.types))
        return Term(self.functor, args, types if any(types) else ())

    def restricted(self, variable: str, concept: str) -> Term:
        """Give a variable a type wherever it has none."""
        types = self.types or ("",) * len(self.args)
        found = [concept if a == variable and not t else t for a, t in zip(self.args, types)]
        return Term(self.functor, self.args, tuple(found) if any(found) else ())


class Subsumption(Protocol):
    """The subsumption of names, as an ontology knows it."""

    def names_above(self, name: str) -> frozenset[str]:
        """Every name that subsumes ``name``, itself included."""

    def canonical(self, name: str) -> str:
        """One name for all names of an entity."""

    def written(self, name: str) -> str:
        """The name of an entity for people, of which this is the canonical one."""


class NoOntology:
    """Without an ontology a name subsumes only itself."""

    def names_above(self, name: str) -> frozenset[str]:
        return frozenset((name,))

    def canonical(self, name: str) -> str:
        return name

    def written(self, name: str) -> str:
        return name


NO_ONTOLOGY = NoOntology()
"""What is there without an ontology."""


def parse_tag(text: str) -> Term:
    """Read a term.

    Raises:
        InvalidTag: it is not a term; the error names the expected form.
        InvalidType: it would be one but for the type of a variable.
    """
    if len(text) > MAX_LENGTH:
        raise InvalidTag(text[:40] + "…", f"expected at most {MAX_LENGTH} characters")
    found = _TERM.match(text.strip())
    if found is None:
        raise InvalidTag(text, "expected Functor or Functor(arg, …)")
    functor, inner = found.groups()
    if inner is None:
        return Term(functor)
    args = tuple([arg.strip() for arg in inner.split(",")])
    if len(args) > MAX_ARGUMENTS:
        raise InvalidTag(text, f"expected at most {MAX_ARGUMENTS} arguments")
    for arg in args:
        if not _ARGUMENT.match(arg):
            raise InvalidTag(text, f"expected a name or a ?variable as argument, not '{arg}'")
    if not [arg for arg in args if arg[:1] == "?" and ":" in arg]:
        return Term(functor, args)
    names, types = zip(*[_variable(text, arg) if arg[:1] == "?" else (arg, "") for arg in args])
    return Term(functor, names, types)


def _variable(text: str, arg: str) -> tuple[str, str]:
    """Split ``?x: Concept``; the type is empty if there is none."""
    variable, colon, type_ = arg.partition(":")
    variable, type_ = variable.rstrip(), type_.lstrip()
    if variable == "?" or (colon and not type_):
        raise InvalidType(text, f"expected ?variable: Concept, not '{arg}'")
    return variable, type_


@lru_cache(maxsize=_REMEMBERED)
def read_tags(texts: tuple[str, ...]) -> tuple[Term, ...]:
    """Read the tags of a port; texts that are not terms are ignored."""
    found = []
    for text in texts:
        try:
            found.append(parse_tag(text))
        except InvalidTag:
            continue
    return tuple(found)


def unify(
    supplied: Term,
    demanded: Term,
    ontology: Subsumption,
    bindings: Mapping[str, str] = NO_BINDINGS,
) -> dict[str, str] | None:
    """Match a supplied tag, which is ground, with a demanded one, given some bindings.

    Returns:
        The bindings and those of the variables that the demanded tag binds first, each to the
        name as it is supplied; None if the tags do not match.
    """
    if len(supplied.args) != len(demanded.args):
        return None
    if demanded.functor not in ontology.names_above(supplied.functor):
        return None
    bound = dict(bindings)
    types = demanded.types or ("",) * len(demanded.args)
    for have, want, type_ in zip(supplied.args, demanded.args, types):
        if want[:1] != "?":
            if want not in ontology.names_above(have):
                return None
            continue
        if type_ and type_ not in ontology.names_above(have):
            return None
        known = bound.setdefault(want, have)
        if known != have and ontology.canonical(known) != ontology.canonical(have):
            return None
    return bound


def unify_all(
    supplied: Iterable[Term],
    demanded: Iterable[Term],
    ontology: Subsumption,
    bindings: Mapping[str, str] = NO_BINDINGS,
) -> Iterator[dict[str, str]]:
    """Match every demanded tag with one of the tags of a stream, under the same bindings.

    Yields the bindings of each way, in the order of the demanded and the supplied tags.
    """
    demanded = tuple(demanded)
    ground = [tag for tag in supplied if tag.is_ground]
    waiting: list[tuple[int, dict[str, str]]] = [(0, dict(bindings))]
    while waiting:
        number, bound = waiting.pop()
        if number == len(demanded):
            yield bound
            continue
        found = [unify(tag, demanded[number], ontology, bound) for tag in ground]
        waiting += [(number + 1, each) for each in reversed(found) if each is not None]


def types_of(terms: Iterable[Term]) -> dict[str, frozenset[str]]:
    """Collect the types of variables over all their occurrences."""
    found: dict[str, frozenset[str]] = {}
    for term in terms:
        for arg, type_ in zip(term.args, term.types):
            if type_:
                found[arg] = found.get(arg, frozenset()) | {type_}
    return found


def tag_of_individuals(port: str, tag: Term, wanted: Range) -> Term:
    """Return the tag of a port below a quantifier, with the quantifier's concept.

    The bindings of the tag are the individuals.

    Raises:
        DyKnowError: it does not have the quantifier's variable, or has it with another concept.
    """
    variable, concept = wanted
    where = f"the tag {tag} of the port '{port}'"
    if variable not in tag.variables:
        has = f"the variable {', '.join(tag.variables)}" if tag.variables else "no variable"
        raise DyKnowError(f"{where} has {has}; expected the quantifier's, {variable}")
    for other in sorted(types_of([tag]).get(variable, frozenset()) - {concept}):
        if concept:
            raise DyKnowError(
                f"{where} has the variable {variable} with the concept {other}; expected the "
                f"quantifier's, {concept}"
            )
    return tag.restricted(variable, concept)
