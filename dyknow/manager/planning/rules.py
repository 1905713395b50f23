# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Transformations with variables, as rules: which in-ports demand what under the same bindings.

Variables that occur in one in-port alone are the affair of its pattern. All others are *joined*:
they are shared by in-ports, or exposed by out-ports and parameters. They are numbered in the
order in which a join over the in-ports binds them, so the names that they stand for are a tuple.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Dict, List, NamedTuple, Sequence, Tuple

from dyknow.manager.planning.patterns import (
    NO_TYPES,
    Names,
    Types,
)
from dyknow.manager.specifications.tags import Term, types_of
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import Transformation

_Terms = Tuple[Term, ...]
_Arguments = Tuple[Tuple[str, ...], Tuple[str, ...]]
"""Those of a term, and their types."""

#: Ways to join that are remembered.
_REMEMBERED = 1_000


class Premise(NamedTuple):
    """What a tagged in-port demands.

    Attributes:
        port: the in-port.
        terms: its tags.
        datatype: its ROS type; empty for any.
    """

    port: str
    terms: _Terms
    datatype: str


class JoinStep(NamedTuple):
    """How an in-port extends the bindings of those before it.

    Attributes:
        port: its place among the in-ports.
        variables: of the rule, in the order in which the in-port's pattern wants them.
        bound: those of them that are bound already.
        shared: their places among the variables of the in-port.
        added: places of the others.
    """

    port: int
    variables: Tuple[int, ...]
    bound: Tuple[int, ...]
    shared: Tuple[int, ...]
    added: Tuple[int, ...]


class Rule(NamedTuple):
    """A transformation whose in-ports have variables.

    Attributes:
        premises: of the in-ports, in the order written.
        variables: the joined variables, in the order in which they are bound.
        types: of the joined variables.
        joins: the order in which in-ports are joined; empty if no variable is.
        parameters: variables that parameters name.
    """

    premises: Tuple[Premise, ...]
    variables: Tuple[str, ...]
    types: Tuple[Types, ...]
    joins: Tuple[JoinStep, ...]
    parameters: Tuple[str, ...] = ()

    def shown(self, port: int, more: Sequence[Types], names: Names) -> List[Term]:
        """Return the tags of an in-port as people write them, if more is said of its variables."""
        known = {
            variable: names.written(min(types))
            for variable, types in zip(self.variables, more)
            if types
        }
        return [term.substitute(known) for term in self.premises[port].terms]


def rule_of(
    transformation: Transformation, premises: Sequence[Premise], out: Sequence[Term], names: Names
) -> Rule:
    """Read the variables of a transformation.

    Args:
        transformation: what is read.
        premises: what its tagged in-ports demand.
        out: the tags of its out-ports.
        names: how names are related.
    """
    texts = [parameter.text for parameter in transformation.parameters]
    parameters = tuple(dict.fromkeys([each for text in texts for each in variables_of(text)]))
    variables, types, joins = _joined(
        tuple([tuple([term[1:] for term in each.terms]) for each in premises]),
        tuple([term[1:] for term in out]),
        parameters,
    )
    canonical = tuple([frozenset(map(names.canonical, each)) if each else each for each in types])
    return Rule(tuple(premises), variables, canonical, joins, parameters)


@lru_cache(maxsize=_REMEMBERED)
def _joined(
    premises: Tuple[Tuple[_Arguments, ...], ...],
    out: Tuple[_Arguments, ...],
    parameters: Tuple[str, ...],
) -> Tuple[Tuple[str, ...], Tuple[Types, ...], Tuple[JoinStep, ...]]:
    """Return the joined variables with their types, and the joins: many rules have equal ones."""
    terms = [[Term("", *each) for each in premise] for premise in premises]
    supplied = [Term("", *each) for each in out]
    exposed = {each for term in supplied for each in term.variables}.union(parameters)
    by_port = [list(dict.fromkeys(v for term in each for v in term.variables)) for each in terms]
    counts: Dict[str, int] = {}
    for variables in by_port:
        for each in variables:
            counts[each] = counts.get(each, 0) + 1
    joined = [
        [each for each in variables if counts[each] > 1 or each in exposed]
        for variables in by_port
    ]
    order: List[str] = []
    joins = []
    waiting = list(range(len(premises)))
    while waiting and any(joined):
        # First what is bound most: the fewer new variables, the fewer combinations.
        port = min(waiting, key=lambda at: (len(set(joined[at]) - set(order)), at))
        waiting.remove(port)
        known = len(order)
        order += [each for each in joined[port] if each not in order]
        # The pattern wants the variables in the order of the rule.
        places = sorted(order.index(each) for each in joined[port])
        shared = tuple(at for at, each in enumerate(places) if each < known)
        added = tuple(at for at, each in enumerate(places) if each >= known)
        bound = tuple(each for each in places if each < known)
        joins.append(JoinStep(port, tuple(places), bound, shared, added))
    types = types_of([*(term for each in terms for term in each), *supplied])
    return tuple(order), tuple(types.get(each, NO_TYPES) for each in order), tuple(joins)
