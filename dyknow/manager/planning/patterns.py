# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Patterns: demands and supplies with canonical names and numbered variables.

Two demands that differ only in the names of their variables are one pattern. A name in a demand
says no more than a type: it subsumes what is supplied in its place.
"""

from __future__ import annotations

from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, Term, types_of

Argument = Union[str, int]
"""A canonical name, or the number of a variable."""
Types = FrozenSet[str]
Theta = Tuple[str, ...]
"""Canonical names that the wanted variables of a pattern, or those of a rule, stand for."""

Known = Tuple[Union[None, str, Types], ...]
"""For wanted variables: the name that one stands for, types that it has to have, or nothing."""

NO_TYPES: Types = frozenset()


class Atom(NamedTuple):
    """A functor and its arguments."""

    functor: str
    args: Tuple[Argument, ...]

    def ground(self, theta: Theta) -> Atom:
        """Put names in the places of the variables."""
        return Atom(
            self.functor,
            tuple([arg if type(arg) is str else theta[arg] for arg in self.args]),  # type: ignore[index]
        )


class Pattern(NamedTuple):
    """What one stream has to be.

    Attributes:
        atoms: its tags, all of them.
        datatype: ROS type; empty for any.
        types: for each variable, what has to subsume its name.
        wanted: variables whose names matter to what demands it; of streams that differ in
            the others only, the cheapest will do.
    """

    atoms: Tuple[Atom, ...]
    datatype: str
    types: Tuple[Types, ...] = ()
    wanted: Tuple[int, ...] = ()


class Names:
    """Names as the ontology relates them; what it says is asked once for each name.

    Any thread may read while one thread enters names.
    """

    def __init__(self, ontology: Subsumption) -> None:
        """Start without a name."""
        self.ontology = ontology
        self.is_plain = ontology is NO_ONTOLOGY
        # What the ontology says does not change, so it does not matter which thread notes it.
        self._canonical: Dict[str, str] = {}
        self._above: Dict[str, FrozenSet[str]] = {}
        self._below: Dict[str, List[str]] = {}
        self._entered: Dict[str, None] = {}

    def canonical(self, name: str) -> str:
        """Return one name for all names of an entity."""
        if self.is_plain:
            return name
        found = self._canonical.get(name)
        if found is None:
            found = self._canonical[name] = self.ontology.canonical(name)
        return found

    def written(self, name: str) -> str:
        """Return a canonical name as people write it: rather a label than a URI."""
        if self.is_plain:
            return name
        same = [each for each in self.ontology.names_above(name) if self.canonical(each) == name]
        return min([*same, name], key=lambda each: ("://" in each or ":" in each, each))

    def above(self, name: str) -> FrozenSet[str]:
        """Return the canonical names that subsume a canonical name."""
        found = self._above.get(name)
        if found is None:
            above = self.ontology.names_above(name)
            found = self._above[name] = frozenset(map(self.canonical, above)) | {name}
        return found

    def subsumes(self, upper: str, name: str) -> bool:
        """Whether one canonical name subsumes another."""
        return upper == name or (not self.is_plain and upper in self.above(name))

    def fits(self, name: str, types: Types) -> bool:
        """Whether all types subsume a name."""
        if self.is_plain:
            return all(each == name for each in types)
        return types <= self.above(name)

    def narrowed(self, types: Types) -> Types:
        """Leave out the types that another one of them implies."""
        if len(types) < 2 or self.is_plain:
            return types
        return frozenset(
            each
            for each in types
            if not any(
                each in self.above(other) and (each < other or other not in self.above(each))
                for other in types
                if other != each
            )
        )

    def kinds(self, name: str) -> List[str]:
        """Return what a canonical name is, as people write it: what is said most closely."""
        above = self.above(name) - {name}
        closest = [
            each
            for each in above
            if not any(
                each in self.above(other) and other not in self.above(each) for other in above
            )
        ]
        return sorted(map(self.written, closest))

    def enter(self, name: str) -> None:
        """Let ``below`` know a canonical name that is supplied."""
        if not self.is_plain and name not in self._entered:
            for upper in self.above(name):
                self._below.setdefault(upper, []).append(name)
            self._entered[name] = None

    def below(self, types: Types) -> Sequence[str]:
        """Return the names that were entered and that all types subsume; one type at least."""
        if self.is_plain:
            return tuple(types) if len(types) == 1 else ()
        lists = sorted([self._below.get(each, []) for each in types], key=len)
        if len(lists) == 1:
            return lists[0]
        return [each for each in lists[0] if self.fits(each, types)]

    def is_known(self, types: Types) -> Union[None, str, Types]:
        """Return what types say of a variable: without an ontology a type is the name."""
        if not types:
            return None
        return next(iter(types)) if self.is_plain and len(types) == 1 else types


def atoms_of(terms: Iterable[Term], variables: Sequence[str], names: Names) -> Tuple[Atom, ...]:
    """Number the variables of terms by their places in a list."""
    canonical = names.canonical
    return tuple(
        [
            Atom(
                canonical(term.functor),
                tuple(
                    [
                        variables.index(arg) if arg[:1] == "?" else canonical(arg)
                        for arg in term.args
                    ]
                ),
            )
            for term in terms
        ]
    )


def pattern_of(
    terms: Iterable[Term],
    datatype: str,
    names: Names,
    wanted: Sequence[str] = (),
    types: Sequence[Types] = (),
) -> Pattern:
    """Return the pattern of a demand.

    Args:
        terms: its tags.
        datatype: ROS type; empty for any.
        names: how names are related.
        wanted: variables whose names matter.
        types: their types, besides those of the tags.
    """
    terms = sorted(terms)
    variables = list(dict.fromkeys(each for term in terms for each in term.variables))
    known = {key: frozenset(map(names.canonical, of)) for key, of in types_of(terms).items()}
    for variable, further in zip(wanted, types):
        known[variable] = known.get(variable, NO_TYPES) | further
    return Pattern(
        atoms_of(terms, variables, names),
        datatype,
        tuple([names.narrowed(known.get(each, NO_TYPES)) for each in variables]),
        tuple([variables.index(each) for each in wanted if each in variables]),
    )


def solutions(supplied: Sequence[Atom], pattern: Pattern, names: Names) -> List[Theta]:
    """Match ground atoms with a pattern.

    Returns:
        The names that the wanted variables can stand for, sorted; empty if the pattern is not
        met. Without wanted variables that is the empty tuple, or nothing.
    """
    found: Dict[Theta, None] = {}
    waiting: List[Tuple[int, Dict[int, str]]] = [(0, {})]
    while waiting:
        number, bound = waiting.pop()
        if number == len(pattern.atoms):
            found[tuple([bound[each] for each in pattern.wanted])] = None
            if not pattern.wanted:
                break
            continue
        for atom in supplied:
            more = _bound(atom, pattern.atoms[number], pattern.types, bound, names)
            if more is not None:
                waiting.append((number + 1, more))
    return sorted(found)


def is_plain(pattern: Pattern) -> bool:
    """Whether a pattern has one atom, and no variable occurs twice."""
    if len(pattern.atoms) > 1:
        return False
    variables = [arg for arg in pattern.atoms[0].args if isinstance(arg, int)]
    return len(set(variables)) == len(variables)


def agrees(theta: Theta, known: Known, names: Names) -> bool:
    """Whether names are as what is known of them."""
    for name, each in zip(theta, known):
        if each is None or each == name:
            continue
        if isinstance(each, str) or not names.fits(name, each):
            return False
    return True


def bounds_of(pattern: Pattern, known: Known, atom: Atom, names: Names) -> Known:
    """Return what is known of the arguments of an atom of a pattern."""
    by_variable = dict(zip(pattern.wanted, known))
    found: List[Union[None, str, Types]] = []
    for arg in atom.args:
        types = frozenset((arg,)) if isinstance(arg, str) else pattern.types[arg]
        more = None if isinstance(arg, str) else by_variable.get(arg)
        if isinstance(more, frozenset):
            more = names.is_known(names.narrowed(types | more))
        found.append(names.is_known(types) if more is None else more)
    return tuple(found)


def matcher(
    pattern: Pattern, known: Known, names: Names
) -> Callable[[Sequence[Atom]], Sequence[Theta]]:
    """Return what matches ground atoms with a pattern, fast where many are to be matched.

    The atoms are such that each of the pattern has one among them of the same number of
    arguments, whose functor it subsumes.
    """

    def match(supplied: Sequence[Atom]) -> Sequence[Theta]:
        found = solutions(supplied, pattern, names)
        return [theta for theta in found if agrees(theta, known, names)] if known else found

    if not is_plain(pattern):
        return match
    args = pattern.atoms[0].args
    exact: List[Tuple[int, str]] = []
    typed: List[Tuple[int, Types, Dict[str, bool]]] = []
    for at, each in enumerate(bounds_of(pattern, known, pattern.atoms[0], names)):
        arg = args[at]
        types = frozenset((arg,)) if isinstance(arg, str) else pattern.types[arg]
        if isinstance(each, str):
            exact.append((at, each))
        if types and not (names.is_plain and types == {each}):
            typed.append((at, types, {}))
        if isinstance(each, frozenset) and each != types:
            typed.append((at, each, {}))
    places = [args.index(each) for each in pattern.wanted]

    def match_one(supplied: Sequence[Atom]) -> Sequence[Theta]:
        if len(supplied) > 1:
            return match(supplied)
        have: Tuple[Any, ...] = supplied[0].args
        for at, name in exact:
            if have[at] != name:
                return ()
        for at, types, checked in typed:
            name = have[at]
            if name not in checked:
                checked[name] = names.fits(name, types)
            if not checked[name]:
                return ()
        return (tuple([have[at] for at in places]),)

    return match_one


def places_in(pattern: Pattern, supplied: Sequence[Atom]) -> Optional[Tuple[Argument, ...]]:
    """Return what atoms with variables have in the places of a pattern's wanted variables.

    None if it cannot be told before the variables are bound whether the atoms match.
    """
    if len(supplied) > 1 or not is_plain(pattern):
        return None
    args = pattern.atoms[0].args
    return tuple([supplied[0].args[args.index(each)] for each in pattern.wanted])


def pushed(
    supplied: Sequence[Atom], pattern: Pattern, own: Sequence[Types], names: Names
) -> Optional[Tuple[Types, ...]]:
    """Unify the atoms of an out-port, which have variables, with a pattern.

    Args:
        supplied: the atoms.
        pattern: what is demanded.
        own: the types of the variables of the out-port's rule.
        names: how names are related.

    Returns:
        For each variable of the rule, what the pattern demands of it besides; None if the
        out-port cannot supply the pattern. What can be said of a variable only after others
        are bound is left out, so instances are matched again.
    """
    more = [NO_TYPES] * len(own)
    for demanded in pattern.atoms:
        fitting = [atom for atom in supplied if _can_be(atom, demanded, pattern.types, names)]
        if not fitting:
            return None
        if len(fitting) > 1:
            continue
        for have, want in zip(fitting[0].args, demanded.args):
            if isinstance(have, int):
                bounds = frozenset((want,)) if isinstance(want, str) else pattern.types[want]
                if bounds:
                    more[have] |= bounds
    return tuple(
        [names.narrowed(types - own[i]) if types else types for i, types in enumerate(more)]
    )


def _bound(
    supplied: Atom, demanded: Atom, types: Tuple[Types, ...], bound: Dict[int, str], names: Names
) -> Optional[Dict[int, str]]:
    if len(supplied.args) != len(demanded.args):
        return None
    if not names.subsumes(demanded.functor, supplied.functor):
        return None
    more = bound
    for have, want in zip(supplied.args, demanded.args):
        assert isinstance(have, str)
        if isinstance(want, str):
            if want != have and not names.subsumes(want, have):
                return None
            continue
        known = more.get(want)
        if known is None:
            if types[want] and not names.fits(have, types[want]):
                return None
            more = {**more, want: have}
        elif known != have:
            return None
    return more


def _can_be(supplied: Atom, demanded: Atom, types: Tuple[Types, ...], names: Names) -> bool:
    if len(supplied.args) != len(demanded.args):
        return False
    if not names.subsumes(demanded.functor, supplied.functor):
        return False
    for have, want in zip(supplied.args, demanded.args):
        if isinstance(have, str):
            if isinstance(want, str):
                if not names.subsumes(want, have):
                    return False
            elif not names.fits(have, types[want]):
                return False
    return True
