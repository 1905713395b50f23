# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""SIGINT ends each program from its first line on."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
#: Their main functions leave Ctrl-C to KeyboardInterrupt.
WITH_KEYBOARD_INTERRUPT = {"demo", "benchmark", "benchmark_node"}
SCRIPTS = sorted({path.name for path in (ROOT / "scripts").iterdir()} - WITH_KEYBOARD_INTERRUPT)
MODULES = [
    "dyknow.cli",
    "dyknow.cli.manager",
    "dyknow.cli.nodelet",
    "dyknow.cli.rewirable",
    "dyknow.ros.nodelets.script_process",
]
#: Runs a program up to its first import of a module of ours that does more than a package's
#: `__init__`, and ends with 0 if SIGINT would then end it.
RUN = """
import os, runpy, signal, sys

runs, is_module, early = sys.argv[1], sys.argv[2] == "module", sys.argv[3:]

class Look:
    def find_spec(self, name, path, target=None):
        if name.startswith("dyknow") and name not in early:
            os._exit(signal.getsignal(signal.SIGINT) is not signal.SIG_DFL)

sys.meta_path.insert(0, Look())
(runpy.run_module if is_module else runpy.run_path)(runs, run_name="__main__")
os._exit(2)
"""


def packages_of(module):
    words = module.split(".")
    return [".".join(words[:count]) for count in range(1, len(words) + 1)]


@pytest.mark.parametrize("program", [*SCRIPTS, *MODULES])
def test_sigint_ends_it_before_it_imports_modules(program):
    is_module = program in MODULES
    early = ["dyknow", "dyknow.interruptible", "dyknow.cli.__main__"]
    early += packages_of(program) if is_module else ["dyknow.cli", "dyknow_rqt"]
    runs = [program, "module"] if is_module else [str(ROOT / "scripts" / program), "path"]
    assert subprocess.run([sys.executable, "-c", RUN, *runs, *early]).returncode == 0


def test_every_program_of_ours_is_one_of_these():
    found = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in (ROOT / "dyknow").rglob("*.py")
        if '\nif __name__ == "__main__":' in path.read_text()
    }
    # The owner of a process ignores SIGINT: it ends with that process.
    assert found == {*MODULES} - {"dyknow.cli"} | {"dyknow.ros.nodelets.owner"}


def test_a_process_that_ignores_sigint_goes_on_ignoring_it():
    show = "import signal, dyknow.interruptible; print(int(signal.getsignal(signal.SIGINT)))"
    command = [sys.executable, "-c", show]
    done = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    assert done.stdout == b"1\n"
