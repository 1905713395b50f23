# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The manager's reports on /diagnostics, and how the example groups them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, List

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from dyknow.model.graph import Model, NodeletStatus, PortState, State
from dyknow.model.hosts import HostStatus
from dyknow.model.streams import ClaimState, StreamStatus
from dyknow.ros.manager.diagnostics import Counted, statuses

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
PORTS = (PortState("out", "out", "std_msgs/Header", "/s"),)
NODELET = NodeletStatus(
    "/camera", "camera", "/nodelet_manager", False, False, False, State.RUNNING, "", PORTS
)
CLAIM = StreamStatus(
    "ab12",
    "/client",
    "Ball(?c)",
    "/s",
    "std_msgs/Header",
    ClaimState.ACTIVE,
    "",
    ("/camera",),
    0.0,
)


def reported(
    nodelet: NodeletStatus = NODELET, claim: StreamStatus = CLAIM, trouble: str = ""
) -> List[Any]:
    return statuses("robot/dyknow_manager", Model(1, 1, (nodelet,)), [claim], trouble)


def values(status: Any) -> Dict[str, str]:
    return {each.key: each.value for each in status.values}


def test_all_is_well_but_for_the_disk():
    manager = reported(trouble="the disk is full")[0]
    assert (manager.level, manager.message) == (WARN, "the disk is full")
    manager, nodelet, claim = reported()
    assert {manager.level, nodelet.level, claim.level} == {OK}
    assert manager.name == "robot/dyknow_manager: manager"
    assert values(manager).items() >= {"nodelets": "1", "running": "1", "claims": "1"}.items()
    assert (nodelet.name, nodelet.message) == ("robot/dyknow_manager: nodelet /camera", "running")
    assert values(nodelet).items() >= {"node": "/nodelet_manager", "port out": "/s"}.items()
    assert claim.name == "robot/dyknow_manager: claim ab12 Ball(?c)"
    assert values(claim).items() >= {"topic": "/s", "nodelets": "/camera"}.items()


@pytest.mark.parametrize(
    ("state", "detail", "level"),
    [
        (State.STARTING, "", WARN),
        (State.RUNNING, "a callback has been running for 9 s", WARN),
        (State.LOST, "its process has died", ERROR),
        (State.FAILED, "not loaded", ERROR),
    ],
)
def test_nodelets(state, detail, level):
    manager, nodelet, _ = reported(replace(NODELET, state=state, detail=detail))
    assert (nodelet.level, nodelet.message) == (level, detail or "starting")
    assert values(manager)["running"] == str(int(state is State.RUNNING))


@pytest.mark.parametrize(
    ("counted", "level", "message"),
    [
        (Counted(7), OK, "running"),
        (Counted(7, lately=2), WARN, "dropped 2 messages"),
        (Counted(7, 3), OK, "running"),
        (Counted(7, 3, "in-port 'in': KeyError: 'x'"), WARN, "in-port 'in': KeyError: 'x'"),
    ],
)
def test_drops_warn_while_they_grow_and_errors_for_a_while(counted, level, message):
    found = statuses("manager", Model(1, 1, (NODELET,)), [], "", {"/camera": counted})[1]
    assert (found.level, found.message, values(found)["dropped"]) == (level, message, "7")
    assert values(found)["callback errors"] == str(counted.errors)


@pytest.mark.parametrize("state", list(ClaimState))
def test_claims(state):
    found = reported(claim=replace(CLAIM, state=state, detail="why"))[2:]
    levels = {ClaimState.ACTIVE: OK, ClaimState.FAILED: ERROR}
    expected = [] if state.ended else [(levels.get(state, WARN), "why")]
    assert [(each.level, each.message) for each in found] == expected


@pytest.mark.parametrize(
    ("host", "level", "message"),
    [
        (HostStatus("rover"), OK, "answers"),
        (HostStatus("rover", offset=0.15, error=0.06), OK, "answers"),
        (HostStatus("rover", offset=-0.15, error=0.04), WARN, "its clock differs by -0.150 s"),
        (HostStatus("rover", is_away=True), WARN, "none of its processes answers"),
    ],
)
def test_hosts(host, level, message):
    *_, found = statuses("manager", Model(1, 1, ()), [], "", hosts=[host], max_offset=0.1)
    assert (found.name, found.level, found.message) == ("manager: host rover", level, message)
