# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Programs of packages are found as rosrun and roslaunch find them."""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Iterator

import pytest
from roslib.packages import find_node

from dyknow.errors import CannotRun
from dyknow.ros.process import programs

MANIFEST = """<package format="2"><name>{name}</name><version>0.0.0</version>
<description>none</description><maintainer email="a@example.org">a</maintainer>
<license>BSD</license></package>"""
Write = Callable[[str], Path]


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """A devel space with the package `lonely`; writes programs into it, or below its source."""
    source, devel = tmp_path / "src", tmp_path / "devel"
    package = source / "lonely"
    package.mkdir(parents=True)
    (package / "package.xml").write_text(MANIFEST.format(name="lonely"))
    devel.mkdir()
    (devel / ".catkin").write_text(str(source))
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(devel))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(source))
    programs._packages.cache_clear()

    def write(name: str) -> Path:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("#!/usr/bin/env python3\n")
        file.chmod(0o755)
        return file

    yield write
    programs._packages.cache_clear()


def test_the_relay_of_a_devel_space_stands_for_the_script_in_the_source(workspace: Write) -> None:
    relay = workspace("devel/lib/lonely/talk")
    workspace("src/lonely/scripts/talk")
    assert programs.find_program("lonely", "talk") == str(relay) == find_node("lonely", "talk")[0]
    assert programs.find_script("lonely/talk") == str(relay)
    workspace("src/lonely/more/talk")  # roslaunch does not mind
    assert programs.find_program("lonely", "talk") == str(relay)


def test_one_in_the_source_alone(workspace: Write) -> None:
    script = workspace("src/lonely/scripts/talk")
    assert programs.find_program("lonely", "talk") == str(script)


def test_a_path_below_the_package_is_that_program(workspace: Write) -> None:
    workspace("devel/lib/lonely/talk")
    script = workspace("src/lonely/scripts/talk")
    assert programs.find_program("lonely", "scripts/talk") == str(script)
    assert programs.find_script("lonely/scripts/talk") == str(script)
    script.chmod(0o644)
    with pytest.raises(CannotRun, match="no program 'scripts/talk'"):
        programs.find_program("lonely", "scripts/talk")


def test_a_path_leads_out_of_no_package(workspace: Write) -> None:
    workspace("elsewhere.py")
    with pytest.raises(CannotRun, match="has no program"):
        programs.find_script("lonely/../../elsewhere.py")


def test_several_of_a_name_are_told_apart_by_their_paths(workspace: Write) -> None:
    first, second = workspace("src/lonely/a/talk"), workspace("src/lonely/b/talk")
    with pytest.raises(CannotRun) as refused:
        programs.find_program("lonely", "talk")
    for expected in (str(first), str(second), "expected one program, or its path below"):
        assert expected in str(refused.value)


def test_what_is_not_there(workspace: Write) -> None:
    with pytest.raises(CannotRun, match="has no program 'talk'"):
        programs.find_program("lonely", "talk")
    with pytest.raises(CannotRun, match="no package 'lost'"):
        programs.find_program("lost", "talk")
    script = workspace("src/lonely/talk")  # is found from now on
    assert programs.find_program("lonely", "talk") == str(script)
