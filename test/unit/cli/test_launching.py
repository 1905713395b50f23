# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Treatments of the nodes of a launch file, and the prefixes that they get."""

from __future__ import annotations

import functools
import io
import json
import os
import shlex
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
import roslaunch.config
from roslaunch.core import Machine, Node
from roslaunch.parent import ROSLaunchParent
from roslaunch.xmlloader import XmlLoader
from unit.cli.fake_client import cases

from dyknow.cli.launching import How, LaunchPlanner, NodeFilter, Treatment
from dyknow.cli.main import main, parse
from dyknow.cli.rewirable import LIBRARY, NO_LIBRARY
from dyknow.cli.shell import INTERRUPTED

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


#: A program with its arguments, its launch-prefix, and that with OURS or why it keeps its own.
PROGRAMS = """
pkg/relay |  | OURS
pkg/shell |  | OURS
pkg/script |  | OURS
nodelet/nodelet |  | OURS
nodelet/nodelet manager |  | OURS
nodelet/nodelet standalone a/b |  | OURS
nodelet/nodelet --no-bond standalone a/b |  | OURS
nodelet/nodelet --no-bond load a/b manager |  | it loads a nodelet and has no ports itself
nodelet/nodelet unload it manager |  | it unloads a nodelet and has no ports itself
pkg/missing |  | there is no such program
pkg/old_script |  | it is a script for another Python
pkg/data |  | it is no program for this machine
dyknow/nodelet_manager |  | it is DyKnow's own
rosbag/record |  | a bag names the topics that were recorded
rviz/rviz |  | its user chooses topics in its window
rqt_graph/rqt_graph |  | its user chooses topics in its window
pkg/relay | nice -n 5 | nice -n 5 OURS
pkg/relay | xterm -e | xterm -e OURS
pkg/relay | xterm -e gdb -ex run --args | xterm -e OURS gdb -ex run --args
pkg/relay | /usr/bin/valgrind --tool=none | OURS /usr/bin/valgrind --tool=none
pkg/relay | bash -c 'sleep 1; $0 $@' | bash -c 'sleep 1; $0 $@' OURS
pkg/relay | rosrun dyknow rewirable | its launch-prefix makes it re-wirable
pkg/relay | /usr/bin/python3 -m pdb | its launch-prefix runs it in python3
pkg/relay | nice coverage run | its launch-prefix runs it in coverage
pkg/relay | sudo -E | its launch-prefix starts it by sudo, with another environment
"""


@pytest.mark.parametrize(("what", "prefix", "becomes"), cases(PROGRAMS))
def test_a_program_gets_our_prefix_next_to_it_or_a_reason_for_none(planner, what, prefix, becomes):
    program, _, args = what.partition(" ")
    package, type_ = program.split("/")
    more = {"args": args, "launch_prefix": prefix, "namespace": "/robot/"}
    answer = treat(planner, type_, package, **more)
    if "OURS" in becomes:
        how = How.SCRIPT_HOST if type_ == "script" else How.LIBRARY
        whole = becomes.replace("OURS", REWIRABLE)
        assert answer == Treatment("/robot/it", program, "", how, "", whole)
        assert not prefix or treat(planner, type_, package, cwd="node", **more).prefix == whole
    else:
        assert answer == Treatment("/robot/it", program, "", How.AS_IT_IS, becomes, prefix)


def test_without_the_library_programs_are_left_alone(planner, monkeypatch, tmp_path):
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(tmp_path / "lib"))
    assert treat(planner).why == NO_LIBRARY


def test_the_environment_of_a_node_has_to_have_dyknow(planner, tmp_path):
    answer = treat(planner, env_args=[("PYTHONPATH", "/nowhere:/else")])
    why = "DyKnow is not on the PYTHONPATH that the launch file sets for it"
    assert (answer.how, answer.why) == (How.AS_IT_IS, why)
    (tmp_path / "dyknow").mkdir()
    path = f"/nowhere:{tmp_path}"
    assert treat(planner, env_args=[("PYTHONPATH", path), ("A", "b")]).how is How.LIBRARY


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
    """Return a prefix as it arrives on the machine that roslaunch sends it to."""
    text = f"<launch>{node(launch_prefix=prefix).to_remote_xml()}</launch>"
    config = roslaunch.config.ROSLaunchConfig()
    XmlLoader().load_string(text, config, verbose=False)
    return str(config.nodes[0].launch_prefix)


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


RELAY = '<node name="{name}" pkg="topic_tools" type="relay" args="/a /b"/>'


@pytest.fixture(autouse=True)
def _no_parameters_of_roscore(request, monkeypatch):
    """They are the output of programs, which take longer than all else."""
    if request.node.name != "test_a_dry_run_lists_what_becomes_of_the_nodes":
        monkeypatch.setattr("roslaunch.config.load_roscore", lambda *args, **kwds: None)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(file, *lines):
    file.write_text("\n".join(["<launch>", *lines, "</launch>"]))
    return file


def refused(capsys, *words):
    """The one line that says why a launch is refused."""
    assert main(["launch", *words, "--dry-run"]) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    return said.err[len("dyknow: ") : -1]


ABSENT = """
x.launch | there is no launch file 'x.launch'; expected PKG FILE, or the path of a file
rosppy x.launch | 'rosppy' is neither a package on ROS_PACKAGE_PATH nor a launch file; did you mean
image_proc imagproc.launch | has no launch file 'imagproc.launch'; did you mean image_proc.launch?
a.launch b.launch | there is no launch file 'b.launch'
a.launch --only rely | --only rely: no node matches; did you mean /relay?
"""


@pytest.mark.parametrize(("words", "message"), cases(ABSENT))
def test_what_is_not_there_is_named(folder, capsys, words, message):
    write(folder / "a.launch", RELAY.format(name="relay"))
    assert message in refused(capsys, *words.split())


def test_files_of_the_same_name_are_listed(folder, capsys, monkeypatch):
    (folder / "other").mkdir()
    files = [str(write(each / "a.launch")) for each in (folder, folder / "other")]
    monkeypatch.setattr("roslib.packages.find_resource", lambda *words: files)
    said = refused(capsys, "pkg", "a.launch")
    assert said.startswith("multiple files named [a.launch] in package [pkg]:")
    assert all(f"- {file} " in said for file in files)


#: A launch file, its lines between slashes, and the error in it.
ERRORS = """
 // <param name="p" value="$(arg x)"/> | a.launch:3: [a.launch] requires the 'x' arg to be set
<node> | a.launch: Invalid roslaunch XML syntax: mismatched tag: line 3, column 2
<include file="$(find nix)/b.launch"/> | a.launch:2: there is no package 'nix' on ROS_PACKAGE_PATH
B_WITH_X | a.launch:2: unused args [x] for include of [b.launch]
<include file="c.launch"/> | c.launch:3: arg 'y' is not defined. Arg xml is <arg name=
RELAY // RELAY | a.launch:3: roslaunch file contains multiple nodes named [/a]. Please check all
ON_M | a.launch:2: ERROR: unknown machine [m]
<include file="gone.launch"/> | a.launch:2: No such file or directory: 'gone.launch'
<include file="d.launch"/> | d.launch:2: Invalid roslaunch XML syntax: no root
 // <include file="a.launch"/> | a.launch:1: the launch files include each other
 // <include/> | a.launch:3: attribute 'file' is missing
<param name="p" value="$(eval 1/0)"/> | a.launch:2: ZeroDivisionError: division by zero
 // <group if="$(eval q)"/> | a.launch:3: NameError: name 'q' is not defined
<param name="p" textfile="gone"/> | a.launch:2: No such file or directory: 'gone'
 // <node name="a" pkg="p" type="t" launch-prefix="'n"/> | a.launch:3: node a: No closing quotation
M // ON_M | a.launch:2: cannot resolve host address for machine [no.such.host.invalid]
"""
SHORT = {
    "RELAY": RELAY.format(name="a"),
    "B_WITH_X": '<include file="b.launch"><arg name="x" value=""/></include>',
    "M": '<machine name="m" address="no.such.host.invalid"/>',
    "ON_M": '<node name="a" pkg="p" type="t" machine="m"/>',
}


@pytest.mark.parametrize(("lines", "message"), cases(ERRORS))
def test_errors_have_file_and_line(folder, capsys, lines, message):
    write(folder / "a.launch", *(SHORT.get(line, line) for line in lines.split(" // ")))
    write(folder / "b.launch", '<param name="p" value="q"/>')
    write(folder / "c.launch", '<arg name="x" default=""/>', '<arg name="z" value="$(arg y)"/>')
    (folder / "d.launch").write_text("\n<lunch/>")
    assert refused(capsys, "a.launch")[: len(message)] == message


def test_arguments_that_no_file_speaks_of(folder, capsys):
    """roslaunch ignores them, so they are not an error."""
    inner = write(folder / "inner.launch", '<arg name="inner" default=""/>')
    lines = [f'<arg name="{name}" default=""/>' for name in ("camera", "use-sim")]
    lines.append(f'<include file="{inner}" pass_all_args="true"/>')
    outer = write(folder / "outer.launch", *lines)
    given = ["camera:=1", "use-sim:=1", "inner:=2", "__name:=x", "camra:=3"]
    assert main(["launch", str(outer), *given, "--dry-run"]) == 0
    expected = "dyknow: warning: no launch file has an argument 'camra'; did you mean camera?\n"
    assert capsys.readouterr().err == expected


def test_a_dry_run_lists_what_becomes_of_the_nodes(folder, capsys):
    file = write(
        folder / "a.launch",
        '<arg name="space"/>',
        '<group ns="$(arg space)">',
        RELAY.format(name="b"),
        "</group>",
        '<node name="a" pkg="rosbag" type="record"/>',
        '<machine name="far" address="localhost" user="nobody_of_here"/>',
        '<node name="c" pkg="p" type="t" machine="far" launch-prefix="nice"/>',
    )
    assert main(["launch", str(file), "--dry-run", "space:=s"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "NODE  RUNS               HOW",
        "/a    rosbag/record      as it is: a bag names the topics that were recorded",
        "/c    p/t on far         live ports if DyKnow is on that machine",
        "/s/b  topic_tools/relay  live ports by the library",
    ]
    assert main(["launch", str(file), "--dry-run", "--json", "space:=s"]) == 0
    nodes = json.loads(capsys.readouterr().out)["nodes"]
    assert nodes[1] == {
        "node": "/a",
        "program": "rosbag/record",
        "machine": "",
        "how": "as_it_is",
        "why": "a bag names the topics that were recorded",
        "launch_prefix": "",
    }
    assert nodes[0]["launch_prefix"].endswith("/lib/dyknow/rewirable")
    assert nodes[2]["launch_prefix"].startswith("nice /bin/sh -c ")


def test_standard_input_is_a_launch_file_and_json_is_all_that_is_printed(capsys, monkeypatch):
    text = f"<launch><arg name='size'/>{RELAY.format(name='a')}</launch>"
    words = ["launch", "-", "size:=5", "sixe:=5", "--dry-run", "--json"]
    monkeypatch.setattr("sys.stdin", io.StringIO(text))
    monkeypatch.setattr("sys.argv", ["dyknow", *words])  # where roslaunch looks for it
    assert main(words) == 0
    printed = capsys.readouterr()
    assert [each["node"] for each in json.loads(printed.out)["nodes"]] == ["/a"]
    warnings = [line for line in printed.err.splitlines() if "warning" in line]
    assert warnings == [
        "dyknow: warning: no launch file has an argument 'sixe'; did you mean size?"
    ]


def test_what_is_wrong_on_standard_input_is_one_line(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("<launch>\n<node"))
    monkeypatch.setattr("sys.argv", ["dyknow", "launch", "-", "--dry-run"])
    assert main(["launch", "-", "--dry-run"]) == 1
    told = [line for line in capsys.readouterr().err.splitlines() if "loading XML" not in line]
    assert told == [
        "dyknow: standard input: Invalid roslaunch XML syntax: unclosed token: line 2, column 0"
    ]


def test_a_dry_run_says_what_roslaunch_warns_of(folder, capsys):
    write(folder / "a.launch", "<nod pkg='x'/>")
    assert main(["launch", "a.launch", "--dry-run"]) == 0
    assert "dyknow: warning: unrecognized tag nod\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "environment", "message"),
    [
        (["--pid", "/none/such"], {}, "No such file or directory: '/none/such'"),
        ([], {"ROS_MASTER_URI": "nonsense"}, "invalid ROS_MASTER_URI: nonsense"),
        ([], {"ROS_MASTER_URI": ""}, "invalid ROS_MASTER_URI:"),
    ],
)
def test_what_cannot_be_prepared(words, environment, message, folder, capsys, monkeypatch):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    write(folder / "a.launch", RELAY.format(name="relay"))
    assert main(["launch", "a.launch", *words]) == 1
    assert capsys.readouterr().err == f"dyknow: {message}\n"


def test_an_exception_that_matches_no_node(folder, capsys):
    write(folder / "a.launch", RELAY.format(name="relay"))
    assert main(["launch", "a.launch", "--except", "x/*", "--dry-run"]) == 0
    assert capsys.readouterr().err == "dyknow: warning: --except x/*: no node matches\n"


def test_arguments_of_the_file_may_stand_anywhere():
    arguments = parse(["launch", "a:=1", "pkg", "x.launch", "--screen", "b:=2", "-p", "11312"])
    assert (arguments.words, arguments.given) == (["pkg", "x.launch"], ["a:=1", "b:=2"])
    assert (arguments.screen, arguments.port, arguments.required) == (True, 11312, False)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--json"], "--json is for --dry-run"),
        (["--screen", "--log"], "--screen and --log exclude each other"),
        (["--port", "none"], "'none': expected an integer of at least 1"),
        (["--sigint-timeout", "0"], "'0': expected seconds, such as 0.5"),
    ],
)
def test_wrong_usage(words, message, capsys):
    assert main(["launch", "a.launch", *words]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.usefixtures("heeded_signals")
def test_an_interrupt_that_roslaunch_drops_ends_the_launch(folder, monkeypatch):
    """It drops all that is raised while it sets up its log."""
    started = []
    interrupt = functools.partial(signal.raise_signal, signal.SIGINT)
    monkeypatch.setattr("rosgraph.roslogging.configure_logging", lambda *a, **k: interrupt())
    monkeypatch.setattr(ROSLaunchParent, "start", lambda parent: started.append(parent))
    file = write(folder / "a.launch", RELAY.format(name="relay"))
    assert main(["launch", "--skip-log-check", "--no-summary", str(file)]) == INTERRUPTED
    assert not started
