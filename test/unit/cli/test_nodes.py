# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command lines of our nodes, and their help."""

from __future__ import annotations

import re

import pytest
import rospy
import yaml

from dyknow.cli import manager, nodelet
from dyknow.cli.node_help import MANAGER, NODELET_MANAGER
from dyknow.cli.nodelet import NodeletCommand, UsageError, main, parse
from dyknow.errors import BadParameter
from dyknow.ros.manager import manager_settings
from dyknow.ros.manager.manager_settings import ManagerSettings
from dyknow.ros.nodelets.nodelet_manager import Settings


def load(kind, name, *my_argv, bond=True):
    return NodeletCommand("load", kind, name, "m", bond, my_argv)


def standalone(kind, *my_argv, action="standalone"):
    return NodeletCommand(action, kind, my_argv=my_argv)


@pytest.mark.parametrize(
    ("line", "command"),
    [
        ("manager", NodeletCommand("manager")),
        ("manager __name:=m _num_worker_threads:=4", NodeletCommand("manager")),
        ("load p/C m --no-bond", load("p/C", "p_C", bond=False)),
        ("load p/C m --no-bond a b", load("p/C", "p_C", "a", "b", bond=False)),
        ("load p/C m a --no-bond", load("p/C", "p_C", "a", "--no-bond")),
        ("load p/C m --help", load("p/C", "p_C", "--help")),
        ("load p/C m in:=/image a _rate:=5 __log:=x.log", load("p/C", "p_C", "a")),
        ("__name:=n load p/C m", load("p/C", "p_C")),
        ("load image_proc/resize m", load("image_proc/resize", "image_proc_resize")),
        ("load_script p s.py m", load("dyknow/Script", "s", "p/s.py")),
        (
            "load_script p scripts/a-b.py m --no-bond x",
            load("dyknow/Script", "a_b", "p/scripts/a-b.py", "x", bond=False),
        ),
        (
            "standalone_script p s.py a _rate:=5",
            standalone("p/s.py", "a", action="standalone_script"),
        ),
        ("standalone p/C", standalone("p/C")),
        ("standalone p/C a b", standalone("p/C", "a", "b")),
        ("unload /n m", NodeletCommand("unload", name="/n", manager="m")),
        ("unload /n m ignored", NodeletCommand("unload", name="/n", manager="m")),
        *((line, NodeletCommand("help")) for line in ("--help", "-h", "load --help")),
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
    assert main(["nodelet", "--help"]) == 0
    shown = capsys.readouterr()
    assert shown.out.startswith("usage: nodelet manager") and shown.err == ""


def parameters(text):
    """Parameters that are described, with their defaults."""
    described = text[text.index("Private parameters") : text.index("Services:")]
    blocks = re.split(r"\n  (?=~)", described)[1:]
    names = [re.findall(r"~([a-z_/]+)", block.split("  ")[0]) for block in blocks]
    return {
        name: re.findall(r"\(([^)]*)\)\s*$", block.strip())
        for block, several in zip(blocks, names)
        for name in several
    }


@pytest.mark.parametrize("main", [manager.main, nodelet.manager_main])
@pytest.mark.parametrize("word", ["-h", "--help"])
def test_help_is_no_mistake(main, word, capsys):
    assert main(["program", word, "__name:=x"]) == 0
    told = capsys.readouterr()
    assert "Private parameters" in told.out
    assert told.err == ""


def test_other_words_are_refused(capsys):
    assert manager.main(["manager", "--read-only", "__name:=x"]) == 255
    assert "'--read-only' would have no effect" in capsys.readouterr().err


def test_the_manager_describes_all_its_parameters():
    described = parameters(MANAGER)
    plain = {name.split("/")[0] for name in described} | {"limits"}
    assert plain == set(manager_settings.PARAMETERS)
    for name in ("num_nodelet_managers", "spawn_timeout", "orphan_timeout"):
        assert float(described[name][0]) == getattr(ManagerSettings, name)
    assert described["language"] == [ManagerSettings.language]


def test_the_nodelet_manager_describes_all_its_parameters():
    described = parameters(NODELET_MANAGER)
    assert {name: yaml.safe_load(default[0]) for name, default in described.items()} == {
        name: getattr(Settings, name) for name in Settings.__dataclass_fields__
    }


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [("num_worker_threads", each, "an integer from 0") for each in (-1, "many", 1.5, True)]
    + [("stuck_after", each, "seconds above 0") for each in (0, -1.0, "soon", True)]
    + [("shared_memory", each, "true or false") for each in (1, "no")],
)
def test_the_nodelet_manager_refuses_a_parameter_without_sense(monkeypatch, name, value, expected):
    monkeypatch.setattr(rospy, "get_param", {"~": {name: value}}.get)
    with pytest.raises(BadParameter, match=f"~{name}' is .*: expected {expected}"):
        Settings.read()
