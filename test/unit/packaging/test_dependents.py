# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Packages that depend on DyKnow find its messages: C++, Python, and messages of their own.

So does the package to begin with, whose tests pass. Demonstration, benchmark and window are parts
that a robot can do without.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from unit.packaging.workspaces import ROOT, Workspace

PARTS = ("DYKNOW_DEMONSTRATION", "DYKNOW_BENCHMARK", "DYKNOW_RQT", "DYKNOW_ROSCPP")
#: The programs that are there without them.
PROGRAMS = {"dyknow", "manager", "nodelet", "nodelet_manager", "rewirable"}
#: Never imported by the runtime: the parts, and libraries for images, plots and windows.
LUGGAGE = (
    *("dyknow_benchmark", "dyknow_demo", "dyknow_rqt"),
    *("PIL", "PyQt5", "PySide2", "cv2", "matplotlib", "message_filters", "numpy", "tqdm"),
    *("python_qt_binding", "qt_gui", "rqt_gui", "rqt_gui_py"),
)
IMPORT_ALL = f"""
import importlib, pkgutil, sys
sys.modules.update(dict.fromkeys({LUGGAGE!r}))  # to import one of these is an ImportError
import dyknow
names = [each.name for each in pkgutil.walk_packages(dyknow.__path__, "dyknow.")]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
print(len(names))
"""
LOOK_UP = """
from dyknow.errors import UnknownNodeletType
from dyknow.nodelet.loading.plugins import Plugins, plugin_files
from dyknow.ros.hosting.installed import cpp_classes
try:
    Plugins(plugin_files).find("none/Such")
except UnknownNodeletType as error:
    print(*error.known)
    print(*error.broken, *(each for each in cpp_classes() if each.startswith("dyknow")))
"""


def test_the_runtime_imports_without_its_luggage():
    command = [sys.executable, "-c", IMPORT_ALL]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


def test_a_package_that_depends_on_dyknow_alone_and_the_skeleton(tmp_path):
    """In a workspace of their own, on top of the one that DyKnow was built in."""
    workspace = Workspace(tmp_path / "ws", upon=[ROOT / "build/ws/devel"])
    workspace.add_copy("my_nodelets", ROOT / "examples/skeleton")
    workspace.add_user("user", "dyknow")
    workspace.make("run_tests", "install")
    summary = workspace.run_in("devel", f"catkin_test_results {workspace.folder}/build")
    assert "2 tests, 0 errors, 0 failures" in summary
    for space in ("devel", "install"):
        workspace.check_user("user", space)
        workspace.run_in(space, "dyknow check $(rospack find my_nodelets)/transformations/*.xml")
        declared = workspace.run_in(space, "rospack plugins --attrib=plugin dyknow")
        assert "my_nodelets" in declared


@pytest.mark.long
def test_in_one_workspace_and_from_an_install_space(tmp_path):
    one = Workspace(tmp_path / "one")
    one.add_dyknow()
    one.add_user("a_user", "dyknow")  # by name before it, so the order is that of dependencies
    one.add_user("z_user", "dyknow", "dyknow_msgs")
    one.make_and_check("a_user", "z_user")
    lib = one.folder / "install/lib"
    parts = {"benchmark", "benchmark_chain", "cpp_nodelet_manager", "demo", "dyknow_rqt"}
    assert parts < names(lib / "dyknow")
    assert "libdyknow_roscpp.so" in names(lib)
    packages = {"dyknow_benchmark", "dyknow_demo", "dyknow_rqt"}
    assert packages < names(lib / "python3/dist-packages")

    upon = Workspace(tmp_path / "upon", upon=[tmp_path / "one" / "install"])
    upon.add_user("by_dyknow", "dyknow")
    upon.add_user("by_messages", "dyknow_msgs")
    upon.add_copy("dyknow_cpp_example", ROOT / "examples" / "dyknow_cpp_example")
    upon.make()
    for name in ("by_dyknow", "by_messages"):
        upon.check_user(name, "devel")
    plugins = upon.run_in("devel", "rospack plugins --attrib=plugin nodelet")
    assert "dyknow_cpp_example" in plugins
    load = "import ctypes; ctypes.CDLL('devel/lib/libdyknow_cpp_example.so')"
    upon.run_in("devel", f'/usr/bin/python3 -c "{load}"')


@pytest.mark.long
def test_a_package_that_names_the_messages_alone(tmp_path):
    """The nested package has to be linked beside dyknow, or no crawl finds it."""
    workspace = Workspace(tmp_path / "ws")
    workspace.add_dyknow()
    (workspace.folder / "src/dyknow_msgs").symlink_to("dyknow/dyknow_msgs")
    workspace.add_user("a_user", "dyknow_msgs")
    workspace.add_user("z_user", "dyknow")
    workspace.make_and_check("a_user", "z_user")


@pytest.mark.long
def test_an_install_space_without_the_parts(tmp_path):
    workspace = Workspace(tmp_path)
    workspace.add_dyknow()
    workspace.make("install", *(f"-D{part}=OFF" for part in PARTS))
    install = tmp_path / "install"
    assert names(install / "lib/python3/dist-packages", "dyknow*") == {"dyknow", "dyknow_msgs"}
    assert names(install / "lib/dyknow") == PROGRAMS
    assert names(install / "lib", "*.so") == set()
    assert list((install / "share/dyknow").rglob("soccer.[lx]*")) == []
    classes = "BlackBox Formula Relay Script Sink Source Throttle".split()
    types = " ".join(f"dyknow/{each}" for each in classes)
    assert workspace.run_in("install", f"/usr/bin/python3 -c '{LOOK_UP}'") == f"{types}\n\n"


def names(folder: Path, pattern: str = "*") -> set[str]:
    return {each.name for each in folder.glob(pattern) if each.suffix != ".egg-info"}
