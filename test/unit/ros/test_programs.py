# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Programs of packages are found as rosrun and roslaunch find them."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import pytest
from roslib.packages import find_node

from dyknow.errors import CannotRun
from dyknow.ros.process.programs import _packages, find_program, find_script

MANIFEST = """<package format="2"><name>lonely</name><version>0.0.0</version>
<description>none</description><maintainer email="a@example.org">a</maintainer>
<license>BSD</license></package>"""
Write = Callable[[str], Path]


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    """A devel space with the package `lonely`; writes programs into it, or below its source."""
    source, devel = tmp_path / "src", tmp_path / "devel"
    (source / "lonely").mkdir(parents=True)
    (source / "lonely" / "package.xml").write_text(MANIFEST)
    devel.mkdir()
    (devel / ".catkin").write_text(str(source))
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(devel))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(source))
    _packages.cache_clear()

    def write(name):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("#!/usr/bin/env python3\n")
        file.chmod(0o755)
        return file

    yield write
    _packages.cache_clear()


def test_the_relay_of_a_devel_space_stands_for_the_script_in_the_source(workspace):
    script = workspace("src/lonely/scripts/talk")
    assert find_program("lonely", "talk") == str(script)
    relay = workspace("devel/lib/lonely/talk")
    assert find_program("lonely", "talk") == str(relay) == find_node("lonely", "talk")[0]
    assert find_script("lonely/talk") == str(relay)
    workspace("src/lonely/more/talk")  # roslaunch does not mind
    assert find_program("lonely", "talk") == str(relay)


def test_a_path_below_the_package_is_that_program(workspace):
    workspace("devel/lib/lonely/talk")
    script = workspace("src/lonely/scripts/talk")
    assert find_program("lonely", "scripts/talk") == str(script)
    assert find_script("lonely/scripts/talk") == str(script)
    script.chmod(0o644)
    with pytest.raises(CannotRun, match="no program 'scripts/talk'"):
        find_program("lonely", "scripts/talk")
    workspace("elsewhere.py")
    with pytest.raises(CannotRun, match="has no program"):
        find_script("lonely/../../elsewhere.py")


def test_refusals_name_the_programs_or_the_package(workspace):
    with pytest.raises(CannotRun, match="has no program 'talk'"):
        find_program("lonely", "talk")
    with pytest.raises(CannotRun, match="no package 'lost'"):
        find_program("lost", "talk")
    first = workspace("src/lonely/a/talk")
    assert find_program("lonely", "talk") == str(first), "it is found from now on"
    second = workspace("src/lonely/b/talk")
    with pytest.raises(CannotRun) as refused:
        find_program("lonely", "talk")
    for expected in (str(first), str(second), "expected one program, or its path below"):
        assert expected in str(refused.value)
