# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Catkin workspaces with tiny packages that depend on DyKnow, built and tried as users do."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Sequence

ROOT = Path(__file__).resolve().parents[3]

_PACKAGE = """<package format="2">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>Uses the messages of DyKnow.</description>
  <maintainer email="test@example.org">The test</maintainer>
  <license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend>
  <build_depend>message_generation</build_depend>
  {depends}
</package>
"""
_CMAKE = """cmake_minimum_required(VERSION 3.10)
project({name})
find_package(catkin REQUIRED COMPONENTS {components} message_generation)
add_message_files(FILES Wiring.msg)
generate_messages(DEPENDENCIES dyknow_msgs)
catkin_package()
include_directories(${{catkin_INCLUDE_DIRS}})
add_executable({name} main.cpp)
add_dependencies({name} ${{catkin_EXPORTED_TARGETS}} ${{PROJECT_NAME}}_generate_messages_cpp)
target_link_libraries({name} ${{catkin_LIBRARIES}})
install(TARGETS {name} RUNTIME DESTINATION ${{CATKIN_PACKAGE_BIN_DESTINATION}})
"""
_MAIN = """#include <dyknow_msgs/GetModel.h>
#include <{name}/Wiring.h>
#include <iostream>
int main()
{{
  dyknow_msgs::GetModel service;
  {name}::Wiring wiring;
  wiring.config.resize(service.response.model.nodelets.size() + 2);
  std::cout << wiring.config.size() << std::endl;
}}
"""
_PYTHON = """
from dyknow_msgs.srv import GetModelResponse
from {name}.msg import Wiring
print(len(Wiring(config=GetModelResponse().model.nodelets).config) + 2)
"""


class Workspace:
    """A folder with ``src``, on top of the distribution and the spaces ``upon`` alone."""

    def __init__(self, folder: Path, upon: Sequence[Path] = ()) -> None:
        self.folder = folder
        self._upon = tuple(str(path) for path in upon)
        (folder / "src").mkdir(parents=True)

    def add_dyknow(self) -> None:
        """The checkout, entry by entry, so that its own build is not found in it."""
        package = self.folder / "src" / "dyknow"
        package.mkdir()
        for entry in ROOT.iterdir():
            if entry.name != "build" and not entry.name.startswith("."):
                (package / entry.name).symlink_to(entry)

    def add_user(self, name: str, *depends: str) -> None:
        """A package with a message, a program in C++ and one in Python that use dyknow_msgs."""
        package = self.folder / "src" / name
        (package / "msg").mkdir(parents=True)
        (package / "msg" / "Wiring.msg").write_text("dyknow_msgs/PortConfig[] config\n")
        tags = "\n  ".join(f"<depend>{each}</depend>" for each in depends)
        (package / "package.xml").write_text(_PACKAGE.format(name=name, depends=tags))
        text = _CMAKE.format(name=name, components=" ".join(depends))
        (package / "CMakeLists.txt").write_text(text)
        (package / "main.cpp").write_text(_MAIN.format(name=name))

    def add_copy(self, name: str, package: Path) -> None:
        """A package of the checkout under a name of its own, as a user begins with it."""
        shutil.copytree(package, self.folder / "src" / name)

    def make(self, *arguments: str, is_complete: bool = True) -> None:
        """Run catkin_make with targets or options; targets that do not build may be left out."""
        options = ["-DPYTHON_EXECUTABLE=/usr/bin/python3", "-DCMAKE_BUILD_TYPE=Debug"]
        command = ["catkin_make", "-C", str(self.folder), *arguments, *options]
        self._run(command if is_complete else [*command, "-k"], is_complete)

    def check_user(self, name: str, space: str) -> None:
        """Both programs of a package run in a space of the workspace, ``devel`` or ``install``."""
        for command in (
            f"rosrun {name} {name}",
            f"/usr/bin/python3 -c '{_PYTHON.format(name=name)}'",
        ):
            assert self.run_in(space, command) == "2\n"

    def make_and_check(self, *names: str) -> None:
        """Build and install all, and check these packages in both spaces."""
        self.make("install")
        for name in names:
            self.check_user(name, "devel")
            self.check_user(name, "install")

    def run_in(self, space: str, command: str) -> str:
        """The output of a shell command in a space of the workspace; it must end with 0."""
        return self._run(["/bin/sh", "-c", f". {self.folder / space}/setup.sh; {command}"])

    def _run(self, command: Sequence[str], must_succeed: bool = True) -> str:
        done = subprocess.run(
            command,
            cwd=self.folder,
            env=self.environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        assert done.returncode == 0 or not must_succeed, done.stdout
        return done.stdout

    def environment(self) -> dict[str, str]:
        """This process's, without the workspaces that it runs in unless we are ``upon`` them."""
        environment = dict(os.environ, PATH="/usr/bin:" + os.environ["PATH"])
        for name in ("CMAKE_PREFIX_PATH", "PYTHONPATH", "ROS_PACKAGE_PATH", "LD_LIBRARY_PATH"):
            paths = environment.get(name, "").split(os.pathsep)
            kept = [path for path in paths if not path.startswith(str(ROOT))]
            environment[name] = os.pathsep.join(filter(None, kept))
        prefixes = [*self._upon, *environment["CMAKE_PREFIX_PATH"].split(os.pathsep)]
        environment["CMAKE_PREFIX_PATH"] = os.pathsep.join(filter(None, prefixes))
        return environment
