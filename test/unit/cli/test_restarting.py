# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`restart` and `set`, on a manager without ROS."""

from __future__ import annotations

import json

import pytest
from unit.cli.fake_client import play, run

from dyknow.cli.shell import UNREACHABLE
from dyknow.errors import ManagerUnreachable
from dyknow.model.graph import NodeletKind, Restarted

#: With a camera, and a protected relay behind it.
SESSIONS = {
    "restart": """
$ restart cam nobody /robot/relay
restarted /cam in ... s
restarted /robot/relay in ... s
dyknow: no nodelet named '/nobody' is loaded...
[1]
$ restart /fake_0
restarted /fake_0 with /cam, /robot/relay in ... s
$ restart --all-outdated
nothing is outdated
$ restart
dyknow restart: expected the names of nodelets or nodelet managers, --all-outdated, or --watch ...
[2]
$ restart cam --all-outdated
dyknow restart: --all-outdated restarts what is outdated; expected it without names ...
[2]
$ restart --watch --all-outdated
dyknow restart: argument ...: not allowed with ...
[2]
""",
    "set": """
$ set cam rate 5
/cam: rate = 5; /cam reads it when it is restarted: dyknow restart /cam
$ set cam rate 6 --restart
/cam: rate = 6
$ info cam
...Parameters given at the spawn: rate=6...
$ set cam rate fast
dyknow: ...rate...
[1]
$ set cam rat 5
/cam: rat = 5; ...
dyknow: warning: ...declares no parameter 'rat'...
""",
}


@pytest.mark.parametrize("session", SESSIONS)
def test_sessions(chain, session):
    play(chain, SESSIONS[session])


def watch(client, monkeypatch, happens):
    """Let these things happen, one before each look; then the manager is gone."""

    def wait(condition):
        if not happens:
            raise ManagerUnreachable("the manager is gone")
        happens.pop(0)()
        client.core.look()
        model = client.get_graph()
        return model if condition(model) else None

    monkeypatch.setattr(client, "wait_for_model", wait)


def test_a_watched_nodelet_that_stays_outdated_is_restarted_once(chain, monkeypatch):
    """A shared nodelet in C++ runs its old library until its nodelet manager ends."""
    chain.host.code["pkg/Camera"] = "1"
    chain.core.restart("cam")
    chain.host.code["pkg/Camera"] = "2"
    chain.alter("/cam", kind=NodeletKind.CPP)
    restarted = []

    def restart(name):
        restarted.append(name)
        return Restarted((name,), "it is still outdated")

    monkeypatch.setattr(chain, "restart", restart)
    watch(chain, monkeypatch, [lambda: None] * 3)
    run(chain, "restart --watch cam")
    assert restarted == ["/cam"]


def test_what_is_saved_again_during_a_restart_is_run(chain, monkeypatch):
    chain.host.code["pkg/Camera"] = "1"
    chain.core.restart("cam")
    saved = ["2", "3"]
    restart = chain.restart

    def save():
        if saved:
            chain.host.code["pkg/Camera"] = saved.pop(0)

    def restarted(name):
        done = restart(name)
        save()
        chain.core.look()
        return done

    monkeypatch.setattr(chain, "restart", restarted)
    watch(chain, monkeypatch, [save, *[lambda: None] * 3])
    chain.calls.clear()
    run(chain, "restart --watch cam")
    assert [call for call, _ in chain.calls] == ["restart"] * 2
    assert not chain.get_graph().nodelet("/cam").outdated


def test_what_is_watched_is_restarted_once_for_each_change(chain, monkeypatch):
    code = chain.host.code
    code.update({"pkg/Camera": "1", "pkg/Relay": "1"})
    for name in ("cam", "/robot/relay"):
        chain.core.restart(name)
    happens = [
        lambda: code.update({"pkg/Camera": "2"}),
        lambda: None,
        lambda: (code.update({"pkg/Camera": "3"}), chain.host.broken.add("pkg/Camera")),
        lambda: None,
        lambda: (code.update({"pkg/Camera": "4"}), chain.host.broken.clear()),
        lambda: code.update({"pkg/Relay": "2"}),
    ]
    watch(chain, monkeypatch, happens)
    chain.calls.clear()
    done = run(chain, "restart --watch cam --json")
    assert done.code == UNREACHABLE
    assert [call for call, _ in chain.calls] == ["restart"] * 3
    found = [json.loads(line) for line in done.lines]
    assert [each["restarted"] for each in found] == [["/cam"], [], ["/cam"]]
    assert "invalid syntax" in done.err
