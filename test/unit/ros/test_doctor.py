# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`dyknow doctor` on odd names of hosts, folders and files; checks that break."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any

import pytest
from unit.cli.fake_client import FakeClient, run
from unit.manager.world import World

from dyknow.ros.shell.doctor import Doctor, NodeFacts

LITTLE = (2**40, 2**40 - 2**20, 2**20)


class Parameters:
    """A master without nodes, which has these parameters."""

    uri = "http://localhost:11311"

    def __init__(self, **values: str) -> None:
        self.values = {f"/dyknow_manager/{name}": value for name, value in values.items()}

    def ask(self, question: str, *args: str) -> Any:
        if question != "getParam":
            return [[], [], []]
        if args[0] not in self.values:
            raise LookupError(args[0])
        return self.values[args[0]]


def doctor(*nodes: NodeFacts, parameters: Any = None, **options: Any) -> Doctor:
    client = FakeClient(World())
    client.manager = "/dyknow_manager"
    made = Doctor(client, **options)  # type: ignore[arg-type]
    vars(made).update(nodes={each.name: each for each in nodes})
    vars(made).update(_master=parameters or Parameters(), _polls={}, _processes=[])
    return made


@pytest.mark.parametrize("host", ["robot..local", "a" * 64])
def test_what_cannot_be_the_name_of_a_host(host):
    (found,) = doctor(NodeFacts("/odd", f"http://{host}:1/")).names_of_hosts()
    assert found.subject == host
    assert "host of /odd does not resolve here: it is no name of a host" in found.problem


def test_an_address_that_is_no_url():
    nodes = (
        NodeFacts("/odd", "nonsense"),
        NodeFacts("/none", ""),
        NodeFacts("/a", "http://[::1]:1/"),
    )
    (found,) = doctor(*nodes).names_of_hosts()
    assert (found.subject, found.problem) == ("/odd", "its address 'nonsense' is no URL")


def test_code_with_a_dangling_link(tmp_path):
    """As Emacs makes one beside a file that is edited."""
    (tmp_path / ".#edited.py").symlink_to("me@host.1234:1")
    assert list(doctor(code=tmp_path).versions()) == []


def test_sources_are_looked_for_among_the_packages_of_the_manager(monkeypatch):
    process = SimpleNamespace(environ=lambda: {"ROS_PACKAGE_PATH": os.environ["ROS_PACKAGE_PATH"]})
    doctored = doctor()
    vars(doctored)["_processes"] = [("/dyknow_manager", process)]
    problems = [each.problem for each in doctored.library()]
    assert problems and all("no package declares" in each for each in problems)
    process.environ = lambda: {"ROS_PACKAGE_PATH": "/elsewhere"}
    (found,) = doctored.library()
    assert "the DyKnow manager has another ROS_PACKAGE_PATH" in found.problem


@pytest.mark.parametrize("variable", ["ROS_HOME", "ROS_LOG_DIR", "state_dir"])
def test_the_disk_of_a_relative_folder_that_is_not_there(variable, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(variable, "none/there")
    parameters = Parameters(**{variable: "none/there"})
    asked = []
    doctored = doctor(parameters=parameters, disk_usage=lambda path: asked.append(path) or LITTLE)
    first, *_ = doctored.disks()
    assert str(tmp_path) in asked
    assert variable != "state_dir" or first.subject == str(tmp_path)


@pytest.mark.parametrize(("host", "is_here"), [("127.0.0.1", True), ("192.0.2.1", False)])
def test_the_machine_of_the_manager_is_examined_there_alone(host, is_here, tmp_path):
    asked = []
    examined = doctor(
        NodeFacts("/dyknow_manager", f"http://{host}:1/"),
        parameters=Parameters(state_dir=str(tmp_path)),
        disk_usage=lambda path: asked.append(path) or LITTLE,
    )
    assert bool(list(examined.library())) is is_here
    list(examined.disks())
    assert (str(tmp_path) in asked, len(asked)) == (is_here, 1 + is_here)


def test_a_check_that_breaks_hides_no_other(monkeypatch):
    def breaks():
        raise ValueError("some")

    monkeypatch.setattr(Doctor, "checks", lambda doctor: [("one", breaks), ("two", tuple)])
    done = run(FakeClient(World()), "doctor")
    assert done.code == 1
    assert "ERROR    one: cannot be examined: ValueError: some\n" in done.out
    assert "ok       two\n2 checks: 1 error, 0 warnings\n" in done.out
