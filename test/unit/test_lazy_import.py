# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The layers without ROS can be used where there is no ROS: importing them must not import it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import dyknow

ROOT = Path(__file__).resolve().parents[2]


def modules_after(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*sys.modules)"
    printed = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    return set(printed.split())


def test_the_package_alone_loads_nothing() -> None:
    modules = modules_after("import dyknow")
    assert "rospy" not in modules
    assert [name for name in modules if name.startswith("dyknow.")] == []


@pytest.mark.parametrize("name", ["Nodelet", "NodeHandle", "formulas.parse"])
def test_a_name_of_the_author_loads_no_ros(name: str) -> None:
    modules = modules_after(f"import dyknow; dyknow.{name}")
    assert modules.isdisjoint({"rospy", "roslib", "genpy", "rosgraph", "dyknow_msgs"})


def test_the_client_needs_no_node_and_no_rospy() -> None:
    assert "rospy" not in modules_after("from dyknow import ManagerClient")


def test_a_script_of_its_own_waits_for_no_parser() -> None:
    """Each of these costs every re-wirable script its time at the start."""
    modules = modules_after("import dyknow.ros.nodelets.script_process")
    assert modules.isdisjoint({"lxml", "rdflib", "urllib.request", "importlib.resources"})


def test_names_are_listed_and_others_refused() -> None:
    assert {"ManagerClient", "Nodelet", "NodeHandle", "acquire", "formulas"} <= set(dir(dyknow))
    with pytest.raises(AttributeError, match="nonesuch"):
        dyknow.nonesuch  # noqa: B018
