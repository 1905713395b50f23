# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Libraries in which shared parts decide: set cover, in one layer or in two."""

from __future__ import annotations

import random
from typing import Dict, List, Sequence, Tuple

import numpy
from scipy.optimize import Bounds, LinearConstraint, milp
from unit.manager.planning.examples import make

from dyknow.model.transformation import Transformation


def set_cover(seed: int) -> List[Transformation]:
    """Write 60 to 150 transformations; the goal is ``Goal``.

    The goal needs many elements. Sets supply some of them; half of the libraries have sets that
    need devices, which they share.
    """
    chance = random.Random(seed)
    count = chance.randint(58, 148)
    elements = [f"E{number}" for number in range(chance.randint(15, 40))]
    devices = [f"D{number}" for number in range(chance.choice([0, 10]))]
    library = [make("goal", elements, ["Goal"], 0)]
    library += [make(f"device {tag}", [], [tag], chance.randint(5, 30)) for tag in devices]
    sets = []
    for number in range(count - len(devices)):
        size = chance.randint(2, 6)
        sets.append((chance.sample(elements, size), chance.randint(3, 12) * size // 2 + 1, number))
    covered = {element for elements_, _, _ in sets for element in elements_}
    rest = [element for element in elements if element not in covered]
    for members, cost, number in sets:
        needs = chance.sample(devices, chance.randint(0, 2)) if devices else []
        library.append(make(f"set {number}", needs, members, cost))
    library.append(make("rest", [], rest or ["Other"], 40))
    return library


def least_cost(library: Sequence[Transformation], goal: str) -> int:
    """Solve a library without cycles as a mixed integer program.

    Each demand of a used transformation is met by another one that is used.
    """
    number_of: Dict[str, int] = {each.label: at for at, each in enumerate(library)}
    makers: Dict[str, List[int]] = {}
    for each in library:
        for port in each.ports:
            if port.direction == "out":
                makers.setdefault(port.tags[0], []).append(number_of[each.label])
    rows: List[Tuple[List[int], int]] = [(makers[goal], -1)]
    for each in library:
        for port in each.ports:
            if port.direction == "in":
                rows.append((makers[port.tags[0]], number_of[each.label]))
    matrix = numpy.zeros((len(rows), len(library)))
    below = numpy.zeros(len(rows))
    for at, (suppliers, user) in enumerate(rows):
        matrix[at, suppliers] = 1
        if user < 0:
            below[at] = 1
        else:
            matrix[at, user] = -1
    found = milp(
        [each.cost for each in library],
        integrality=numpy.ones(len(library)),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(matrix, below, numpy.inf),
    )
    assert found.success
    return round(found.fun)
