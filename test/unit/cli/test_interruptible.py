# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""SIGINT ends each program from its first line on."""

from __future__ import annotations

import io
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from clocks import PATIENCE

from dyknow.cli import main as command_line
from dyknow.cli.shell import INTERRUPTED
from dyknow.ros.process.signals import ENDING, raise_interrupt, sigint

pytestmark = pytest.mark.usefixtures("heeded_signals")

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = sorted(path.name for path in (ROOT / "scripts").iterdir())
PACKAGES = ["dyknow", "dyknow_demo", "dyknow_benchmark"]
MODULES = [
    "dyknow_benchmark",
    "dyknow_demo",
    "dyknow.cli",
    "dyknow.cli.manager",
    "dyknow.cli.nodelet",
    "dyknow.cli.rewirable",
    "dyknow.ros.nodelets.script_process",
]
#: Runs a module up to its first import of a module of ours that does more than a package's
#: `__init__`, and ends with 0 if SIGINT would then end it.
RUN = """
import os, runpy, signal, sys

class Look:
    def find_spec(self, name, path, target=None):
        if name.startswith("dyknow") and name not in sys.argv[2:]:
            os._exit(signal.getsignal(signal.SIGINT) is not signal.SIG_DFL)

sys.meta_path.insert(0, Look())
runpy.run_module(sys.argv[1], run_name="__main__")
os._exit(2)
"""
#: Arguments with which a script does something.
ARGUMENTS = {
    "benchmark_node": ["source"],
    "dyknow": ["list"],
    "nodelet": ["unload", "a", "b"],
    "rewirable": ["true"],
}
#: Runs a script up to its first effect: a connection, or a process.
LOAD = """
import os, runpy, signal, sys

def look(event, args):
    if event == "import" and args[0].startswith(("dyknow", "rospy")) and args[0] not in FIRST:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            os.write(2, f"{args[0]} is loaded\\n".encode())
            os._exit(1)
    if event in ("socket.connect", "subprocess.Popen", "os.exec"):
        os._exit(0)

FIRST = ("dyknow", "dyknow.interruptible")
sys.addaudithook(look)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
os._exit(2)
"""


@pytest.mark.parametrize("module", MODULES)
def test_sigint_ends_a_module_before_it_imports_others(module):
    packages = itertools.accumulate(module.split("."), "{}.{}".format)
    early = ["dyknow", "dyknow.interruptible", f"{module}.__main__", *packages]
    assert subprocess.run([sys.executable, "-c", RUN, module, *early]).returncode == 0


@pytest.mark.parametrize("script", SCRIPTS)
def test_no_module_is_loaded_while_sigint_raises(script, tmp_path):
    """From the first line of each script to its first effect."""
    folder = str(tmp_path)
    environment = {**os.environ, "ROS_MASTER_URI": "http://localhost:9", "TMPDIR": folder}
    words = [str(ROOT / "scripts" / script), *ARGUMENTS.get(script, ())]
    command = [sys.executable, "-c", LOAD, *words]
    done = subprocess.run(command, cwd=folder, env=environment, stderr=subprocess.PIPE)
    assert done.returncode == 0, done.stderr


def test_sigint_does_what_it_did_when_a_program_is_done():
    with sigint(signal.SIG_DFL):
        with pytest.raises(KeyboardInterrupt), sigint(raise_interrupt, signal.SIGUSR1):
            signal.raise_signal(signal.SIGUSR1)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    with sigint(signal.SIG_IGN), sigint(raise_interrupt):
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


class Answer(io.RawIOBase):
    """Interrupted when its finalizer, which is one in C, closes it; as `http.client`'s may be."""

    def close(self):
        super().close()
        signal.raise_signal(signal.SIGINT)


def test_an_interrupt_that_a_finalizer_drops_comes_again():
    with pytest.raises(KeyboardInterrupt), sigint(raise_interrupt):
        Answer()
        time.sleep(PATIENCE)


@pytest.mark.parametrize(("number", "second"), itertools.product(ENDING, ENDING))
def test_a_signal_lets_a_command_clean_up(number, second, monkeypatch):
    """Also if it comes twice, as SIGHUP does from a terminal that is closed, or another does."""
    done = []

    def run(arguments):
        try:
            signal.raise_signal(number)
        finally:
            signal.raise_signal(second)
            done.append(arguments.command)

    monkeypatch.setattr(command_line, "_run", run)
    with sigint(signal.SIG_DFL, *ENDING):
        assert command_line.main(["list"]) == INTERRUPTED
        assert signal.getsignal(number) is signal.SIG_DFL
    assert done == ["list"]


def test_of_signals_that_come_at_once_one_interrupts_without_a_warning(monkeypatch, capfd):
    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)  # which writes
    with pytest.raises(KeyboardInterrupt), sigint(raise_interrupt, *ENDING):
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        try:
            for each in ENDING:
                signal.raise_signal(each)
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("number", [signal.SIGINT, *ENDING])
def test_a_signal_lets_an_import_end(number, tmp_path, monkeypatch):
    """Of any module, at any depth: an exception raised in an import may be dropped in there."""
    (tmp_path / "outer.py").write_text("import inner\nis_done = True\n")
    (tmp_path / "inner.py").write_text(f"import signal\nsignal.raise_signal({int(number)})\n")
    monkeypatch.syspath_prepend(tmp_path)
    imported = []

    def run(arguments):
        import outer

        imported.append(outer.is_done)
        threading.Event().wait(PATIENCE)

    monkeypatch.setattr(command_line, "_run", run)
    with sigint(signal.SIG_DFL, *ENDING):
        assert command_line.main(["list"]) == INTERRUPTED
    assert imported == [True]
    for name in ("outer", "inner"):
        del sys.modules[name]


def test_a_command_under_nohup_goes_on(monkeypatch):
    monkeypatch.setattr(command_line, "_run", lambda arguments: signal.raise_signal(signal.SIGHUP))
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert not command_line.main(["list"])
    finally:
        signal.signal(signal.SIGHUP, before)


def test_every_program_of_ours_is_one_of_these():
    found = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in (ROOT / "dyknow").rglob("*.py")
        if '\nif __name__ == "__main__":' in path.read_text()
    }
    # The owner of a process ignores SIGINT: it ends with that process.
    assert found == {*MODULES} - {"dyknow.cli", *PACKAGES} | {"dyknow.ros.nodelets.owner"}


def test_a_process_that_ignores_sigint_goes_on_ignoring_it():
    show = "import signal, dyknow.interruptible; print(int(signal.getsignal(signal.SIGINT)))"
    command = [sys.executable, "-c", show]
    done = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    assert done.stdout == b"1\n"
