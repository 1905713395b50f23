# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What becomes of the nodes of a launch file, and the prefixes that they get."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import roslaunch.config
from roslaunch.core import Machine, Node
from roslaunch.xmlloader import XmlLoader

from dyknow.cli.launching import LEFT_ALONE, How, LaunchPlanner, NodeFilter, Treatment
from dyknow.cli.rewirable import LIBRARY, NO_LIBRARY

REWIRABLE = "/ws/lib/dyknow/rewirable"


@pytest.fixture
def planner(tmp_path, monkeypatch):
    """A planner that knows `pkg` with a program of each kind; the machine `far` is another one."""
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / LIBRARY).touch()
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(tmp_path))
    texts = {
        "shell": "#!/bin/sh\nexec relay\n",
        "script": "#!/usr/bin/env python3\n",
        "old_script": "#!/usr/bin/env python2\n",
        "data": "hello",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    shell = shutil.which("sh")
    assert shell is not None
    programs = {name: str(tmp_path / name) for name in texts}

    def find(package, type_):
        return None if type_ == "missing" else programs.get(type_, shell)

    return LaunchPlanner(REWIRABLE, find, lambda machine: machine.name != "far", NodeFilter())


def node(type_="relay", package="pkg", machine="", **more):
    made = Node(package, type_, more.pop("name", "it"), **more)
    made.machine = Machine(machine, "localhost")
    return made


def treat(planner, *words, **more):
    return planner.treat(node(*words, **more))


def selected(planner, only="", except_=""):
    return LaunchPlanner(
        planner.rewirable,
        planner.find,
        planner.is_local,
        NodeFilter(only.split(), except_.split()),
    )


@pytest.mark.parametrize(
    ("what", "how"),
    [
        ({}, How.LIBRARY),
        ({"type_": "shell"}, How.LIBRARY),
        ({"type_": "script"}, How.SCRIPT_HOST),
        *(
            ({"type_": "nodelet", "package": "nodelet", "args": args}, How.LIBRARY)
            for args in ("manager", "standalone a/b", "--no-bond standalone a/b", "")
        ),
    ],
)
def test_programs_get_the_library_and_python_scripts_their_host(planner, what, how):
    treatment = treat(planner, namespace="/robot/", **what)
    program = f"{what.get('package', 'pkg')}/{what.get('type_', 'relay')}"
    assert treatment == Treatment("/robot/it", program, "", how, "", REWIRABLE)


def test_without_the_library_programs_are_left_alone(planner, monkeypatch, tmp_path):
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(tmp_path / "lib"))
    assert treat(planner).why == NO_LIBRARY


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ({"type_": "missing"}, "there is no such program"),
        ({"type_": "old_script"}, "it is a script for another Python"),
        ({"type_": "data"}, "it is no program for this machine"),
        ({"package": "dyknow", "type_": "nodelet_manager"}, "it is DyKnow's own"),
        (
            {"package": "nodelet", "type_": "nodelet", "args": "--no-bond load a/b manager"},
            "it loads a nodelet and has no ports itself",
        ),
        (
            {"package": "nodelet", "type_": "nodelet", "args": "unload it manager"},
            "it unloads a nodelet and has no ports itself",
        ),
        ({"package": "rosbag", "type_": "record"}, "a bag names the topics that were recorded"),
        ({"package": "rviz", "type_": "rviz"}, "its user chooses topics in its window"),
        ({"package": "rqt_graph", "type_": "rqt_graph"}, "its user chooses topics in its window"),
        ({"launch_prefix": "rosrun dyknow rewirable"}, "its launch-prefix makes it re-wirable"),
        ({"launch_prefix": "/usr/bin/python3 -m pdb"}, "its launch-prefix runs it in python3"),
        ({"launch_prefix": "nice coverage run"}, "its launch-prefix runs it in coverage"),
        (
            {"launch_prefix": "sudo -E"},
            "its launch-prefix starts it by sudo, with another environment",
        ),
        (
            {"env_args": [("PYTHONPATH", "/nowhere:/else")]},
            "DyKnow is not on the PYTHONPATH that the launch file sets for it",
        ),
    ],
)
def test_what_is_left_alone_keeps_its_prefix(planner, what, why):
    answer = treat(planner, **what)
    assert (answer.how, answer.why) == (How.AS_IT_IS, why)
    assert answer.prefix == what.get("launch_prefix", "")


def test_an_environment_that_has_dyknow_is_fine(planner, tmp_path):
    (tmp_path / "dyknow").mkdir()
    path = f"/nowhere:{tmp_path}"
    assert treat(planner, env_args=[("PYTHONPATH", path), ("A", "b")]).how is How.LIBRARY


@pytest.mark.parametrize(
    ("prefix", "whole"),
    [
        ("nice -n 5", f"nice -n 5 {REWIRABLE}"),
        ("xterm -e", f"xterm -e {REWIRABLE}"),
        ("xterm -e gdb -ex run --args", f"xterm -e {REWIRABLE} gdb -ex run --args"),
        ("/usr/bin/valgrind --tool=none", f"{REWIRABLE} /usr/bin/valgrind --tool=none"),
        ("bash -c 'sleep 1; $0 $@'", f"bash -c 'sleep 1; $0 $@' {REWIRABLE}"),
    ],
)
def test_ours_is_next_to_the_node_or_its_debugger(planner, prefix, whole):
    assert treat(planner, launch_prefix=prefix).prefix == whole
    assert treat(planner, launch_prefix=prefix, cwd="node").prefix == whole


def test_the_folder_of_the_node_is_where_it_runs(planner, tmp_path):
    """roslaunch takes the folder of the first word, which is ours."""
    rewirable = program(tmp_path / "re wirable", 'pwd\nexec "$@"\n')
    folder = tmp_path / "the node's"
    folder.mkdir()
    it = program(folder / "it", 'echo "$0 $*"\n')
    made = LaunchPlanner(rewirable, planner.find, planner.is_local, NodeFilter())
    prefix = treat(made, cwd="node").prefix
    assert os.path.isabs(shlex.split(prefix)[0])
    assert run(prefix, it, "a  b") == f"{folder}\n{it} a  b\n"


@pytest.mark.parametrize("cwd", [None, "node"])
def test_another_machine_uses_its_own_dyknow(planner, tmp_path, cwd):
    it = program(tmp_path / "it", 'echo "$0 $*"; pwd\n')
    answer = treat(planner, "missing", machine="far", cwd=cwd)
    assert (answer.machine, answer.how) == ("far", How.OTHER_MACHINE)
    prefix = sent(answer.prefix)
    workspace = tmp_path / "its workspace"
    (workspace / "lib" / "dyknow").mkdir(parents=True)
    path = f"/nowhere:{workspace}"
    folder = tmp_path if cwd else Path("/")
    bare = f"{it} a  b\n{folder}\n"
    assert run(prefix, it, "a  b", CMAKE_PREFIX_PATH=path) == bare
    assert run(prefix, it, "a  b") == bare
    program(workspace / "lib" / "dyknow" / "rewirable", 'echo ours; exec "$@"\n')
    assert run(prefix, it, "a  b", CMAKE_PREFIX_PATH=path) == "ours\n" + bare


def program(file, text):
    file.write_text(f"#!/bin/sh\n{text}")
    file.chmod(0o755)
    return str(file)


def run(prefix, *words, **environment):
    """Run a command under a prefix, as roslaunch takes it apart."""
    done = subprocess.run(
        [*shlex.split(prefix), *words],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd="/",
        env={"PATH": os.environ["PATH"], **environment},
    )
    return done.stdout


def sent(prefix):
    """Return what arrives of a prefix on the machine that roslaunch sends it to."""
    text = f"<launch>{node(launch_prefix=prefix).to_remote_xml()}</launch>"
    config = roslaunch.config.ROSLaunchConfig()
    XmlLoader().load_string(text, config, verbose=False)
    return str(config.nodes[0].launch_prefix)


def test_the_page_names_all_that_are_left_alone():
    page = (Path(__file__).resolve().parents[3] / "doc" / "launch.rst").read_text()
    assert [pattern for pattern, _ in LEFT_ALONE if f"``{pattern}``" not in page] == []


def test_patterns_choose(planner):
    def left(only="", except_="", **more):
        return treat(selected(planner, only, except_), **more).why

    assert left("other") == "--only does not name it"
    assert left("it") == left("/it") == left("pkg/*") == left("nothing p?g/relay") == ""
    assert left("/robot/*", namespace="robot") == left("robot/*", namespace="robot") == ""
    assert left("robot/*") == "--only does not name it"
    assert left("IT") == "--only does not name it"
    assert left(except_="it") == left("it", "pkg/relay") == "--except names it"
    assert left(except_="other") == ""
    recorder = {"package": "rosbag", "type_": "record"}
    assert left("rosbag/*", **recorder) == ""
    assert left("it", package="dyknow") == "it is DyKnow's own"


def test_patterns_without_a_match_are_known(planner):
    choice = selected(planner, "it x", "pkg/relay y")
    plan = [choice.treat(node())]
    assert choice.chosen.without_match(plan) == [("--only", "x"), ("--except", "y")]
