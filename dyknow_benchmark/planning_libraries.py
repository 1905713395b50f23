# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Large libraries to plan over, in the shapes that libraries have, each with demands.

Equal counts make equal libraries. ``deep`` and ``dense`` have no variables. In ``rules`` there
are many transformations with variables and few individuals: layers of kinds of streams, each of
which ten transformations can make from one or two kinds of the layer below. In ``individuals``
there are few transformations with variables, and many cameras on many robots; in ``rooms`` there
are 21 devices in each of many rooms, and a demand is about one room.
"""

from __future__ import annotations

import random
from typing import Callable, NamedTuple, Sequence

from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption
from dyknow.model.transformation import IN, OUT, Port, Transformation

#: Length of a chain of the deep library, and layers of the dense one.
_DEPTH = 100
#: Layers of a library of rules, and transformations that make one kind of stream.
_LAYERS = 10
_ALTERNATIVES = 10
_INDIVIDUALS = 5
#: Devices in a room.
_DEVICES = 21
_MOST_COST = 20


class Things:
    """An ontology in which every individual is a thing."""

    def names_above(self, name: str) -> frozenset[str]:
        """The name, and the class of all individuals."""
        return frozenset((name, "Thing") if name[:1].islower() else (name,))

    def canonical(self, name: str) -> str:
        """The name."""
        return name


class PlanningLibrary(NamedTuple):
    """A library, and demands of several sorts.

    Attributes:
        transformations: those to plan with.
        demands: tags by their sort: ``ground``, ``variable`` or ``class``.
        ontology: subsumption of names.
    """

    transformations: list[Transformation]
    demands: dict[str, list[str]]
    ontology: Subsumption = NO_ONTOLOGY


def deep(count: int) -> PlanningLibrary:
    """Write chains of 100 transformations, each of which needs the one before."""
    library = [
        _ground(number, [number - 1] if number % _DEPTH else [], number % 19 + 1)
        for number in range(count)
    ]
    return PlanningLibrary(library, _last_streams(count))


def dense(count: int) -> PlanningLibrary:
    """Write 100 layers whose transformations need one to three of the layer before."""
    chance = random.Random(2)
    width = max(1, count // _DEPTH)
    library = []
    for number in range(count):
        below = (number // width - 1) * width
        needs = [below + chance.randrange(width) for _ in range(chance.randint(1, 3))]
        cost = chance.randint(1, _MOST_COST)
        library.append(_ground(number, needs if below >= 0 else [], cost))
    return PlanningLibrary(library, _last_streams(count))


def rules(count: int, variables: int, ontology: Subsumption = NO_ONTOLOGY) -> PlanningLibrary:
    """Write layers of transformations with variables, over few individuals.

    Args:
        count: transformations.
        variables: of each transformation: one for ``Kind(?x)`` from ``Kind(?x)``, two for
            ``Kind(?x, ?y)`` from ``Kind(?y, ?x)``, three for ``Kind(?x, ?z)`` from
            ``Kind(?x, ?y)`` of the layer below and ``Kind(?y, ?z)`` of the lowest one.
        ontology: subsumption of names.
    """
    chance = random.Random(variables)
    names = [f"one{number}" for number in range(_INDIVIDUALS)]
    width = max(1, count // (_LAYERS * _ALTERNATIVES))
    inputs, output = (
        (["?x", "?x"], "?x"),
        (["?y, ?x", "?x, ?y"], "?x, ?y"),
        (["?x, ?y", "?y, ?z"], "?x, ?z"),
    )[variables - 1]
    library = []
    for number in range(count):
        layer = min(number // (width * _ALTERNATIVES), _LAYERS - 1)
        kind = f"Kind{layer}x{number % width}"
        cost = chance.randint(1, _MOST_COST)
        if not layer:
            some = chance.sample(names, 1 if variables == 1 else 2)
            library.append(_make(number, [], f"{kind}({', '.join(some)})", cost))
            continue
        fewest = 2 if variables > 2 else 1
        needs: list[str] = []
        for args in inputs[: chance.randint(fewest, 2)]:
            below = 0 if needs and variables > 2 else layer - 1
            needs.append(f"Kind{below}x{chance.randrange(width)}({args})")
        library.append(_make(number, needs, f"{kind}({output})", cost))
    goals = [f"Kind{_LAYERS - 1}x{number % width}" for number in range(3)]
    one = names[:1] if variables == 1 else names[:2]
    demands = {
        "ground": [f"{goal}({', '.join(one)})" for goal in goals],
        "variable": [f"{goal}({', '.join(['?a', '?b'][: len(one)])})" for goal in goals],
        "class": [f"{goal}({', '.join(['Thing'] * len(one))})" for goal in goals],
    }
    if ontology is NO_ONTOLOGY:
        del demands["class"]
    return PlanningLibrary(library, demands, ontology)


def individuals(count: int, ontology: Subsumption = NO_ONTOLOGY) -> PlanningLibrary:
    """Write many cameras on robots, and few transformations that work on any of them."""
    chance = random.Random(4)
    robots = max(1, count // 10)
    library = []
    for number in range(count - robots - 12):
        cost = chance.randint(1, _MOST_COST)
        library.append(_make(number, [], f"Raw(cam{number}, robot{number % robots})", cost))
    for number in range(robots):
        tag = f"Pose(robot{number})"
        library.append(_make(len(library), [], tag, chance.randint(1, _MOST_COST)))
    steps = ["Raw", *[f"Filtered{number}" for number in range(8)]]
    for before, after in zip(steps, steps[1:]):
        library.append(_make(len(library), [f"{before}(?c, ?r)"], f"{after}(?c, ?r)", 1))
    last = steps[-1]
    for needs, supplied in (
        ([f"{last}(?c, ?r)", "Pose(?r)"], "Located(?c, ?r)"),
        (["Raw(?a, ?r)", "Raw(?b, ?r)"], "Stereo(?a, ?b)"),
        (["Stereo(?a, ?b)", "Pose(?r)", f"{last}(?a, ?r)"], "Depth(?a, ?r)"),
        (["Depth(?a, ?r)", "Located(?b, ?r)"], "Fused(?r)"),
    ):
        library.append(_make(len(library), needs, supplied, 1))
    demands = {
        "ground": ["Located(cam3, robot3)", "Depth(cam4, robot4)", "Fused(robot5)"],
        "variable": ["Located(?c, robot3)", "Depth(?c, ?r)", "Fused(?r)"],
        "class": ["Located(Thing, robot3)", "Depth(Thing, Thing)", "Fused(Thing)"],
    }
    if ontology is NO_ONTOLOGY:
        del demands["class"]
    return PlanningLibrary(library, demands, ontology)


def rooms(count: int, needs_power: bool = False) -> PlanningLibrary:
    """Write many devices in rooms of 21, and transformations that join those of one room.

    Args:
        count: transformations.
        needs_power: whether the streams of devices need another one.
    """
    chance = random.Random(5)
    parts = 3 if needs_power else 2
    devices = max(1, (count - 2) // parts)
    library: list[Transformation] = []
    for number in range(devices):
        needs = [f"Power(dev{number})"] if needs_power else []
        pair = f"Pair(dev{number}, dev{(7 * number + 1) % devices})"
        library.append(_make(len(library), needs, pair, chance.randint(1, _MOST_COST)))
        scan = f"Scan(dev{number}, room{number // _DEVICES})"
        library.append(_make(len(library), [], scan, chance.randint(1, _MOST_COST)))
        if needs_power:
            library.append(_make(len(library), [], f"Power(dev{number})", 1))
    for supplied, inputs in (
        ("Surveyed(?r)", ["Pair(?a, ?b)", "Scan(?a, ?r)"]),
        ("Joined(?r)", ["Pair(?a, ?b)", "Pair(?b, ?c)", "Scan(?c, ?q)", "Scan(?a, ?r)"]),
    ):
        library.append(_make(len(library), inputs, supplied, 1))
    goals = ["Surveyed", "Joined"]
    demands = {
        "ground": [f"{goal}(room0)" for goal in goals],
        "variable": [f"{goal}(?r)" for goal in goals],
    }
    return PlanningLibrary(library, demands)


LIBRARIES: dict[str, Callable[[int], PlanningLibrary]] = {
    "deep": deep,
    "dense": dense,
    "rules, one variable": lambda count: rules(count, 1),
    "rules, two variables": lambda count: rules(count, 2),
    "rules, three variables": lambda count: rules(count, 3),
    "rules with an ontology": lambda count: rules(count, 2, Things()),
    "individuals": individuals,
    "individuals with an ontology": lambda count: individuals(count, Things()),
    "rooms": rooms,
    "rooms with power": lambda count: rooms(count, True),
}


def _last_streams(count: int) -> dict[str, list[str]]:
    tags = [f"Stream(x{max(0, count - 1 - number)})" for number in range(9)]
    return {"ground": tags, "variable": ["Stream(?x)"] * 3}


def _ground(number: int, needs: Sequence[int], cost: int) -> Transformation:
    return _make(number, [f"Stream(x{need})" for need in needs], f"Stream(x{number})", cost)


def _make(number: int, needs: Sequence[str], supplied: str, cost: int) -> Transformation:
    ports = [Port(f"in{k}", IN, "", (need,)) for k, need in enumerate(needs)]
    ports.append(Port("out", OUT, "std_msgs/Header", (supplied,)))
    return Transformation(f"t{number}", "dyknow/Relay", cost=cost, ports=tuple(ports))
