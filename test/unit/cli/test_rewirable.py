# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`rewirable` becomes the program that it is given, with or without the library."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys

import pytest

from dyknow.cli.main import parse
from dyknow.cli.rewirable import LIBRARY, CannotRun, become, find_library

SHOW = "import os, sys; print(os.environ.get('LD_PRELOAD'), sys.argv[1:]); sys.exit(7)"


def run(*words, library=True, preloaded="", tmp_path):
    """Run `rewirable` with an empty file for the library, which the linker complains of."""
    (tmp_path / "lib").mkdir(exist_ok=True)
    if library and not (tmp_path / "lib" / LIBRARY).exists():
        (tmp_path / "lib" / LIBRARY).touch()
    environment = {**os.environ, "CMAKE_PREFIX_PATH": str(tmp_path), "LD_PRELOAD": preloaded}
    command = [sys.executable, "-m", "dyknow.cli.rewirable", *words]
    done = subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    return f"{done.returncode} {done.stdout}"


def test_a_program_gets_the_library_before_others(tmp_path):
    library = tmp_path / "lib" / LIBRARY
    answer = run(sys.executable, "-c", SHOW, "a", "_b:=c", tmp_path=tmp_path)
    assert answer.startswith("7 ")
    assert f"{library} ['a', '_b:=c']\n" in answer
    other = tmp_path / "other.so"
    answer = run(sys.executable, "-c", SHOW, preloaded=str(other), tmp_path=tmp_path)
    assert f"{library}:{other} []\n" in answer


def test_a_program_ignores_no_signal_that_python_ignores(tmp_path):
    answer = run("sh", "-c", "grep SigIgn /proc/self/status", tmp_path=tmp_path)
    ignored = int(answer.split()[-1], 16)
    assert not ignored & (1 << signal.SIGPIPE - 1 | 1 << signal.SIGXFSZ - 1)


def test_a_folder_with_a_space(tmp_path):
    library = find_library()
    if library is None:
        pytest.skip("DyKnow was built without roscpp")
    folder = tmp_path / "a b\tc"
    (folder / "lib").mkdir(parents=True)
    (folder / "lib" / LIBRARY).symlink_to(library)
    maps = ["grep", "-c", LIBRARY, "/proc/self/maps"]
    answer = run("sh", "-c", 'exec "$@"', "sh", *maps, tmp_path=folder)
    assert re.fullmatch(r"0 [1-9]\d*\n", answer)


def test_without_the_library_a_program_runs_as_it_is(tmp_path):
    answer = run(sys.executable, "-c", SHOW, library=False, tmp_path=tmp_path)
    assert "runs as it is: libdyknow_roscpp.so is not there" in answer
    assert answer.endswith("\n []\n")


def test_words_that_name_no_program(tmp_path):
    with pytest.raises(CannotRun, match="'/no/such' is no program that can be run"):
        become(["/no/such"])
    answer = run("/no/such", tmp_path=tmp_path)
    assert answer == "127 rewirable: '/no/such' is no program that can be run\n"
    assert run(tmp_path=tmp_path).startswith("2 usage: rosrun dyknow rewirable COMMAND")
    assert 'launch-prefix="rosrun dyknow rewirable"' in run("--help", tmp_path=tmp_path)


def test_run_hands_all_arguments_to_the_node():
    arguments = parse(["run", "topic_tools", "relay", "/a", "--json", "_x:=1", "__name:=b"])
    assert (arguments.package, arguments.executable) == ("topic_tools", "relay")
    assert arguments.words == ["/a", "--json", "_x:=1", "__name:=b"]
