# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Completions by TAB, and how they reach bash."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import pytest
from clocks import PATIENCE
from unit.cli.fake_client import FakeClient
from unit.manager.world import TRACKER, World

from dyknow.cli import completion
from dyknow.cli.main import build_parser

ROOT = Path(__file__).resolve().parents[3]
needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="bash is missing")


@pytest.fixture(name="client")
def _client():
    client = FakeClient(World())
    client.world.manager.add_transformation(TRACKER)
    client.host.machine = "rover"
    client.core.look()
    client.world.host.sources["pkg/Text"] = [("in", "in", "std_msgs/String")]
    client.world.spawn("camera", "cam", config={"image": "raw"})
    client.world.spawn("relay", "/robot/relay")
    return client


def offered(client, text):
    """The completions at the end of a command line, sorted; without the space behind a word."""
    line = "dyknow " + text
    reader, writer = os.pipe()
    child = os.fork()
    if not child:  # argcomplete writes to a file descriptor of its own, and ends the process
        os.dup2(writer, 8)
        os.environ.update(_ARGCOMPLETE="1", COMP_LINE=line, COMP_POINT=str(len(line)))
        os.environ["_ARGCOMPLETE_COMP_WORDBREAKS"] = " \t\n\"'><=;|&(:"
        completion.connect = cast(Any, lambda manager: client)
        try:
            completion.autocomplete(build_parser()[0])
        finally:
            os._exit(1)
    os.close(writer)
    with open(reader) as answer:
        found = answer.read().split("\013")
    assert os.waitpid(child, 0)[1] == 0
    return sorted(each[:-1] if each[-1] == " " else each for each in found if each)


@pytest.mark.parametrize(
    ("text", "candidates"),
    [
        ("sp", ["spawn"]),
        ("com", []),
        ("--man", ["--manager-node"]),
        ("--json li", ["library", "list"]),
        ("--timeout ", []),
        ("info ", ["/cam", "/robot/relay"]),
        ("info c", ["cam"]),
        ("info cam ", ["/robot/relay"]),
        ("info --", ["--help", "--json", "--manager-node", "--timeout"]),
        ("info -- /r", ["/robot/relay"]),
        ("list ", ["/robot"]),
        ("list --manager-node ", ["/dyknow_manager"]),
        ("spawn ca", ["camera"]),
        ("spawn joi", []),
        ("library joi", ["joints"]),
        ("library wr", ["wrong\\ ports", "wrong\\ type"]),
        ("library 'wrong p", ["wrong ports"]),
        ("library wrong\\ p", ["wrong\\ ports"]),
        ("spawn relay ", []),
        ("spawn relay r --connect ", ["in:", "out:"]),
        ("spawn relay r --connect in:/r", ["/raw", "/robot/relay:out", "/rosout"]),
        ("spawn relay r --connect in:/raw o", ["out:"]),
        ("spawn tracker r --param ", ["?camera=", "frame="]),
        ("spawn relay r --manager ", ["/fake_0"]),
        ("spawn relay r --host r", ["rover"]),
        ("restart cam ", ["/fake_0", "/robot/relay"]),
        ("set cam ", ["rate"]),
        ("connect ", ["/cam:", "/raw", "/robot/relay:", "/rosout"]),
        ("connect cam:", ["image"]),
        ("connect /cam:im", ["image"]),
        ("connect cam:image ", ["/raw", "/robot/relay:", "/rosout"]),
        ("connect cam:image /ro", ["/robot/relay:", "/rosout"]),
        ("connect /raw ", ["/robot/relay:"]),
        ("connect cam:image robot/relay:", ["in"]),
        pytest.param(
            "connect cam:image robot/relay:in --topic=/ra",
            ["/raw"],
            marks=pytest.mark.skipif(
                int(version("argcomplete").partition(".")[0]) < 2,
                reason="Ubuntu 20.04's argcomplete completes no --OPTION=VALUE",
            ),
        ),
        ("connect a b --topic /ra", ["/raw"]),
        ("disconnect /robot/relay:", ["in", "out"]),
        ("graph --namespace r", ["robot"]),
        ("destroy /cam /", ["/robot/relay"]),
        ("stats --watch 0.5 c", ["cam"]),
        ("run topic_too", ["topic_tools"]),
        ("launch image_pr", ["image_proc"]),
        ("launch image_proc ", ["image_proc.launch"]),
        ("launch image_proc image_proc.launch ", ["manager:=", "respawn:="]),
        ("launch image_proc image_proc.launch respawn:=true m", ["manager:="]),
    ],
)
def test_candidates(client, text, candidates):
    assert offered(client, text) == candidates


def test_the_in_port_has_to_fit_the_out_port(client):
    text = "<transformation><label>text</label><source>pkg/Text</source></transformation>"
    client.world.manager.add_transformation(text)
    client.world.spawn("text", "text")
    assert offered(client, "connect cam:image /r") == ["/raw", "/robot/relay:", "/rosout"]
    assert offered(client, "disconnect ") == ["/cam:", "/robot/relay:", "/text:"]


def test_launch_files_are_those_that_roslaunch_finds(client, tmp_path, monkeypatch):
    """In linked folders, too, and not in hidden ones."""
    package, elsewhere = tmp_path / "space" / "pkg", tmp_path / "elsewhere"
    for folder in (package / "launch", package / ".git", elsewhere):
        folder.mkdir(parents=True)
        (folder / f"{folder.name}.launch").write_text('<launch><arg name="rate"/></launch>')
    head = '<package format="2"><name>pkg</name><version>1.0.0</version>'
    (package / "package.xml").write_text(f"{head}<description/></package>")
    (package / "linked").symlink_to(elsewhere)
    (elsewhere / "sub").mkdir()
    (elsewhere / "sub" / "circle").symlink_to(".")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "space"))
    assert offered(client, "launch pkg ") == ["elsewhere.launch", "launch.launch"]
    assert offered(client, "launch pkg elsewhere.launch ") == ["rate:="]


def test_files(client, tmp_path, monkeypatch):
    (tmp_path / "a file.xml").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "x.xml").touch()
    (tmp_path / ".hidden").touch()
    (tmp_path / os.fsdecode(b"\xff.xml")).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "folder"))
    assert offered(client, "load ~/") == ["~/x.xml"]
    assert offered(client, "import ") == ["a\\ file.xml", "folder/"]
    assert offered(client, "load folder/") == ["folder/x.xml"]
    assert offered(client, "save .h") == [".hidden"]
    assert offered(client, "export -o fol") == ["folder/"]
    assert offered(client, "check nowhere/") == []


def bash(line, path, function="_python_argcomplete dyknow"):
    """The candidates of bash for a line, with its completion sourced and `dyknow` on `path`."""
    script = (
        f". '{ROOT}/env-hooks/dyknow-completion.bash'; COMP_LINE=$1; COMP_POINT=${{#1}}; "
        f"{function}; "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", script, "bash", line],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
        env={
            **os.environ,
            "PATH": f"{path}{os.pathsep}{os.environ['PATH']}",
            "ROS_MASTER_URI": "http://localhost:1",
        },
    )
    assert done.stderr == ""
    return sorted(candidate.strip() for candidate in done.stdout.splitlines() if candidate)


@pytest.fixture
def path(tmp_path):
    """A folder with the command in it."""
    command = tmp_path / "dyknow"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m dyknow.cli "$@"\n')
    command.chmod(0o755)
    return tmp_path


@needs_bash
def test_bash_offers_it_and_is_silent_without_a_master(path):
    assert bash("dyknow info ", path) == []
    assert bash("dyknow disc", path) == ["disconnect"]
    assert bash("rosrun dyknow dyknow disc", path, "_dyknow_rosrun") == ["disconnect"]
    assert bash("rosrun dyknow dyknow connect --t", path, "_dyknow_rosrun") == [
        "--timeout",
        "--topic",
    ]
