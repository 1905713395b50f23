# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What the nodes say about themselves is what they have."""

import re

import pytest
import rospy
import yaml

from dyknow.cli import manager, nodelet
from dyknow.cli.node_help import MANAGER, NODELET_MANAGER
from dyknow.errors import BadParameter
from dyknow.ros.manager import manager_settings
from dyknow.ros.manager.manager_settings import ManagerSettings
from dyknow.ros.nodelets.nodelet_manager import Settings


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
    given = {f"~{name}": value}
    monkeypatch.setattr(rospy, "get_param", given.get)
    with pytest.raises(BadParameter, match=f"~{name}' is .*: expected {expected}"):
        Settings.read()
