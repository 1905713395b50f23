# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Suites of ROS's own packages have the same verdicts with live ports as without.

They run where ``DYKNOW_ROS_COMM``, ``DYKNOW_NODELET_CORE`` and ``DYKNOW_ACTIONLIB`` name checkouts
of ros/ros_comm, ros/nodelet_core and ros/actionlib.
"""

from __future__ import annotations

import pytest
from unit.packaging.suites import Suites, checkout

#: Tests that live ports cannot pass, and why.
EXPECTED = {
    "rospy_deregister.test_unservice": "the services of the proxy are known to the master",
}
#: The suites of actionlib that are written in Python.
ACTIONLIB = (
    "test_imports",
    "test_python_exercise_simple_client",
    "test_python_server2",
    "test_python_server3",
    "test_python_server_components",
    "test_python_simple_server",
    "test_simple_action_server_deadlock_python",
)


@pytest.mark.long
def test_rospy(tmp_path):
    tests = checkout("DYKNOW_ROS_COMM") / "test"
    packages = [tests / "test_rospy", tests / "test_rosmaster"]
    suites = Suites(tmp_path, packages, ["tests", "all"])
    rostests = suites.source / "test_rospy/test/rostest"
    differing = suites.compare(sorted(rostests.glob("*.test")))
    assert set(differing) == set(EXPECTED), differing


@pytest.mark.long
def test_actionlib(tmp_path):
    suites = Suites(tmp_path, [checkout("DYKNOW_ACTIONLIB") / "actionlib"], [])
    folder = suites.source / "actionlib/test"
    assert suites.compare(folder / f"{name}.launch" for name in ACTIONLIB) == {}


@pytest.mark.long
@pytest.mark.parametrize(
    ("variable", "package"),
    [
        ("DYKNOW_ROS_COMM", "test/test_roscpp"),
        ("DYKNOW_NODELET_CORE", "test_nodelet"),
        ("DYKNOW_NODELET_CORE", "test_nodelet_topic_tools"),
        ("DYKNOW_ACTIONLIB", "actionlib"),
    ],
)
def test_cpp(tmp_path, variable, package):
    path = checkout(variable) / package
    suites = Suites(tmp_path, [path], ["tests", "all"], is_complete=False)
    assert suites.compare(suites.of_cpp(path.name)) == {}
