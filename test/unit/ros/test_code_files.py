# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Files of code: programs of packages, files of nodelets, and how changes are noticed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from clocks import HandClock
from roslib.packages import find_node

from dyknow.errors import CannotRun, HostError
from dyknow.model.transformation import Transformation
from dyknow.ros.hosting.code_files import CodeFiles
from dyknow.ros.process.programs import _packages, find_program, find_script

MANIFEST = """<package format="2"><name>{name}</name><version>0.0.0</version>
<description>d</description><maintainer email="a@example.org">a</maintainer><license>BSD</license>
<export><dyknow plugin="${{prefix}}/nodelets.xml"/><nodelet plugin="${{prefix}}/cpp.xml"/></export>
</package>"""
PLUGINS = """<library path="src">
  <class name="{name}/One" type="{name}_one.One" base_class_type="dyknow.Nodelet"/>
</library>"""
CPP = """<library path="lib/lib{name}"><class name="{name}/cpp" type="a::B"
  base_class_type="nodelet::Nodelet"/></library>"""


def write(file: Path, text: str) -> Path:
    """Write a program or a module."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    file.chmod(0o755)
    return file


class Package:
    """A package with a nodelet, its helper, a module that it does not use, and a script."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder / name, name
        self.write("package.xml", MANIFEST.format(name=name))
        self.write("nodelets.xml", PLUGINS.format(name=name))
        self.write("cpp.xml", CPP.format(name=name))
        self.write(f"src/{name}_one.py", f"import {name}_helper")
        self.write(f"src/{name}_helper.py", "VALUE = 1")
        self.write(f"src/{name}_apart.py", "VALUE = 1")
        self.write("scripts/run.py", "#!/usr/bin/env python3\nimport beside")
        self.write("scripts/beside.py", "")
        self.clock = HandClock()
        self.code = CodeFiles(self.clock.now)

    def write(self, path: str, text: str) -> None:
        write(self.folder / path, text)

    def nodelet(self, what: str = "One") -> Transformation:
        return Transformation("label", f"{self.name}/{what}")

    @property
    def script(self) -> Transformation:
        return Transformation("label", f"{self.name}/run.py", "node")

    def changes(self, transformation: Transformation, path: str, text: str = "VALUE = 22") -> bool:
        """Whether writing a file changes the code that would be loaded."""
        before = self.code.of(transformation, anew=True)
        self.write(path, text)
        assert self.code.of(transformation) == before, "it was looked at just now"
        self.clock.time += 0.5
        return self.code.of(transformation) != before


@pytest.fixture
def package(tmp_path: Path, monkeypatch: Any) -> Package:
    name = f"code_{tmp_path.name.replace('-', '_')}"
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(tmp_path))
    return Package(tmp_path, name)


def test_a_nodelet_is_its_module_and_what_that_imports(package: Package) -> None:
    one, name = package.nodelet(), package.name
    assert package.changes(one, f"src/{name}_helper.py")
    assert package.changes(one, f"src/{name}_one.py", f"import {name}_apart")
    assert package.changes(one, f"src/{name}_apart.py")
    assert not package.changes(one, f"src/{name}_helper.py", "VALUE = 333")


def test_a_script_is_its_file_and_the_modules_beside_it(package: Package) -> None:
    assert package.changes(package.script, "scripts/run.py", "#!/usr/bin/env python3\n")
    assert not package.changes(package.script, "scripts/beside.py")
    package.write("scripts/run.py", "#!/usr/bin/env python3\nimport beside")
    assert package.changes(package.script, "scripts/beside.py", "VALUE = 333")


def test_a_node_runs_the_version_that_was_saved_last(package: Package) -> None:
    """Python takes versions of one second and size for the same."""
    package.write("scripts/run.py", "#!/usr/bin/env python3\nimport beside\nprint(beside.VALUE)")
    script, beside = (package.folder / "scripts" / name for name in ("run.py", "beside.py"))
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    printed = []
    for value in range(3):
        beside.write_text(f"VALUE = {value}")
        os.utime(beside, (0, 1000))
        package.code.of(package.script, anew=True)
        printed.append(
            subprocess.check_output([sys.executable, str(script)], env=environment, text=True)
        )
    assert printed == ["0\n", "1\n", "2\n"]


def test_a_nodelet_in_cpp_is_its_library(package: Package, tmp_path: Path) -> None:
    cpp = package.nodelet("cpp")
    assert package.code.of(cpp, anew=True) == ""
    (tmp_path / "lib").mkdir()
    library = tmp_path / "lib" / f"lib{package.name}.so"
    library.write_bytes(b"\x7fELF one")
    before = package.code.of(cpp, anew=True)
    library.write_bytes(b"\x7fELF another")
    package.clock.time += 0.5
    assert "" != before != package.code.of(cpp)
    package.code.check(cpp)


def test_what_is_ours_or_not_here_has_no_code(package: Package) -> None:
    for source in ("dyknow/Relay", "nowhere/Nodelet", "nowhere"):
        assert package.code.of(Transformation("label", source), anew=True) == ""
    assert package.code.of(Transformation("label", "nowhere/x.py", "node"), anew=True) == ""


def test_a_changed_file_is_checked(package: Package) -> None:
    one = package.nodelet()
    package.write(f"src/{package.name}_apart.py", "print 'of another time'")
    package.code.of(one, anew=True)
    package.code.check(one)
    package.write(f"src/{package.name}_helper.py", "VALUE = = 2")
    package.clock.time += 0.5
    for _ in range(2):
        with pytest.raises(HostError, match="_helper.py cannot be run: line 1: invalid syntax"):
            package.code.check(one)
    package.write(f"src/{package.name}_helper.py", "VALUE = 2")
    package.clock.time += 0.5
    package.code.check(one)


# Programs of packages are found as rosrun and roslaunch find them


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    """A devel space with the package `lonely`; writes programs into it, or below its source."""
    source, devel = tmp_path / "src", tmp_path / "devel"
    (source / "lonely").mkdir(parents=True)
    (source / "lonely" / "package.xml").write_text(MANIFEST.format(name="lonely"))
    devel.mkdir()
    (devel / ".catkin").write_text(str(source))
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(devel))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(source))
    _packages.cache_clear()
    yield lambda name: write(tmp_path / name, "#!/usr/bin/env python3\n")
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
