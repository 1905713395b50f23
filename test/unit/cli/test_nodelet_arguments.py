# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of `nodelet`, without ROS."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dyknow.cli.nodelet import NodeletCommand, UsageError, main, parse


@pytest.mark.parametrize(
    ("line", "command"),
    [
        ("manager", NodeletCommand("manager")),
        ("manager __name:=m _num_worker_threads:=4", NodeletCommand("manager")),
        ("load p/C m", NodeletCommand("load", "p/C", "p_C", "m", True, ())),
        ("load p/C m --no-bond", NodeletCommand("load", "p/C", "p_C", "m", False, ())),
        ("load p/C m --no-bond a b", NodeletCommand("load", "p/C", "p_C", "m", False, ("a", "b"))),
        (
            "load p/C m a --no-bond",
            NodeletCommand("load", "p/C", "p_C", "m", True, ("a", "--no-bond")),
        ),
        ("load p/C m --help", NodeletCommand("load", "p/C", "p_C", "m", True, ("--help",))),
        (
            "load p/C m in:=/image a _rate:=5 __log:=x.log",
            NodeletCommand("load", "p/C", "p_C", "m", True, ("a",)),
        ),
        ("__name:=n load p/C m", NodeletCommand("load", "p/C", "p_C", "m", True, ())),
        (
            "load image_proc/resize m",
            NodeletCommand("load", "image_proc/resize", "image_proc_resize", "m", True, ()),
        ),
        (
            "load_script p s.py m",
            NodeletCommand("load", "dyknow/Script", "s", "m", True, ("p/s.py",)),
        ),
        (
            "load_script p scripts/a-b.py m --no-bond x",
            NodeletCommand("load", "dyknow/Script", "a_b", "m", False, ("p/scripts/a-b.py", "x")),
        ),
        (
            "standalone_script p s.py a _rate:=5",
            NodeletCommand("standalone_script", "p/s.py", my_argv=("a",)),
        ),
        ("standalone p/C", NodeletCommand("standalone", "p/C", my_argv=())),
        ("standalone p/C a b", NodeletCommand("standalone", "p/C", my_argv=("a", "b"))),
        ("unload /n m", NodeletCommand("unload", name="/n", manager="m")),
        ("unload /n m ignored", NodeletCommand("unload", name="/n", manager="m")),
        ("--help", NodeletCommand("help")),
        ("-h", NodeletCommand("help")),
        ("load --help", NodeletCommand("help")),
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
