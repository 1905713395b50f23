# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Demonstration, benchmark and window are parts that a robot can do without."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from unit.packaging.workspaces import ROOT, Workspace

PARTS = ("DYKNOW_DEMONSTRATION", "DYKNOW_BENCHMARK", "DYKNOW_RQT", "DYKNOW_ROSCPP")
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
from dyknow.nodelet.plugins import Plugins
from dyknow.ros.hosting.installed import cpp_classes
from dyknow.nodelet.plugins import plugin_files
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


@pytest.mark.long
def test_an_install_space_with_the_parts_and_without(tmp_path):
    workspace = Workspace(tmp_path)
    workspace.add_dyknow()
    install = tmp_path / "install"
    workspace.make("install")
    assert {"benchmark", "benchmark_chain", "cpp_nodelet_manager", "demo", "dyknow_rqt"} < names(
        install / "lib/dyknow"
    )
    assert "libdyknow_roscpp.so" in names(install / "lib")
    assert {"dyknow_benchmark", "dyknow_demo", "dyknow_rqt"} < names(
        install / "lib/python3/dist-packages"
    )

    shutil.rmtree(install)
    workspace.make("install", *(f"-D{part}=OFF" for part in PARTS))
    assert names(install / "lib/python3/dist-packages", "dyknow*") == {"dyknow", "dyknow_msgs"}
    assert names(install / "lib/dyknow") == {
        "dyknow",
        "manager",
        "nodelet",
        "nodelet_manager",
        "rewirable",
    }
    assert names(install / "lib", "*.so") == set()
    assert list((install / "share/dyknow").rglob("soccer.[lx]*")) == []
    classes = "BlackBox Formula Relay Script Sink Source Throttle".split()
    types = " ".join(f"dyknow/{each}" for each in classes)
    assert workspace.run_in("install", f"/usr/bin/python3 -c '{LOOK_UP}'") == f"{types}\n\n"


def names(folder: Path, pattern: str = "*") -> set[str]:
    return {each.name for each in folder.glob(pattern) if each.suffix != ".egg-info"}
