# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`dyknow launch` without processes: what it reads, what is wrong with it, what it would do."""

from __future__ import annotations

import io
import json

import pytest

from dyknow.cli.main import main, parse

RELAY = '<node name="{name}" pkg="topic_tools" type="relay" args="/a /b"/>'


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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "x.launch",
            "there is no launch file 'x.launch'; expected PKG FILE, or the path of a file",
        ),
        (
            "rosppy x.launch",
            "'rosppy' is neither a package on ROS_PACKAGE_PATH nor a launch file; did you mean",
        ),
        (
            "image_proc imageproc.launch",
            "package 'image_proc' has no launch file 'imageproc.launch'; did you mean "
            "image_proc.launch?",
        ),
        ("a.launch b.launch", "there is no launch file 'b.launch'"),
        ("a.launch --only rely", "--only rely: no node matches; did you mean /relay?"),
    ],
)
def test_what_is_not_there_is_named(folder, capsys, words, message):
    write(folder / "a.launch", RELAY.format(name="relay"))
    assert refused(capsys, *words.split())[: len(message)] == message


NODE = '<node name="a" pkg="p" type="t" {}/>'
ERRORS = [
    (
        ["", '<param name="p" value="$(arg x)"/>'],
        "a.launch:3: [a.launch] requires the 'x' arg to be set",
    ),
    (["<node>"], "a.launch: Invalid roslaunch XML syntax: mismatched tag: line 3, column 2"),
    (
        ['<include file="$(find no_such_package)/b.launch"/>'],
        "a.launch:2: there is no package 'no_such_package' on ROS_PACKAGE_PATH",
    ),
    (
        ['<include file="b.launch">', '<arg name="x" value=""/>', "</include>"],
        "a.launch:2: unused args [x] for include of [b.launch]",
    ),
    (['<include file="c.launch"/>'], "c.launch:3: arg 'y' is not defined. Arg xml is <arg name="),
    (
        [RELAY.format(name="a"), RELAY.format(name="a")],
        "a.launch:3: roslaunch file contains multiple nodes named [/a]. Please check all",
    ),
    ([NODE.format('machine="m"')], "a.launch:2: ERROR: unknown machine [m]"),
    (['<include file="gone.launch"/>'], "a.launch:2: No such file or directory: 'gone.launch'"),
    (['<include file="d.launch"/>'], "d.launch:2: Invalid roslaunch XML syntax: no root"),
    (["", '<include file="a.launch"/>'], "a.launch:1: the launch files include each other"),
    (["", "<include/>"], "a.launch:3: attribute 'file' is missing"),
    (['<param name="p" value="$(eval 1/0)"/>'], "a.launch:2: ZeroDivisionError: division by zero"),
    (["", '<group if="$(eval q)"/>'], "a.launch:3: NameError: name 'q' is not defined"),
    (['<param name="p" textfile="gone"/>'], "a.launch:2: No such file or directory: 'gone'"),
    (
        ["", NODE.format("""launch-prefix="'nice\"""")],
        "a.launch:3: node a: No closing quotation",
    ),
    (
        ['<machine name="m" address="no.such.host.invalid"/>', NODE.format('machine="m"')],
        "a.launch:2: cannot resolve host address for machine [no.such.host.invalid]",
    ),
]


@pytest.mark.parametrize(("lines", "message"), ERRORS)
def test_errors_have_file_and_line(folder, capsys, lines, message):
    write(folder / "a.launch", *lines)
    write(folder / "b.launch", '<param name="p" value="q"/>')
    write(folder / "c.launch", '<arg name="x" default=""/>', '<arg name="z" value="$(arg y)"/>')
    (folder / "d.launch").write_text("\n<lunch/>")
    assert refused(capsys, "a.launch")[: len(message)] == message


def test_arguments_that_no_file_speaks_of(folder, capsys):
    """roslaunch ignores them, so they are no error."""
    inner = write(folder / "inner.launch", '<arg name="inner" default=""/>')
    lines = ('<arg name="camera" default=""/>', f'<include file="{inner}" pass_all_args="true"/>')
    outer = write(folder / "outer.launch", *lines)
    words = ["launch", str(outer), "camera:=1", "inner:=2", "__name:=x", "camra:=3", "--dry-run"]
    assert main(words) == 0
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


def test_standard_input_is_a_launch_file(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(f"<launch>{RELAY.format(name='a')}</launch>"))
    assert main(["launch", "-", "--dry-run"]) == 0
    assert "/a    topic_tools/relay" in capsys.readouterr().out


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
