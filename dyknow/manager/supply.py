"""Who supplies what: an index of out-ports and live streams by the tags that they satisfy."""

from __future__ import annotations

import itertools
from typing import (
    Dict,
    FrozenSet,
    Generic,
    Hashable,
    Iterable,
    List,
    NamedTuple,
    Set,
    Tuple,
    TypeVar,
)

from dyknow.manager.tags import NO_ONTOLOGY, Subsumption, Term, matches

_Key = Tuple[str, Tuple[str, ...]]
Supplier = TypeVar("Supplier", bound=Hashable)

#: Combinations of superordinate names that are spelled out in the index for one tag.
_SPELLED_OUT = 64


class Demand(NamedTuple):
    """What an in-port, or a client, asks of one stream: all tags, and a type unless empty."""

    tags: FrozenSet[Term]
    datatype: str = ""

    def __str__(self) -> str:
        """Write the demand for people."""
        text = " & ".join(sorted(map(str, self.tags)))
        return f"{text} [{self.datatype}]" if self.datatype else text


class Supply(Generic[Supplier]):
    """An index that grows and shrinks; ground demands are one look-up."""

    def __init__(
        self, ontology: Subsumption = NO_ONTOLOGY, spelled_out: int = _SPELLED_OUT
    ) -> None:
        """Start empty.

        Args:
            ontology: what is a kind of what.
            spelled_out: combinations of superordinate names to spell out for one tag; tags with
                more are compared one by one.
        """
        self._ontology = ontology
        self._spelled_out = spelled_out
        self._by_term: Dict[_Key, Dict[Supplier, Term]] = {}
        self._by_functor: Dict[Tuple[str, int], Dict[Supplier, Set[Term]]] = {}
        self._wide: Dict[Supplier, Set[Term]] = {}
        self._datatypes: Dict[Supplier, str] = {}

    def __len__(self) -> int:
        """Count the suppliers."""
        return len(self._datatypes)

    def add(self, supplier: Supplier, tags: Iterable[Term], datatype: str) -> None:
        """Add an out-port or stream; tags with variables supply nothing and are passed over."""
        self._datatypes[supplier] = datatype
        for term in tags:
            if not term.is_ground:
                continue
            for functor in self._ontology.names_above(term.functor):
                place = self._by_functor.setdefault((functor, len(term.args)), {})
                place.setdefault(supplier, set()).add(term)
            keys = self._keys(term)
            if keys is None:
                self._wide.setdefault(supplier, set()).add(term)
                continue
            for key in keys:
                self._by_term.setdefault(key, {})[supplier] = term

    def remove(self, supplier: Supplier, tags: Iterable[Term]) -> None:
        """Remove what was added with the same tags."""
        self._datatypes.pop(supplier, None)
        self._wide.pop(supplier, None)
        for term in tags:
            if not term.is_ground:
                continue
            for functor in self._ontology.names_above(term.functor):
                self._by_functor.get((functor, len(term.args)), {}).pop(supplier, None)
            for key in self._keys(term) or ():
                self._by_term.get(key, {}).pop(supplier, None)

    def suppliers(self, demand: Demand) -> List[Supplier]:
        """Who satisfies every tag of the demand with the demanded type, in no special order."""
        found: Set[Supplier] | None = None
        for term in demand.tags:
            one = self._of_term(term)
            found = one if found is None else found & one
            if not found:
                return []
        types = self._datatypes
        wanted = demand.datatype
        return [
            each
            for each in found or ()
            if not wanted or not types[each] or types[each] in (wanted, "*") or wanted == "*"
        ]

    def _of_term(self, demanded: Term) -> Set[Supplier]:
        if demanded.is_ground:
            found = set(self._by_term.get((demanded.functor, demanded.args), ()))
            candidates = self._wide
        else:
            found = set()
            candidates = self._by_functor.get((demanded.functor, len(demanded.args)), {})
        for supplier, terms in candidates.items():
            if any(matches(term, demanded, self._ontology) for term in terms):
                found.add(supplier)
        return found

    def _keys(self, term: Term) -> List[_Key] | None:
        above = self._ontology.names_above
        functors = above(term.functor)
        choices = [above(arg) for arg in term.args]
        count = len(functors)
        for names in choices:
            count *= len(names)
        if count > self._spelled_out:
            return None
        return [(functor, args) for functor in functors for args in itertools.product(*choices)]
