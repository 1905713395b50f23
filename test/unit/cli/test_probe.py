# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`dyknow probe`: the declarations that it derives from a node, and its refusals."""

from __future__ import annotations

import math

from unit.cli.fake_client import play

from dyknow.cli.commands.programs import _SHARED, _base, _parameters
from dyknow.manager.specifications.values import value_of


def test_parameters_are_read_again_as_they_are():
    tree = {
        "rate": 5,
        "gain": 0.5,
        "range_max": math.inf,
        "fast": True,
        "frame": "map",
        "pid": {"p": 1.5, "limits": [1, 1e-7, -math.inf]},
        "guards": {"dyknow__manager": {"read_only": False}},
    }
    assert {each.name: value_of(each) for each in _parameters(tree)} == {
        "rate": 5,
        "gain": 0.5,
        "range_max": math.inf,
        "fast": True,
        "frame": "map",
        "pid/p": 1.5,
        "pid/limits": [1, 1e-7, -math.inf],
    }


def test_a_node_is_called_like_its_program():
    names = [_base(program) for program in ("relay", "ball-finder.py", "3d.py")]
    assert names == ["relay", "ball_finder", "node_3d"]


def test_what_all_nodes_share_is_not_declared():
    for topic in ("/tf", "/diagnostics", "/camera/parameter_updates"):
        assert _SHARED.fullmatch(topic)
    for topic in ("/tf_of_robot", "/camera/image", "/robot/tf"):
        assert not _SHARED.fullmatch(topic)


def test_a_program_that_is_not_there():
    play(
        None,
        """
        $ probe topic_tools relais
        dyknow: ...package 'topic_tools' has no program 'relais'...
        [1]
        $ probe tropic_tools relay
        dyknow: ...there is no package 'tropic_tools' on ROS_PACKAGE_PATH...
        [1]
        $ run no_such_package node
        dyknow: ...there is no package 'no_such_package'...
        [1]
        $ run rospy no_such_program
        dyknow: ...package 'rospy' has no program 'no_such_program'...
        [1]
        """,
    )
