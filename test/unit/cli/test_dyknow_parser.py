# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of `dyknow`: lines that it understands, and its refusals of wrong ones."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from clocks import PATIENCE

import dyknow
from dyknow.cli.commands import COMMANDS, find
from dyknow.cli.main import main, parse
from dyknow.model.graph import PortRef
from dyknow.model.transformation import Parameter


def refused(capsys, *words):
    """The one line with which words are refused."""
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_every_command_has_help_with_examples_and_is_listed(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"dyknow {dyknow.__version__}\n"
    assert main(["--help"]) == 0
    listed = capsys.readouterr().out
    for name in COMMANDS:
        assert main([name, "--help"]) == 0
        text = capsys.readouterr().out
        assert f"usage: dyknow {name}" in text
        assert f"Examples:\n  {find(name).examples.splitlines()[0]}" in text
        assert f"\n  {name} " in listed


def test_examples_are_understood():
    for command in map(find, COMMANDS):
        for line in command.examples.splitlines():
            words = shlex.split(line, comments=True)
            while "dyknow" in words:
                words = words[words.index("dyknow") + 1 :]
                own = [word for word in words if "$(" not in word and "/cam1)" not in word]
                own = own[: own.index("|")] if "|" in own else own
                own = own[: own.index(">")] if ">" in own else own
                assert parse(own).command == command.name or "|" in line
                break


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("spawm a b", "there is no command 'spawm'; did you mean spawn?"),
        ("", "a command is missing"),
        ("spawn relay", "the following arguments are required: NAME"),
        ("spawn relay 'a b'", "'a b' is not a valid name"),
        ("spawn relay a//b", "expected letters, digits, '_' and single '/'"),
        ("run topic_tools", "the following arguments are required: EXECUTABLE (see"),
        ("probe", "the following arguments are required: PKG, EXECUTABLE (see"),
        ("spawn relay ~a", "'~a' is a private name"),
        ("spawn relay a --param rate", "'rate': expected NAME=VALUE, such as"),
        ("connect a b", "'a' and 'b' are topics; expected a port at one end at least"),
        ("connect a b:in --topic c", "one end is a topic already"),
        ("spawn relay a in:=/x", "connect a port of the new nodelet with --connect in"),
        ("spawn relay a rate:=5", "set a parameter of the new nodelet with --param rate=5"),
        ("set cam rate:=5", "'rate:=5' would have no effect"),
        ("set cam rate 5 _x:=y", "'_x:=y' would have no effect"),
        ("set cam rate 5 6", "dyknow set: unrecognized arguments: 6 (see 'dyknow set --help')"),
        (
            "spawn relay a --protect",
            "arguments: --protect; did you mean --protected or",
        ),
        ("spawn relay a --host ''", "argument --host: '': expected a value"),
        ("acquire 'Ball(x)' --require ''", "argument --require: '': expected a value"),
        ("acquire 'Ball(x)' --avoid left ''", "argument --avoid: '': expected a value"),
        ("load ''", "argument FILE: '': expected a value"),
        ("list __ns:=/robot", "'__ns:=/robot' would have no effect: set ROS_NAMESPACE"),
        ("list __master:=http://x:1", "set ROS_MASTER_URI in the environment"),
        ("--json list a:=b", "'dyknow list' takes neither remappings nor parameters"),
        ("connect a: b:in", "expected NODELET:PORT"),
        ("connect a:out b:in --topic x//y", "'x//y' is not a valid name"),
        ("spawn relay a --connect in", "'in': expected PORT:TOPIC or PORT:NODELET:PORT"),
        ("list --timeout never", "'never': expected seconds"),
        ("list --timeout -1", "expected"),
        (
            "acquire 'Ball(x)' --lease 2147483648",
            "expected seconds, such as 0.5, and below 2147483648",
        ),
        (
            "holds true --period 1e300",
            "'1e300': expected seconds, such as 0.5, and below 2147483648",
        ),
        ("stats --watch 0", "expected seconds"),
        ("stats --count 0", "expected an integer of at least 1"),
        ("stats --count 3", "--count says how often --watch shows"),
        ("load w.xml --within 5", "--within limits the wait: expected --wait beside it"),
        ("holds p --bag a.bag --for 5", "--bag ends by itself: --for is for live streams"),
        ("graph --dot --svg x", "not allowed with argument"),
        ("list --lon", "unrecognized arguments: --lon"),
    ],
)
def test_wrong_usage_is_one_line(capsys, line, message):
    assert message in refused(capsys, *shlex.split(line))


@pytest.mark.parametrize(
    "line",
    ["--json --timeout 2 --manager-node m list", "list --json --timeout 2 --manager-node /m"],
)
def test_options_of_every_command_stand_before_or_behind_it(line):
    arguments = parse(line.split())
    assert (arguments.json, arguments.timeout, arguments.manager_node) == (True, 2.0, "/m")


def test_ports_and_arguments_of_ros():
    arguments = parse(["connect", "/robot/camera:image/raw", "b:~in"])
    assert arguments.source == PortRef("/robot/camera", "image/raw"), "before the last colon"
    assert arguments.target == PortRef("b", "~in")
    assert parse(["list", "__name:=x", "__log:=/tmp/x.log"]).command == "list"
    found = parse("probe --settle 0.5 pkg node /a _rate:=20 --json".split())
    assert (found.settle, found.words) == (0.5, ["/a", "_rate:=20", "--json"])


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("_rate:=20 --isolated _frame:=a=b __name:=x", {"rate": "20", "frame": "a=b"}),
        (
            "--param rate:=20 frame=a:=b --param=size:=3",
            {"rate": "20", "frame": "a:=b", "size": "3"},
        ),
        (
            "--param rate=20 _gain:=2 --isolated _x:=y",
            {"rate": "20", "gain": "2", "x": "y"},
        ),
    ],
)
def test_parameters_of_a_spawn(words, given):
    found = parse(["spawn", "relay", "a", *words.split()]).param
    assert found == [Parameter(name, "", value) for name, value in given.items()]


@pytest.mark.parametrize("value", ["-5", "-5e3", "-inf", "-foo", "a:=b", "_x:=y", "--json"])
def test_a_value_of_set_is_any_text(value):
    words = ["--", value] if value.startswith("--") else [value]
    for line in (
        ["set", "--timeout", "2", "--restart", "cam", "set", *words],
        ["--json", "set", "cam", "set", "--timeout", "2", "--restart", *words],
    ):
        found = parse(line)
        given = (found.name, found.parameter, found.value, found.restart, found.timeout)
        assert given == ("cam", "set", value, True, 2.0)
    if not value.startswith("--"):
        assert parse(["set", "cam", "p", value, "--restart", "__name:=x"]).value == value


def test_a_formula_may_have_what_looks_like_a_remapping():
    formula = 'a.data == "x:=y"'
    assert parse(["holds", formula]).formula == formula
    assert parse(["acquire", "Ball(x)", "--require", formula]).require == formula


@pytest.mark.parametrize("text", ["0", "0.0", "0.00", "00", ".0", "0."])
def test_durations_of_zero(text):
    assert parse(["acquire", "Ball(x)", "--lease", text]).lease == 0


def test_the_manager_comes_from_the_environment(monkeypatch, capsys):
    monkeypatch.delenv("DYKNOW_MANAGER", raising=False)
    assert parse(["list"]).manager_node == "/dyknow_manager"
    monkeypatch.setenv("DYKNOW_MANAGER", "other")
    assert parse(["list"]).manager_node == "/other"
    monkeypatch.setenv("ROS_NAMESPACE", "/robot")
    assert parse(["list"]).manager_node == "/robot/other"
    assert parse(["list", "--manager-node", "/x"]).manager_node == "/x"
    monkeypatch.setenv("DYKNOW_MANAGER", "a b")
    assert "$DYKNOW_MANAGER: 'a b' is not a valid name" in refused(capsys, "list")
    monkeypatch.delenv("DYKNOW_MANAGER")
    monkeypatch.setenv("ROS_NAMESPACE", "~robot")
    assert "dyknow: $ROS_NAMESPACE: '~robot' is a private name" in refused(capsys, "doctor")
    monkeypatch.setenv("ROS_NAMESPACE", "robot/")
    assert parse(["list", "--manager-node", "x"]).manager_node == "/robot/x"


@pytest.mark.parametrize(
    "uri", ["http://localhost:1", "http://no.such.host.invalid:11311", "nonsense"]
)
def test_without_a_master_it_says_so_and_ends_with_3(capsys, monkeypatch, uri):
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    for words in (["list"], ["library"], ["spawn", "a", "b"], ["connect", "a:b", "c:d"]):
        assert main(words) == 3
        said = capsys.readouterr()
        assert said.out == ""
        assert f"no ROS master at {uri} (" in said.err
        assert ("(Connection refused)" in said.err) == ("localhost" in uri)
        assert said.err.count("\n") == 1


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("line", ["--help", "list --help", "--version", "check {0}"])
@pytest.mark.parametrize(
    ("where", "code", "said"),
    [
        (">/dev/full", 1, "dyknow: standard output cannot be written: No space left on device\n"),
        (">&-", 0, ""),
        ("<&-", 0, ""),
        ("2>&-", 0, ""),
        (">&{gone}", 141, ""),
    ],
)
def test_output_that_goes_nowhere_is_no_traceback(tmp_path, unbuffered, line, where, code, said):
    library = tmp_path / "library.xml"
    library.write_text("<transformations/>")
    reader, gone = os.pipe()
    os.close(reader)
    command = f"{sys.executable} -m dyknow.cli {line.format(library)} {where.format(gone=gone)}"
    try:
        done = subprocess.run(
            ["bash", "-c", command],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            pass_fds=[gone],
            check=False,
        )
    finally:
        os.close(gone)
    assert (done.returncode, done.stderr) == (code, said)


def test_closed_input_is_empty():
    command = f"{sys.executable} -m dyknow.cli check - <&-"
    done = subprocess.run(
        ["bash", "-c", command], stdout=subprocess.PIPE, timeout=PATIENCE, check=False
    )
    assert done.returncode == 1
    assert done.stdout.startswith(b"standard input:1: no element found")


def test_the_page_has_the_help_of_every_command():
    page = (Path(__file__).parents[3] / "doc" / "command_line.rst").read_text()
    assert sorted(re.findall(r"^\.\. command-help:: (\w+)$", page, re.MULTILINE)) == sorted(
        COMMANDS
    )
