# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Installed scripts run with the Python that they were built for, whichever comes first."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

DEVEL = Path(os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep)[0])
INSTALL = DEVEL.parent / "build" / "dyknow" / "cmake_install.cmake"


@pytest.mark.skipif(not INSTALL.exists(), reason="not in a workspace that catkin_make has built")
def test_scripts_run_where_a_foreign_python_comes_first(tmp_path: Path) -> None:
    installed, foreign = tmp_path / "install", tmp_path / "foreign"
    subprocess.run(
        ["cmake", f"-DCMAKE_INSTALL_PREFIX={installed}", "-P", str(INSTALL)],
        check=True,
        capture_output=True,
        timeout=300,
        env={key: value for key, value in os.environ.items() if key != "DESTDIR"},
    )
    foreign.mkdir()
    (foreign / "python3").write_text("#!/bin/sh\nexit 99\n")
    (foreign / "python3").chmod(0o755)
    path = os.pathsep.join([str(foreign), os.environ["PATH"]])
    for script in (DEVEL / "bin" / "dyknow", installed / "bin" / "dyknow"):
        done = subprocess.run(
            [str(script), "--version"],
            capture_output=True,
            text=True,
            timeout=60,
            env={**os.environ, "PATH": path},
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
    scripts = [each for each in (installed / "lib" / "dyknow").iterdir() if is_script(each)]
    assert len(scripts) == 8
    for script in scripts:
        assert b"env" not in script.read_bytes().split(b"\n")[0], script


def is_script(file: Path) -> bool:
    return file.read_bytes().startswith(b"#!")
