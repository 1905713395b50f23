# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parameters of the manager that cannot be used or are not known, and the files that they name."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Dict, List

import pytest
import rospy
from clocks import HandClock

from dyknow.cli.node_help import MANAGER
from dyknow.errors import BadParameter, DyKnowError, Problem, SpecificationError
from dyknow.manager.store import Store
from dyknow.ros.manager import manager_settings
from dyknow.ros.manager.boot_wiring import BootWiring
from dyknow.ros.manager.manager_settings import GROUPS, ManagerSettings, state_path


@pytest.fixture
def given(monkeypatch):
    """The private parameters of the node."""
    found: Dict[str, Any] = {}

    monkeypatch.setattr(rospy, "get_param", lambda name, default: found.get(name[1:], default))
    monkeypatch.setattr(rospy, "set_param", lambda name, value: found.update({name[1:]: value}))
    monkeypatch.setattr(rospy, "get_name", lambda: "/dyknow_manager")
    return found


@pytest.fixture
def warned(monkeypatch):
    found: List[str] = []
    monkeypatch.setattr(rospy, "logwarn", lambda text, *words: found.append(text % words))
    return found


def test_unknown_members_of_namespaces_are_named(given, warned):
    given["watchdog"] = {"hang": 10, "memory": 5.0}
    given["limits"] = {"nodelet": 5, "x": 1, "nodelets": 7}
    given["keeps"] = True
    settings = ManagerSettings.read(given)
    assert (settings.watchdog.memory, settings.guards.nodelets) == (5.0, 7)
    named = {text.split("~")[1].partition(";")[0] for text in warned}
    assert named == {"keeps", "watchdog/hang", "limits/nodelet", "limits/x"}
    assert "unknown parameter ~watchdog/hang; did you mean ~watchdog/hung?" in warned
    assert "unknown parameter ~limits/nodelet; did you mean ~limits/nodelets?" in warned
    (known,) = [text for text in warned if "/x" in text]
    assert known.endswith("; known: ~" + " ~".join(f"limits/{each}" for each in GROUPS["limits"]))


def test_the_master_is_asked_nothing_more_for_single_parameters(given, warned, monkeypatch):
    given["watchdog"] = {"hung": 10.0}
    given["limits"] = {"nodelets": 7}
    monkeypatch.setattr(rospy, "get_param", lambda name, default: pytest.fail(f"{name} is asked"))
    settings = ManagerSettings.read(given)
    assert (settings.watchdog.hung, settings.guards.nodelets) == (10.0, 7)


def test_a_value_in_place_of_all_parameters_is_none_of_them(given):
    assert ManagerSettings.read(5) == ManagerSettings()


def test_the_members_are_those_that_the_help_describes():
    for group, members in GROUPS.items():
        assert MANAGER.count(f"~{group}/") == len(members)
        assert all(f"~{group}/{each}" in MANAGER for each in members)


@pytest.mark.parametrize("group", ["watchdog", "limits"])
def test_a_namespace_is_no_value(given, warned, group):
    given[group] = 10
    with pytest.raises(BadParameter, match=f"'~{group}' is 10: expected a namespace with "):
        ManagerSettings.read(given)


@pytest.mark.parametrize("value", [float("inf"), float("nan"), 1e10, -1.0, "soon", True])
@pytest.mark.parametrize("name", ["spawn_timeout", "orphan_timeout", "recover"])
def test_seconds_are_those_that_a_wait_can_last(given, name, value):
    given[name] = value
    with pytest.raises(BadParameter, match=f"'~{name}' is .*: expected seconds, at least"):
        ManagerSettings.read(given)
    given[name] = 1e6
    assert getattr(ManagerSettings.read(given), name) == 1e6


def test_names_of_nodelet_managers_are_not_separated_by_commas(given):
    given["nodelet_managers"] = "mine /other"
    assert ManagerSettings.read(given).nodelet_managers == ("/mine", "/other")
    given["nodelet_managers"] = "mine,/other"
    with pytest.raises(BadParameter, match="^parameter '~nodelet_managers' is 'mine,/other'"):
        ManagerSettings.read(given)


def test_names_that_differ_in_their_separators_have_files_of_their_own(monkeypatch, tmp_path):
    folder, master = str(tmp_path / "new"), "http://host:11311"
    monkeypatch.setattr(manager_settings.rosgraph, "get_master_uri", lambda: master)
    settings = ManagerSettings(state_dir=folder)
    names = ("/uav_a/dyknow_manager", "/uav/a/dyknow_manager", "/uav_a/dyknow/manager")

    def path(name: str) -> str:
        return state_path(folder, master, name, "sqlite3")

    for name in names:
        monkeypatch.setattr(rospy, "get_name", lambda name=name: name)
        for _ in range(2):
            settings.take_state()
            assert settings.state_path("sqlite3") == path(name)
    assert [path(name).rpartition("/")[2] for name in names] == [
        "host-11311-uav-a-dyknow-manager.sqlite3",
        "host-11311+uav+a+dyknow_manager.sqlite3",
        "host-11311+uav_a+dyknow+manager.sqlite3",
    ]
    (tmp_path / "new" / "host-11311-uav-a-dyknow-manager.node").unlink()
    assert len({*map(path, names)}) == 3, "one that was reset"


def test_where_nothing_can_be_noted_the_files_are_those_of_the_key(given, monkeypatch, tmp_path):
    monkeypatch.setattr(manager_settings.rosgraph, "get_master_uri", lambda: "http://host:11311")
    settings = ManagerSettings(state_dir=f"{tmp_path}/file/folder")
    (tmp_path / "file").touch()
    settings.take_state()
    assert settings.state_path("lock").endswith("/host-11311-dyknow-manager.lock")


def test_a_manager_makes_its_state_dir_absolute(given, tmp_path, monkeypatch):
    """Which is then the same for those that read the parameter in another folder."""
    given["state_dir"] = "state"
    monkeypatch.chdir(tmp_path)
    settings = ManagerSettings.read(given)
    assert settings.state_dir == given["state_dir"] == str(tmp_path / "state")
    monkeypatch.chdir("/")
    assert ManagerSettings.read(given) == settings
    assert Path(manager_settings.mirror_path()).parent == tmp_path / "state"
    given["state_dir"] = ""
    assert ManagerSettings.read(given).state_dir == given["state_dir"] == ""
    given["state_dir"] = "~/state"
    home = os.path.expanduser("~/state")
    assert ManagerSettings.read(given).state_dir == given["state_dir"] == home


def test_a_manager_makes_the_paths_of_its_files_absolute(given, tmp_path, monkeypatch):
    given["ontologies"] = ["lab.ttl"]
    given["catalogues"] = "/c.xml"
    given["transformations"] = "a.xml ~/b.xml"
    given["wiring"] = "robot.xml"
    monkeypatch.chdir(tmp_path)
    settings = ManagerSettings.read(given)
    assert settings.ontologies == (str(tmp_path / "lab.ttl"),)
    assert settings.transformations == (str(tmp_path / "a.xml"), os.path.expanduser("~/b.xml"))
    assert settings.wiring == str(tmp_path / "robot.xml")
    assert given["catalogues"] == "/c.xml", "as it was given"
    monkeypatch.chdir("/")
    assert ManagerSettings.read(given) == settings


# The wiring of a start: when it is loaded, again, and not


class Boot:
    """A state, a file, and its loaded versions."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.store = Store(":memory:")
        self.clock = HandClock()
        self.loaded: List[bytes] = []
        self.trouble = ""

    def start(self) -> BootWiring:
        return BootWiring(str(self.file), self.store, self.check, self.load, self.clock.now)

    def check(self, data: bytes, file: str) -> None:
        if data == b"wrong":
            raise SpecificationError([Problem(file, 3, "expected <wiring>")])

    def load(self, data: bytes, file: str) -> None:
        if self.trouble:
            raise DyKnowError(self.trouble)
        self.loaded.append(data)


@pytest.fixture
def boot(tmp_path: Path) -> Boot:
    file = tmp_path / "robot.xml"
    file.write_bytes(b"one")
    return Boot(file)


def test_a_file_is_loaded_once_for_each_of_its_versions(boot):
    wiring = BootWiring("", boot.store, boot.check, boot.load)
    assert not wiring.is_due and wiring.work() is None, "no file is nothing to load"
    for _ in range(2):
        wiring = boot.start()
        assert wiring.work() is None and wiring.work() is None
    assert boot.loaded == [b"one"]
    boot.file.write_bytes(b"two")
    boot.start().work()
    assert boot.loaded == [b"one", b"two"]
    boot.start().forget()
    boot.start().work()
    assert boot.loaded == [b"one", b"two", b"two"]


def test_what_cannot_be_loaded_now_is_tried_again(boot, caplog):
    caplog.set_level("INFO", "rosout")
    wiring = boot.start()
    boot.trouble = "no camera"
    pauses = []
    for _ in range(4):
        pause = wiring.work()
        assert pause is not None
        pauses.append(pause)
        boot.clock.time += pause
    assert pauses == sorted(pauses) and pauses[0] == 1.0 and pauses[-1] > 4.0
    assert boot.start().is_due, "the next life tries it too"
    boot.trouble = ""
    assert wiring.work() is None
    assert boot.loaded == [b"one"]
    levels = [record.levelname for record in caplog.records]
    assert levels == ["WARNING", "INFO"], "a boot that ends well has no error"


@pytest.mark.parametrize("is_there", [False, True])
def test_a_missing_or_wrong_file_is_refused_unless_one_was_loaded(boot, is_there):
    words = "line 3|:3: expected <wiring>" if is_there else "No such file"
    boot.file.write_bytes(b"wrong") if is_there else boot.file.unlink()
    with pytest.raises(BadParameter, match=rf"~wiring.*robot.xml.*({words})"):
        boot.start()
    boot.file.write_bytes(b"one")
    boot.start().work()
    boot.file.write_bytes(b"wrong") if is_there else boot.file.unlink()
    assert boot.start().work() is None
    assert boot.loaded == [b"one"]
