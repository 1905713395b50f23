# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`list --hosts`, `spawn --host`, and hosts in files of wirings."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import pytest
from unit.cli.fake_client import FakeClient, play, run
from unit.manager.world import World

from dyknow.cli.output import host_table
from dyknow.model.hosts import ClockOffset, HostStatus, Machine

ROVER = "/rover_manager"


@pytest.fixture(name="client")
def _client() -> FakeClient:
    client = FakeClient(World())
    client.host.machine = "desk"
    client.host.add(ROVER, machine="rover")
    process = client.host.processes[ROVER]
    stated = Machine(4, 0.25, 0.5), ClockOffset(-0.1234, 0.0002)
    process.state = replace(process.state, machine=stated[0], clock=stated[1])
    client.core.look()
    return client


def test_a_session(client: FakeClient) -> None:
    play(
        client,
        """
$ spawn camera c --host rover
spawned /c from camera in /rover_manager
$ spawn relay r --host desk
spawned /r from relay in /fake_0
$ list --hosts
HOST   ADDRESS  STATE  LOAD  MEMORY            CLOCK  MANAGERS        NODELETS
desk   -        here      -       -              own  /fake_0                1
rover  -        here    25%     50%  -123.4 ms ± 0.2  /rover_manager         1
$ spawn camera d --host rovr
dyknow: unknown host 'rovr'; known: desk, rover
[1]
$ spawn camera d --host rover --manager /fake_1
dyknow spawn: --host and --manager both say where it is to run; expected one of them ...
[2]
$ list --hosts -l
dyknow list: --hosts lists hosts; expected it without a namespace and --long ...
[2]
""",
    )


def test_hosts_as_json(client: FakeClient) -> None:
    desk, rover = run(client, "list --hosts --json").json["hosts"]
    assert (desk["own"], desk["load"], desk["offset"]) == (True, None, None)
    expected = {"name": "rover", "away": False, "cores": 4, "load": 0.25, "offset": -0.1234}
    assert rover.items() >= expected.items()


def test_a_host_that_is_away() -> None:
    host = HostStatus("rover", is_away=True, lasts=60.0, pause=31.0, offset=math.nan)
    now = time.mktime((2026, 11, 26, 12, 1, 0, 0, 0, -1))
    _, line, detail = host_table([host], now)
    assert line.split() == ["rover", "-", "away", "since", "12:00:00", *["-"] * 4, "0"]
    assert detail.startswith("rover: it was away repeatedly; for 31 s nothing new is placed")


def test_the_host_is_saved_and_loaded(
    client: FakeClient, tmp_path: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(str(tmp_path))
    run(client, "spawn camera c --host rover")
    run(client, "save w.xml")
    with open("w.xml") as file:
        text = file.read()
    assert '<nodelet name="/c" transformation="camera" host="rover"/>' in text
    run(client, "destroy c")
    assert run(client, "load w.xml").code == 0
    assert client.core.graph.get("/c").pinned == "rover"
    run(client, "destroy c")
    client.host.cut(ROVER)
    client.core.look()
    outcome = run(client, "load w.xml")
    assert outcome.code == 1 and "its host 'rover' does not answer" in outcome.err
    assert run(client, "load w.xml --any-manager").code == 0
    assert client.core.graph.get("/c").host == "desk"
    with open("both.xml", "w") as file:
        file.write(text.replace('host="rover"', 'host="rover" manager="/m"'))
    assert "expected one of them" in run(client, "load both.xml --dry-run").err
