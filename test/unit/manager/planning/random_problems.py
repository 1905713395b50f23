# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Random planning problems with everything that tags can say."""

from __future__ import annotations

import random
from typing import Any, Dict, FrozenSet, List, Sequence, Tuple

import pytest
from unit.manager.planning.brute_force import Problem, individuals, variables_in

from dyknow.manager.planning import request
from dyknow.manager.planning.problem import Demand, Live, Verdicts, Wishes
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Bindings, Term, parse_tag
from dyknow.model.transformation import Port, Requirement, Transformation

_MANY = request.MANY
_FUNCTORS = {"A": 1, "B": 1, "C": 2, "D": 1, "E": 0, "F": 2}


class Kinds:
    """Names of a and b, below classes; A is a subclass of D, and a has two names."""

    _ABOVE: Dict[str, List[str]] = {
        "a": ["K"],
        "urn:a": ["K"],
        "b": ["K", "L"],
        "c": ["L"],
        "K": ["M"],
        "A": ["D"],
    }

    def names_above(self, name: str) -> FrozenSet[str]:
        found = {name}
        waiting = [name]
        while waiting:
            for each in self._ABOVE.get(waiting.pop(), ()):
                if each not in found:
                    found.add(each)
                    waiting.append(each)
        if found & {"a", "urn:a"}:
            found |= {"a", "urn:a"}
        return frozenset(found)

    def canonical(self, name: str) -> str:
        return "urn:a" if name == "a" else name

    def written(self, name: str) -> str:
        return "a" if name == "urn:a" else name


class _Writer:
    """Writes problems; every other one is rich in bindings.

    In these, transformations with in-ports supply the goal's functor, which no source supplies.
    """

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.has_ontology = self.chance.random() < 0.5
        self.names = ["a", "b", "c"][: self.chance.randint(1, 3)]
        if self.has_ontology and self.chance.random() < 0.3:
            self.names.append("urn:a")
        self.functors = self.chance.sample(
            sorted(_FUNCTORS), self.chance.choice([2, 2, 3, 3, 4, 6])
        )
        self.is_rich = seed % 2 == 1
        self.sources = self.made = self.functors
        if self.is_rich:
            self.functors = ["C", "F", *self.chance.sample("ABD", self.chance.randint(1, 2))]
            self.chance.shuffle(self.functors)
            self.sources, self.made = self.functors[:-1], self.functors[-2:]

    def name(self, may_be_class: bool) -> str:
        if may_be_class and self.has_ontology and self.chance.random() < 0.4:
            return self.chance.choice(["K", "L", "M"])
        return self.chance.choice(self.names)

    def tag(
        self, variables: List[str], share: float, may_have_type: bool, functors: Sequence[str] = ()
    ) -> str:
        functor = self.chance.choice(functors or self.functors)
        args = []
        for _ in range(_FUNCTORS[functor]):
            if variables and self.chance.random() < share:
                arg = self.chance.choice(variables)
                if may_have_type and self.has_ontology and self.chance.random() < 0.25:
                    arg += ": " + self.chance.choice(["K", "L", "M", "b"])
                args.append(arg)
            else:
                args.append(self.name(may_have_type))
        return str(parse_tag(f"{functor}({', '.join(args)})" if args else functor))

    def datatype(self) -> str:
        return self.chance.choice(["", "", "", "", "t/X", "t/Y", "*"])

    def transformation(self, number: int) -> Transformation:
        chance = self.chance
        variables = ["?x", "?y", "?z"][: chance.choice([0, 1, 1, 2, 2, 2, 3])]
        ports = []
        for at in range(chance.choice([1, 1, 2, 2, 3] if self.is_rich else [0, 1, 1, 1, 2, 2, 3])):
            tags = tuple(
                dict.fromkeys(
                    self.tag(variables, 0.85, True) for _ in range(chance.choice([1, 1, 1, 2]))
                )
            )
            ports.append(Port(f"in{at}", "in", self.datatype(), tags))
        bound = sorted({a for p in ports for t in p.tags for a in parse_tag(t).variables})
        for at in range(chance.choice([1, 1, 2])):
            tags = tuple(
                dict.fromkeys(
                    self.tag(bound, 0.9, bool(bound) and chance.random() < 0.3, self.made)
                    for _ in range(chance.choice([1, 1, 2]))
                )
            )
            ports.append(Port(f"out{at}", "out", self.datatype(), tags))
        return Transformation(
            f"t{number}", "p/X", "nodelet", chance.randint(0, 9), (), tuple(ports)
        )

    def source(self, number: int) -> Transformation:
        tags = tuple(
            dict.fromkeys(
                self.tag([], 0, False, self.sources) for _ in range(self.chance.choice([1, 2]))
            )
        )
        port = Port("out0", "out", self.datatype(), tags)
        return Transformation(
            f"t{number}", "p/X", "nodelet", self.chance.randint(0, 9), (), (port,)
        )

    def live(self, number: int) -> Tuple[Live, Tuple[Term, ...]]:
        stream = Live(f"/s{number}", "out0", "", f"t{self.chance.randrange(9)}", self.datatype())
        return stream, tuple(
            parse_tag(self.tag([], 0, False)) for _ in range(self.chance.choice([1, 2]))
        )

    def problem(self) -> Problem:
        chance = self.chance
        count = chance.randint(1, 8)
        actions = [self.transformation(number) for number in range(count)]
        sources = chance.randint(2, 5) if self.is_rich else chance.randint(0, 3)
        actions += [self.source(count + number) for number in range(sources)]
        live = [self.live(number) for number in range(chance.choice([0, 0, 1, 2]))]
        labels = [each.label for each in actions]
        exclude = chance.sample(labels, min(len(labels), chance.choice([0, 0, 0, 1])))
        goal = frozenset(
            parse_tag(self.tag(["?p", "?q"], 0.4, True, self.made[-1:] if self.is_rich else ()))
            for _ in range(1 if self.is_rich else chance.choice([1, 1, 1, 2]))
        )
        ontology = Kinds() if self.has_ontology else NO_ONTOLOGY
        return Problem(
            tuple(actions),
            tuple(live),
            frozenset(exclude),
            Demand(goal, self.datatype()),
            ontology,
        )


def random_problem(seed: int) -> Problem:
    """Write a problem; equal seeds write equal problems."""
    return _Writer(seed).problem()


def look_up_by_name(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Look makers up by known names in half of the problems, however few makers there are."""
    monkeypatch.setattr(request, "MANY", 0 if seed // 2 % 2 else _MANY)


def with_verdicts(problem: Problem, seed: int) -> Problem:
    """Let transformations require verdicts, of which some are known."""
    chance = random.Random(seed)
    known = sorted(map(problem.ontology.canonical, individuals(problem)))

    def required(each: Transformation) -> Tuple[Requirement, ...]:
        inputs = [port for port in each.ports if port.direction == "in"]
        tags = [parse_tag(tag) for port in inputs for tag in port.tags]
        names = sorted({arg for tag in tags for arg in tag.variables}) + known
        count = chance.choice([0, 0, 0, 1, 2]) if names else 0
        return tuple(
            Requirement(f"V{chance.randrange(2)}({chance.choice(names)})", chance.random() < 0.8)
            for _ in range(count)
        )

    tags = [Term(f"V{number}", (name,)) for number in range(2) for name in known]
    chosen = [chance.choice([0, 1, 1, 2]) for _ in tags]
    good, bad = (
        frozenset([tag for tag, each in zip(tags, chosen) if each == value]) for value in (1, 2)
    )
    library = tuple([each._replace(requires=required(each)) for each in problem.library])
    return problem._replace(library=library, verdicts=Verdicts(good, bad))


def with_wishes(problem: Problem, seed: int) -> Problem:
    """Let a client prefer and avoid some labels and concepts."""
    chance = random.Random(seed)
    names = [each.label for each in problem.library]
    names += ["a", "b", "A", "B", "C", "D", "E", "K", "L"]
    chosen = chance.sample(names, chance.choice([1, 2, 3]))
    split = chance.randint(0, len(chosen))
    return problem._replace(wishes=Wishes(tuple(chosen[:split]), tuple(chosen[split:])))


def with_nodelets(problem: Problem, seed: int) -> Problem:
    """Let nodelets be free, several of one transformation among them, under any bindings.

    Of some transformations no new nodelet is made.
    """
    chance = random.Random(seed)
    names = individuals(problem) or ["a"]
    free: List[Tuple[str, Bindings]] = []
    for each in problem.library:
        tags = {
            way: [parse_tag(t) for p in each.ports if p.direction == way for t in p.tags]
            for way in ("in", "out")
        }
        exposed = set(variables_in(tags["in"])) & set(variables_in(tags["out"]))
        for _ in range(chance.choice([0, 1, 2, 2, 3, 3])):
            kept = [v for v in sorted(exposed) if chance.random() < 0.7]
            free.append((each.label, tuple((v, chance.choice(names)) for v in kept)))
    labels = [each.label for each in problem.library]
    paused = frozenset(label for label in labels if chance.random() < 0.25)
    return problem._replace(free=tuple(free), paused=paused)


def with_limits(problem: Problem, seed: int) -> Problem:
    """Let out-ports and streams state rates and latencies, and the goal demand some."""
    chance = random.Random(seed)

    def stated() -> Dict[str, Any]:
        latency = chance.choice([0.0, 0.0, 0.01, 0.02, 0.03, 0.1])
        return {"rate": chance.choice([0.0, 0.0, 0.0, 5.0, 30.0]), "latency": latency}

    limited = [
        each._replace(
            ports=tuple(
                port._replace(**stated()) if port.direction == "out" else port
                for port in each.ports
            )
        )
        for each in problem.library
    ]
    live = [(stream._replace(**stated()), terms) for stream, terms in problem.live]
    min_rate = chance.choice([0.0, 0.0, 10.0])
    max_age = chance.choice([0.0, 0.005, 0.01, 0.03, 0.03, 0.05, 0.1, 0.12])
    goal = problem.goal._replace(min_rate=min_rate, max_age=0.0 if min_rate else max_age)
    return problem._replace(library=tuple(limited), live=tuple(live), goal=goal)
