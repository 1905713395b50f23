# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Other programs rely on the names, types and order of the fields, and on the constants."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[3] / "dyknow_msgs"
EMPTY: tuple[str, ...] = ()

MESSAGES = {
    "PortConfig": ("string port", "string topic"),
    "Port": (
        "uint8 IN=0",
        "uint8 OUT=1",
        "string name",
        "uint8 direction",
        "string datatype",
        "string topic",
        "string[] tags",
        "float64 rate",
        "float64 latency",
    ),
    "PortStatistics": (
        "string port",
        "uint8 direction",
        "string topic",
        "uint64 messages",
        "uint64 dropped",
        "float64 rate",
        "duration mean_callback",
        "duration max_callback",
    ),
    "PortCount": (
        "string port",
        "uint8 direction",
        "uint64 messages",
        "bool latched",
        "float64 age",
    ),
    "NodeletCounts": ("string nodelet", "duration uptime", "PortCount[] ports"),
    "Parameter": ("string name", "string type", "string value"),
    "Transformation": (
        "string label",
        "string type",
        "string source",
        "uint32 cost",
        "Parameter[] parameters",
        "Port[] ports",
        "string specification",
        "bool isolated",
        "string node",
    ),
    "Nodelet": (
        "uint8 STARTING=0",
        "uint8 RUNNING=1",
        "uint8 LOST=2",
        "uint8 FAILED=3",
        "string name",
        "string transformation",
        "string manager",
        "bool is_protected",
        "bool isolated",
        "bool is_fixed",
        "uint8 state",
        "string detail",
        "Port[] ports",
        "string kind",
        "string host",
        "Parameter[] parameters",
    ),
    "NodeletChanges": ("string[] nodelets", "string[] details"),
    "NodeletConfig": ("string nodelet", "PortConfig[] config"),
    "Model": (
        "uint64 revision",
        "uint64 library_revision",
        "time stamp",
        "Nodelet[] nodelets",
        "Transformation[] transformations",
    ),
    "StreamStatus": (
        "uint8 PENDING=0",
        "uint8 ACTIVE=1",
        "uint8 DEGRADED=2",
        "uint8 RECOVERING=3",
        "uint8 FAILED=4",
        "uint8 RELEASED=5",
        "uint8 EXPIRED=6",
        "string claim_id",
        "string client_id",
        "string tag",
        "string topic",
        "string datatype",
        "uint8 state",
        "string detail",
        "string[] nodelets",
        "time expires",
        "string[] bindings",
    ),
    "StreamEvent": (
        "time stamp",
        "StreamStatus before",
        "StreamStatus after",
        "string reason",
    ),
}

ANSWER = ("bool success", "string message")
PLAN = ("string[] spawned", "string[] reused", "float64 cost")

SERVICES = {
    "GetConfig": (EMPTY, ("Port[] ports",)),
    "SetConfig": (("PortConfig[] config",), ANSWER),
    "Connect": (("NodeletConfig[] nodelets",), ANSWER),
    "GetStatistics": (
        EMPTY,
        (
            "duration uptime",
            "uint32 reconfigurations",
            "uint64 callback_errors",
            "PortStatistics[] ports",
        ),
    ),
    "GetCounts": (
        ("string[] nodelets",),
        ("NodeletCounts[] nodelets", "string kind", "string[] remains"),
    ),
    "RenewLease": (
        (
            "string uri",
            "float64 confirmed",
            "float64 duration",
            "string[] topics",
            "string[] nodelets",
        ),
        ("float64 clock",),
    ),
    "AddTransformation": (("string specification",), (*ANSWER, "string[] labels")),
    "RemoveTransformation": (("string label",), ANSWER),
    "Spawn": (
        (
            "string label",
            "string name",
            "bool is_protected",
            "bool isolated",
            "PortConfig[] config",
            "string manager",
            "Parameter[] parameters",
        ),
        ANSWER,
    ),
    "Destroy": (("string name",), ANSWER),
    "SetProtection": (("string name", "bool is_protected"), ANSWER),
    "GetModel": (EMPTY, ("Model model",)),
    "AcquireStream": (
        (
            "string tag",
            "string datatype",
            "string client_id",
            "string request_id",
            "string bond_id",
            "duration lease",
            "float64 max_silence",
            "string[] exclude",
            "bool dry_run",
            "float64 min_rate",
            "float64 max_age",
            "string[] prefer",
            "string[] avoid",
            "float64 budget",
        ),
        (
            "bool success",
            "uint8 OK=0",
            "uint8 NO_PLAN=1",
            "uint8 INVALID_TAG=2",
            "uint8 TYPE_MISMATCH=3",
            "uint8 SPAWN_FAILED=4",
            "uint8 TIMEOUT=5",
            "uint8 DENIED=6",
            "uint8 result",
            "string message",
            "string claim_id",
            "string topic",
            "string datatype",
            *PLAN,
            "time expires",
            "string plan",
            "string[] bindings",
            "float64 least_cost",
        ),
    ),
    "RenewStream": (("string claim_id", "duration lease"), (*ANSWER, "time expires")),
    "ReleaseStream": (("string claim_id",), ANSWER),
    "ReplanStream": (("string claim_id", "bool dry_run"), (*ANSWER, *PLAN, "string plan")),
    "FindBindings": (("string tag", "string datatype"), (*ANSWER, "string[] bindings")),
    "ListStreams": (EMPTY, ("StreamStatus[] streams",)),
}


def generated_fields(generated: Any) -> list[str]:
    types = [name.replace("dyknow_msgs/", "") for name in generated._slot_types]
    return [f"{kind} {name}" for kind, name in zip(types, generated.__slots__)]


def fields(lines: tuple[str, ...]) -> list[str]:
    return [line for line in lines if "=" not in line]


def constants(lines: tuple[str, ...]) -> dict[str, int]:
    pairs = (line.split()[1].split("=") for line in lines if "=" in line)
    return {name: int(value) for name, value in pairs}


def definition(path: Path) -> list[list[str]]:
    """The definition lines of a file without comments, a list for each part between ---."""
    parts: list[list[str]] = [[]]
    for line in path.read_text().splitlines():
        code = " ".join(line.split("#")[0].split())
        if code == "---":
            parts.append([])
        elif code:
            parts[-1].append(code)
    return parts


def test_there_are_no_other_messages_and_services() -> None:
    assert sorted(path.stem for path in FOLDER.glob("msg/*")) == sorted(MESSAGES)
    assert sorted(path.stem for path in FOLDER.glob("srv/*")) == sorted(SERVICES)


@pytest.mark.parametrize("name", MESSAGES)
def test_message_file(name: str) -> None:
    assert definition(FOLDER / "msg" / f"{name}.msg") == [list(MESSAGES[name])]


@pytest.mark.parametrize("name", SERVICES)
def test_service_file(name: str) -> None:
    parts = [list(part) for part in SERVICES[name]]
    assert definition(FOLDER / "srv" / f"{name}.srv") == parts


@pytest.mark.parametrize("name", MESSAGES)
def test_generated_message(name: str) -> None:
    message = getattr(importlib.import_module("dyknow_msgs.msg"), name)
    assert generated_fields(message) == fields(MESSAGES[name])
    for constant, value in constants(MESSAGES[name]).items():
        assert getattr(message, constant) == value


@pytest.mark.parametrize("name", SERVICES)
def test_generated_service(name: str) -> None:
    services = importlib.import_module("dyknow_msgs.srv")
    for suffix, lines in zip(("Request", "Response"), SERVICES[name]):
        part = getattr(services, name + suffix)
        assert generated_fields(part) == fields(lines)
        for constant, value in constants(lines).items():
            assert getattr(part, constant) == value


@pytest.mark.parametrize(
    "path", sorted([*FOLDER.glob("msg/*.msg"), *FOLDER.glob("srv/*.srv")]), ids=lambda p: p.name
)
def test_every_field_has_a_comment(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert lines[0].startswith("# "), "a file begins with what it is for"
    for line in lines:
        if line.strip() and line != "---":
            assert "#" in line and line.split("#", 1)[1].strip(), line
