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
from typing import Callable, Sequence

from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption
from dyknow.model.transformation import IN, OUT, Port, Transformation

_DEPTH = 100  # length of a chain of the deep library, and layers of the dense one
#: Layers of a library of rules, and transformations that make one kind of stream.
_LAYERS = 10
_ALTERNATIVES = 10
_INDIVIDUALS = 5
_DEVICES = 21  # devices in a room


class Things:
    """An ontology in which every individual is a thing."""

    def names_above(self, name: str) -> frozenset[str]:
        """The name, and the class of all individuals."""
        return frozenset((name, "Thing") if name[:1].islower() else (name,))

    def canonical(self, name: str) -> str:
        return name

    def written(self, name: str) -> str:
        return name


class PlanningLibrary:
    """A library, and demands of several sorts: ``ground``, ``variable`` or ``class``."""

    def __init__(self, seed: int = 0, ontology: Subsumption = NO_ONTOLOGY) -> None:
        """Begin an empty library; the seed is for its random choices."""
        self.chance = random.Random(seed)
        self.ontology = ontology
        self.transformations: list[Transformation] = []
        self.demands: dict[str, Sequence[str]] = {}

    def add(self, needs: Sequence[str], supplied: str, cost: int = 0) -> None:
        """Add a transformation; 0 stands for a random cost."""
        ports = [Port(f"in{k}", IN, "", (need,)) for k, need in enumerate(needs)]
        ports.append(Port("out", OUT, "std_msgs/Header", (supplied,)))
        label, cost = f"t{len(self.transformations)}", cost or self.chance.randint(1, 20)
        self.transformations.append(
            Transformation(label, "dyknow/Relay", cost=cost, ports=tuple(ports))
        )

    def demand(self, ground: Sequence[str], variable: Sequence[str], *of_class: str) -> None:
        self.demands = {"ground": ground, "variable": variable}
        if self.ontology is not NO_ONTOLOGY:
            self.demands["class"] = of_class


def deep(count: int) -> PlanningLibrary:
    """Write chains of 100 transformations, each of which needs the one before."""
    library = PlanningLibrary()
    for number in range(count):
        needs = [f"Stream(x{number - 1})"] if number % _DEPTH else []
        library.add(needs, f"Stream(x{number})", number % 19 + 1)
    return _with_last_streams(library)


def dense(count: int) -> PlanningLibrary:
    """Write 100 layers whose transformations need one to three of the layer before."""
    library, width = PlanningLibrary(2), max(1, count // _DEPTH)
    chance = library.chance
    for number in range(count):
        below = (number // width - 1) * width
        needs = [below + chance.randrange(width) for _ in range(chance.randint(1, 3))]
        inputs = [f"Stream(x{need})" for need in needs] if below >= 0 else []
        library.add(inputs, f"Stream(x{number})")
    return _with_last_streams(library)


def _with_last_streams(library: PlanningLibrary) -> PlanningLibrary:
    last = len(library.transformations) - 1
    library.demand([f"Stream(x{max(0, last - each)})" for each in range(9)], ["Stream(?x)"] * 3)
    return library


def rules(count: int, variables: int, ontology: Subsumption = NO_ONTOLOGY) -> PlanningLibrary:
    """Write layers of transformations with variables, over few individuals.

    Args:
        count: transformations.
        variables: of each transformation: one for ``Kind(?x)`` from ``Kind(?x)``, two for
            ``Kind(?x, ?y)`` from ``Kind(?y, ?x)``, three for ``Kind(?x, ?z)`` from
            ``Kind(?x, ?y)`` of the layer below and ``Kind(?y, ?z)`` of the lowest one.
        ontology: subsumption of names.
    """
    library = PlanningLibrary(variables, ontology)
    chance = library.chance
    names = [f"one{number}" for number in range(_INDIVIDUALS)]
    width = max(1, count // (_LAYERS * _ALTERNATIVES))
    inputs, output = (
        (["?x", "?x"], "?x"),
        (["?y, ?x", "?x, ?y"], "?x, ?y"),
        (["?x, ?y", "?y, ?z"], "?x, ?z"),
    )[variables - 1]
    arguments = 1 if variables == 1 else 2
    for number in range(count):
        layer = min(number // (width * _ALTERNATIVES), _LAYERS - 1)
        kind = f"Kind{layer}x{number % width}"
        cost = chance.randint(1, 20)
        if not layer:
            library.add([], f"{kind}({', '.join(chance.sample(names, arguments))})", cost)
            continue
        needs: list[str] = []
        for args in inputs[: chance.randint(2 if variables > 2 else 1, 2)]:
            below = 0 if needs and variables > 2 else layer - 1
            needs.append(f"Kind{below}x{chance.randrange(width)}({args})")
        library.add(needs, f"{kind}({output})", cost)
    ground, variable, of_class = (
        [f"Kind{_LAYERS - 1}x{number % width}({', '.join(args)})" for number in range(3)]
        for args in (names[:arguments], ["?a", "?b"][:arguments], ["Thing"] * arguments)
    )
    library.demand(ground, variable, *of_class)
    return library


def individuals(count: int, ontology: Subsumption = NO_ONTOLOGY) -> PlanningLibrary:
    """Write many cameras on robots, and few transformations that work on any of them."""
    library, robots = PlanningLibrary(4, ontology), max(1, count // 10)
    for number in range(count - robots - 12):
        library.add([], f"Raw(cam{number}, robot{number % robots})")
    for number in range(robots):
        library.add([], f"Pose(robot{number})")
    steps = ["Raw", *[f"Filtered{number}" for number in range(8)]]
    for before, after in zip(steps, steps[1:]):
        library.add([f"{before}(?c, ?r)"], f"{after}(?c, ?r)", 1)
    last = steps[-1]
    library.add([f"{last}(?c, ?r)", "Pose(?r)"], "Located(?c, ?r)", 1)
    library.add(["Raw(?a, ?r)", "Raw(?b, ?r)"], "Stereo(?a, ?b)", 1)
    library.add(["Stereo(?a, ?b)", "Pose(?r)", f"{last}(?a, ?r)"], "Depth(?a, ?r)", 1)
    library.add(["Depth(?a, ?r)", "Located(?b, ?r)"], "Fused(?r)", 1)
    library.demand(
        ["Located(cam3, robot3)", "Depth(cam4, robot4)", "Fused(robot5)"],
        ["Located(?c, robot3)", "Depth(?c, ?r)", "Fused(?r)"],
        *("Located(Thing, robot3)", "Depth(Thing, Thing)", "Fused(Thing)"),
    )
    return library


def rooms(count: int, needs_power: bool = False) -> PlanningLibrary:
    """Write many devices in rooms of 21, and transformations that join those of one room.

    With ``needs_power`` the streams of devices need another one.
    """
    library = PlanningLibrary(5)
    devices = max(1, (count - 2) // (3 if needs_power else 2))
    for number in range(devices):
        power = [f"Power(dev{number})"] if needs_power else []
        library.add(power, f"Pair(dev{number}, dev{(7 * number + 1) % devices})")
        library.add([], f"Scan(dev{number}, room{number // _DEVICES})")
        for supplied in power:
            library.add([], supplied, 1)
    library.add(["Pair(?a, ?b)", "Scan(?a, ?r)"], "Surveyed(?r)", 1)
    inputs = ["Pair(?a, ?b)", "Pair(?b, ?c)", "Scan(?c, ?q)", "Scan(?a, ?r)"]
    library.add(inputs, "Joined(?r)", 1)
    library.demand(["Surveyed(room0)", "Joined(room0)"], ["Surveyed(?r)", "Joined(?r)"])
    return library


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
