# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""An index of out-ports and live streams by the tags that they satisfy."""

from __future__ import annotations

import itertools
from typing import (
    AbstractSet,
    Dict,
    FrozenSet,
    Generic,
    Hashable,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
    TypeVar,
)

from dyknow.demand_text import write_demand
from dyknow.manager.specifications.tags import (
    NO_BINDINGS,
    NO_ONTOLOGY,
    Subsumption,
    Term,
    matches,
    unify_all,
)

_Functor = Tuple[str, int]  # with the number of arguments
Supplier = TypeVar("Supplier", bound=Hashable)

#: ROS types that go with every other: one that is not known, and one that carries all.
ANY = ("", "*")
#: Combinations of superordinate names that the index has for one tag.
_MOST_KEYS = 64


class Demand(NamedTuple):
    """What an in-port, or a client, asks of one stream: all tags, and a type unless empty."""

    tags: FrozenSet[Term]
    datatype: str = ""

    def __str__(self) -> str:
        """Write the demand for people."""
        return write_demand(map(str, self.tags), self.datatype)


def meets(
    tags: Iterable[Term], datatype: str, demand: Demand, ontology: Subsumption = NO_ONTOLOGY
) -> bool:
    """Return whether a stream of these tags and type is what is demanded."""
    return next(ways_to_meet(tags, datatype, demand, ontology), None) is not None


def ways_to_meet(
    tags: Iterable[Term],
    datatype: str,
    demand: Demand,
    ontology: Subsumption = NO_ONTOLOGY,
    bindings: Mapping[str, str] = NO_BINDINGS,
) -> Iterator[Dict[str, str]]:
    """Yield the bindings of each way in which a stream is what is demanded.

    Args:
        tags: of the stream; those with variables supply nothing.
        datatype: of the stream.
        demand: what is asked for.
        ontology: what is a kind of what.
        bindings: what variables stand for already.
    """
    if demand.datatype in ANY or datatype in (*ANY, demand.datatype):
        yield from unify_all(tags, sorted(demand.tags), ontology, bindings)


class Supply(Generic[Supplier]):
    """An index that grows and shrinks; ground demands are one look-up."""

    def __init__(self, ontology: Subsumption = NO_ONTOLOGY, most_keys: int = _MOST_KEYS) -> None:
        """Start empty.

        Args:
            ontology: what is a kind of what.
            most_keys: combinations of superordinate names that the index has for one tag; tags
                with more are compared one by one.
        """
        self._ontology = ontology
        self._most_keys = most_keys
        self._by_term: Dict[Term, Set[Supplier]] = {}
        self._by_functor: Optional[Dict[_Functor, Dict[Supplier, Set[Term]]]] = None
        self._wide: Dict[Supplier, Set[Term]] = {}
        self._tags: Dict[Supplier, Tuple[Term, ...]] = {}
        self._datatypes: Dict[Supplier, str] = {}

    def __len__(self) -> int:
        """Count the suppliers."""
        return len(self._datatypes)

    def add(self, supplier: Supplier, tags: Iterable[Term], datatype: str) -> None:
        """Add an out-port or stream; its tags with variables supply nothing."""
        tags = tuple(tags)
        self._tags[supplier] = self._tags.get(supplier, ()) + tags
        self._datatypes[supplier] = datatype
        by_term = self._by_term
        for term in tags:
            if not term.is_ground:
                continue
            if self._by_functor is not None:
                self._enter(self._by_functor, supplier, term)
            keys = self._keys(term)
            if keys is None:
                self._wide.setdefault(supplier, set()).add(term)
                continue
            for key in keys:
                if key in by_term:
                    by_term[key].add(supplier)
                else:
                    by_term[key] = {supplier}

    def remove(self, supplier: Supplier, tags: Iterable[Term]) -> None:
        """Remove what was added with the same tags."""
        self._tags.pop(supplier, None)
        self._datatypes.pop(supplier, None)
        self._wide.pop(supplier, None)
        for term in tags:
            if not term.is_ground:
                continue
            if self._by_functor is not None:
                for functor in self._ontology.names_above(term.functor):
                    self._by_functor.get((functor, len(term.args)), {}).pop(supplier, None)
            for key in self._keys(term) or ():
                self._by_term.get(key, set()).discard(supplier)

    def suppliers(self, demand: Demand) -> List[Supplier]:
        """Return the suppliers of every tag of a demand with the demanded type, in any order."""
        found: Optional[AbstractSet[Supplier]] = None
        for term in demand.tags:
            one = self._of_term(term)
            found = one if found is None else found & one
            if not found:
                return []
        if found and _shares_variables(demand.tags):
            found = {each for each in found if self._binds(each, demand)}
        wanted = demand.datatype
        if wanted in ANY:
            return list(found or ())
        types = self._datatypes
        return [each for each in found or () if types[each] in (*ANY, wanted)]

    def _binds(self, supplier: Supplier, demand: Demand) -> bool:
        """Whether the tags are met under the same bindings, if each of them is met alone."""
        ways = unify_all(self._tags[supplier], sorted(demand.tags), self._ontology)
        return next(ways, None) is not None

    def _of_term(self, demanded: Term) -> AbstractSet[Supplier]:
        if demanded.is_ground:
            named: AbstractSet[Supplier] = self._by_term.get(demanded, frozenset())
            candidates = self._wide
        else:
            named = frozenset()
            candidates = self._with_functor((demanded.functor, len(demanded.args)))
        if not candidates:
            return named
        found = set(named)
        for supplier, terms in candidates.items():
            if any(matches(term, demanded, self._ontology) for term in terms):
                found.add(supplier)
        return found

    def _with_functor(self, functor: _Functor) -> Dict[Supplier, Set[Term]]:
        """Return the suppliers of a functor, by an index that is made at the first call."""
        if self._by_functor is None:
            self._by_functor = {}
            for supplier, terms in self._tags.items():
                for term in terms:
                    if term.is_ground:
                        self._enter(self._by_functor, supplier, term)
        return self._by_functor.get(functor, {})

    def _enter(
        self, index: Dict[_Functor, Dict[Supplier, Set[Term]]], supplier: Supplier, term: Term
    ) -> None:
        for functor in self._ontology.names_above(term.functor):
            place = index.setdefault((functor, len(term.args)), {})
            place.setdefault(supplier, set()).add(term)

    def _keys(self, term: Term) -> Optional[Iterable[Term]]:
        """Return every ground demand that a tag satisfies; None if these are too many."""
        if self._ontology is NO_ONTOLOGY:
            return (term,)
        above = self._ontology.names_above
        functors = above(term.functor)
        choices = [above(arg) for arg in term.args]
        count = len(functors)
        for names in choices:
            count *= len(names)
        if count > self._most_keys:
            return None
        return [Term(name, args) for name in functors for args in itertools.product(*choices)]


def _shares_variables(terms: AbstractSet[Term]) -> bool:
    """Whether a variable occurs in several terms."""
    if len(terms) < 2:
        return False
    variables = [variable for term in terms for variable in term.variables]
    return len(set(variables)) < len(variables)
