# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Patterns: demands and supplies with canonical names and numbered variables.

Two demands that differ only in the names of their variables have one pattern. A name in a demand
acts as a type: it subsumes the supplied name in its place.
"""

from __future__ import annotations

from typing import AbstractSet, FrozenSet, Iterable, Sequence, Tuple, Union

from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, Term, types_of

Argument = Union[str, int]
"""A canonical name, or the number of a variable."""
Atom = Tuple[Argument, ...]
"""A functor and its arguments. The garbage collector need not visit plain tuples of these."""
Types = FrozenSet[str]
Theta = Tuple[str, ...]
"""Canonical names that the wanted variables of a pattern, or those of an action, stand for."""
Limit = Union[None, str, Types]
"""A constraint on a variable: nothing, its name, or types that its name has to have.

The empty text stands for a contradiction.
"""
Known = Tuple[Limit, ...]
NO_TYPES: Types = frozenset()


class Pattern:
    """The demand of an in-port or a client; a library has one of each, compared by identity."""

    __slots__ = ("atoms", "datatype", "is_plain", "refused", "slow", "types", "uses", "wanted")

    def __init__(
        self,
        atoms: tuple[Atom, ...],
        datatype: str,
        types: tuple[Types, ...],
        wanted: tuple[int, ...] = (),
        slow: Pattern | None = None,
        refused: AbstractSet[str] = NO_TYPES,
    ) -> None:
        self.atoms = atoms  # the tags, all of which one stream has to have
        self.datatype = datatype  # ROS type; empty for any
        self.types = types  # for each variable, the concepts that have to subsume its name
        #: Variables whose names matter to the consumer; of streams that differ only in others, the
        #: cheapest will do.
        self.wanted = wanted
        self.slow = slow  # the same pattern without a rate, if this one demands a rate
        self.refused = refused  # ROS types that do not do; of a request's own pattern alone
        self.uses = 0  # how many in-ports of the library have it; a request's own pattern has none
        variables = [arg for arg in atoms[0] if isinstance(arg, int)]
        #: Whether it has one atom, in which no variable occurs twice.
        self.is_plain = len(atoms) == 1 and len({*variables}) == len(variables)

    @property
    def key(self) -> tuple[tuple[Atom, ...], str, tuple[Types, ...], tuple[int, ...]]:
        """Equal for patterns with the same meaning."""
        return self.atoms, self.datatype, self.types, self.wanted


class Names:
    """Names as the ontology relates them; the ontology is queried once for each name.

    Any thread may read while one thread enters names. The ontology does not change, so it does
    not matter which thread fills a cache.
    """

    def __init__(self, ontology: Subsumption) -> None:
        self.ontology = ontology
        self.is_plain = ontology is NO_ONTOLOGY
        self._canonical: dict[str, str] = {}
        self._above: dict[str, Types] = {}
        self._below: dict[str, list[str]] = {}
        self._entered: dict[str, None] = {}

    def canonical(self, name: str) -> str:
        """Return one name for all names of an entity."""
        if self.is_plain:
            return name
        found = self._canonical.get(name)
        if found is None:
            found = self._canonical[name] = self.ontology.canonical(name)
        return found

    def written(self, name: str) -> str:
        """Return a canonical name as people write it: a label rather than a URI."""
        return self.ontology.written(name)

    def above(self, name: str) -> Types:
        """Return the canonical names that subsume a canonical name."""
        found = self._above.get(name)
        if found is None:
            above = self.ontology.names_above(name)
            found = self._above[name] = frozenset(map(self.canonical, above)) | {name}
        return found

    def subsumes(self, upper: str, name: str) -> bool:
        return upper == name or (not self.is_plain and upper in self.above(name))

    def fits(self, name: str, types: Types) -> bool:
        """Whether all types subsume a name."""
        if self.is_plain:
            return not types or (len(types) == 1 and name in types)
        return types <= self.above(name)

    def narrowed(self, types: Types) -> Types:
        """Leave out the types that another one of them implies."""
        if len(types) < 2 or self.is_plain:
            return types or NO_TYPES
        return frozenset(
            each
            for each in types
            if not any(
                each in self.above(other) and (each < other or other not in self.above(each))
                for other in types - {each}
            )
        )

    def kinds(self, name: str) -> list[str]:
        """Return the most specific types of a canonical name, as people write them."""
        return sorted(map(self.written, self.narrowed(self.above(name) - {name})))

    def enter(self, name: str) -> None:
        """Let `below` know a canonical name that is supplied."""
        if not self.is_plain and name not in self._entered:
            for upper in self.above(name):
                self._below.setdefault(upper, []).append(name)
            self._entered[name] = None

    def below(self, types: Types) -> Sequence[str]:
        """Return the names that were entered and that all types, at least one, subsume."""
        if self.is_plain:
            return tuple(types) if len(types) == 1 else ()
        fewest = min([self._below.get(each, []) for each in types], key=len)
        return fewest if len(types) == 1 else [each for each in fewest if self.fits(each, types)]

    def is_one(self, limit: Limit) -> bool:
        """Whether a constraint leaves one of the entered names at most."""
        return len(self.below(limit)) < 2 if isinstance(limit, frozenset) else limit is not None

    def limit(self, types: Types) -> Limit:
        """Return the constraint of types: without an ontology a type is the name."""
        if self.is_plain and types:
            return next(iter(types)) if len(types) == 1 else ""
        return types or None

    def both(self, one: Limit, other: Limit) -> Limit:
        """Combine two constraints of a variable."""
        if one is None or one == other:
            return other
        if other is None:
            return one
        if isinstance(one, str):
            return one if not isinstance(other, str) and self.fits(one, other) else ""
        if isinstance(other, str):
            return other if self.fits(other, one) else ""
        return "" if self.is_plain else self.narrowed(one | other)

    def agrees(self, theta: Iterable[str], known: Known) -> bool:
        """Whether names meet the constraints on them."""
        for name, each in zip(theta, known):
            if isinstance(each, str):
                if each != name:
                    return False
            elif each is not None and not self.fits(name, each):
                return False
        return True


def atoms_of(terms: Iterable[Term], variables: Sequence[str], names: Names) -> tuple[Atom, ...]:
    """Number the variables of terms by their places in a list."""
    canonical = names.canonical
    found: list[Atom] = []
    for term in terms:
        args = [variables.index(arg) if arg[:1] == "?" else canonical(arg) for arg in term.args]
        found.append((canonical(term.functor), *args))
    return tuple(found)


def ground(atom: Atom, theta: Theta) -> Atom:
    """Put names in the places of variables."""
    return tuple([arg if isinstance(arg, str) else theta[arg] for arg in atom])


def pattern_of(
    terms: Iterable[Term],
    datatype: str,
    names: Names,
    wanted: Sequence[str] = (),
    types: Sequence[Types] = (),
) -> Pattern:
    """Return the pattern of a demand, with more types of the variables that are wanted."""
    terms = sorted(terms)
    variables = list(dict.fromkeys([each for term in terms for each in term.variables]))
    known = {key: frozenset(map(names.canonical, of)) for key, of in types_of(terms).items()}
    for variable, further in zip(wanted, types):
        known[variable] = known.get(variable, NO_TYPES) | further
    return Pattern(
        atoms_of(terms, variables, names),
        datatype,
        tuple([names.narrowed(known.get(each, NO_TYPES)) for each in variables]),
        tuple([variables.index(each) for each in wanted if each in variables]),
    )


def can_match(supplied: Atom, demanded: Atom, types: Sequence[Types], names: Names) -> bool:
    """Whether an atom can meet the demand, for some values of its variables."""
    if len(supplied) != len(demanded):
        return False
    for have, want in zip(supplied, demanded):
        if not isinstance(have, str):
            continue
        if isinstance(want, str):
            if not names.subsumes(want, have):
                return False
        elif not names.fits(have, types[want]):
            return False
    return True


def solutions(supplied: Sequence[Atom], pattern: Pattern, names: Names) -> list[Theta]:
    """Match ground atoms with a pattern.

    Returns:
        The names that the wanted variables can stand for, sorted; empty if the pattern is not
        met. Without wanted variables that is the empty tuple, or nothing.
    """
    ways: list[dict[int, str]] = [{}]
    for demanded in pattern.atoms:
        more = []
        for atom in supplied:
            if not can_match(atom, demanded, pattern.types, names):
                continue
            for way in ways:
                bound = dict(way)
                if all(
                    isinstance(want, str) or bound.setdefault(want, str(have)) == have
                    for have, want in zip(atom, demanded)
                ):
                    more.append(bound)
        ways = more
    return sorted({tuple([way[each] for each in pattern.wanted]) for way in ways})


def limits_of(pattern: Pattern, known: Known, atom: Atom, names: Names) -> Known:
    """Return the constraints on the arguments of an atom of a pattern."""
    if names.is_plain and not pattern.types:
        return atom[1:]  # type: ignore[return-value]
    by_variable = dict(zip(pattern.wanted, known))
    found: list[Limit] = []
    for arg in atom[1:]:
        if isinstance(arg, str):
            found.append(names.limit(frozenset((arg,))))
        else:
            found.append(names.both(names.limit(pattern.types[arg]), by_variable.get(arg)))
    return tuple(found)


def pushed(
    supplied: Sequence[Atom], pattern: Pattern, own: Sequence[Types], names: Names
) -> tuple[Types, ...] | None:
    """Unify the atoms of an out-port, which may have variables of some types, with a pattern.

    Returns:
        For each variable of the action, the pattern's further types for it; None if the
        out-port cannot supply the pattern. Constraints that need other bindings are left out, so
        instances are matched again.
    """
    more = [NO_TYPES] * len(own)
    for demanded in pattern.atoms:
        fitting = [atom for atom in supplied if can_match(atom, demanded, pattern.types, names)]
        if not fitting:
            return None
        if len(fitting) > 1:
            continue
        for have, want in zip(fitting[0], demanded):
            if isinstance(have, int):
                more[have] |= frozenset((want,)) if isinstance(want, str) else pattern.types[want]
    return tuple(
        [names.narrowed(types - own[at]) if types else types for at, types in enumerate(more)]
    )
