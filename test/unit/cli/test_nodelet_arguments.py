# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of `nodelet`, without ROS."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dyknow.cli.nodelet import main
from dyknow.cli.nodelet_arguments import (
    Help,
    LoadNodelet,
    RunManager,
    RunScript,
    RunStandalone,
    UnloadNodelet,
    UsageError,
    default_node_name,
    parse,
)


@pytest.mark.parametrize(
    ("line", "command"),
    [
        ("manager", RunManager(())),
        ("manager __name:=m _num_worker_threads:=4", RunManager(())),
        ("load p/C m", LoadNodelet("p/C", "m", True, (), "p_C")),
        ("load p/C m --no-bond", LoadNodelet("p/C", "m", False, (), "p_C")),
        ("load p/C m --no-bond a b", LoadNodelet("p/C", "m", False, ("a", "b"), "p_C")),
        ("load p/C m a --no-bond", LoadNodelet("p/C", "m", True, ("a", "--no-bond"), "p_C")),
        ("load p/C m --help", LoadNodelet("p/C", "m", True, ("--help",), "p_C")),
        (
            "load p/C m in:=/image a _rate:=5 __log:=x.log",
            LoadNodelet("p/C", "m", True, ("a",), "p_C"),
        ),
        ("__name:=n load p/C m", LoadNodelet("p/C", "m", True, (), "p_C")),
        ("load_script p s.py m", LoadNodelet("dyknow/Script", "m", True, ("p/s.py",), "s")),
        (
            "load_script p scripts/a-b.py m --no-bond x",
            LoadNodelet("dyknow/Script", "m", False, ("p/scripts/a-b.py", "x"), "a_b"),
        ),
        ("standalone_script p s.py a _rate:=5", RunScript("p", "s.py", ("a",))),
        ("standalone p/C", RunStandalone("p/C", ())),
        ("standalone p/C a b", RunStandalone("p/C", ("a", "b"))),
        ("unload /n m", UnloadNodelet("/n", "m")),
        ("unload /n m ignored", UnloadNodelet("/n", "m")),
        ("--help", Help()),
        ("-h", Help()),
        ("load --help", Help()),
    ],
)
def test_command_lines(line, command):
    assert parse(line.split()) == command


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("", "a command is missing"),
        ("__name:=m", "a command is missing"),
        ("lod p/C m", "there is no command 'lod'"),
        ("load", "load: PKG/CLASS and MANAGER missing"),
        ("load p/C", "load: MANAGER missing"),
        ("load p/C in:=/image", "load: MANAGER missing"),
        ("load_script p s.py", "load_script: MANAGER missing"),
        ("standalone_script p", "standalone_script: SCRIPT missing"),
        ("standalone", "standalone: PKG/CLASS missing"),
        ("unload /n", "unload: MANAGER missing"),
    ],
)
def test_what_is_missing_is_said(line, missing):
    with pytest.raises(UsageError) as raised:
        parse(line.split())
    assert str(raised.value) == missing


def test_default_node_name():
    assert default_node_name("image_proc/resize") == "image_proc_resize"


def test_wrong_usage_shows_the_line_and_the_usage(capsys):
    assert main(["nodelet", "load", "p/C"]) == 255
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "load: MANAGER missing" in shown.err
    assert "nodelet load p/C\n" in shown.err
    assert "unload NAME MANAGER" in shown.err


def test_help_is_no_error(capsys):
    assert main(["nodelet", "--help"]) == 0
    shown = capsys.readouterr()
    assert shown.out.startswith("usage: nodelet manager")
    assert shown.err == ""


def test_help_does_not_wait_for_rospy():
    program = (
        "import sys, dyknow.cli.nodelet\n"
        "dyknow.cli.nodelet.main(['nodelet', '--help'])\n"
        "print('rospy' in sys.modules)"
    )
    seen = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    assert seen.stdout.splitlines()[-1] == "False"
