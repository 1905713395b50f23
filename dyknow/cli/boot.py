# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Loads a wiring into a manager that starts, as `dyknow load --replace` does.

It makes transformations otherwise only if no specification file of the manager has them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Collection

from dyknow.errors import DyKnowError
from dyknow.manager.steps import carry_out
from dyknow.ros.manager.manager_node import WiringCalls
from dyknow.ros.shell.shell_client import ShellClient
from dyknow.wiring.load import steps_of
from dyknow.wiring.plan import plan_load
from dyknow.wiring.wiring import read_wiring


def check(data: bytes, file: str, most: int) -> None:
    """Raise SpecificationError unless a file is a wiring of at most so many nodelets."""
    read_wiring(data, file, lambda: most)


def load(manager: str, data: bytes, file: str, most: int, from_files: Collection[str]) -> None:
    """Load a wiring, all or nothing.

    Transformations that specification files of the manager have, ``from_files``, stay as they are.

    Raises:
        DyKnowError: it cannot be loaded now; everything is as it was.
    """
    client = ShellClient(manager)
    wiring = read_wiring(data, file, lambda: most)
    own = [each for each in wiring.transformations if each.label not in from_files]
    plan = plan_load(
        replace(wiring, transformations=tuple(own)),
        client.get_model(),
        client.places(),
        client.is_own_manager,
        replace=True,
        stored=client.stored_parameters,
    )
    if plan.problems:
        raise DyKnowError("; ".join(map(str, plan.problems)))
    carry_out(steps_of(plan, client))


CALLS = WiringCalls(check, load)  # for the manager's node
