# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas against the types of messages: fields and constants that exist, values that compare."""

from __future__ import annotations

import pytest

from dyknow.errors import FormulaError
from dyknow.formulas import MessageType, parse

TYPES = {
    each.name: each
    for each in (
        MessageType(
            "robot_msgs/Battery",
            {
                "header": "Header",
                "percentage": "float32",
                "supply_status": "uint8",
                "cells": "float32[]",
                "present": "bool",
                "location": "string",
            },
            frozenset({"SUPPLY_STATUS_CHARGING", "SUPPLY_STATUS_FULL", "OTHER"}),
        ),
        MessageType(
            "std_msgs/Header",
            {"seq": "uint32", "stamp": "time", "frame_id": "string"},
            frozenset(),
        ),
        MessageType("robot_msgs/Path", {"points": "robot_msgs/Point[]"}, frozenset()),
        MessageType("robot_msgs/Point", {"x": "float64", "y": "float64"}, frozenset()),
        MessageType("std_msgs/Bool", {"data": "bool"}, frozenset()),
        MessageType("dyknow_msgs/Verdict", {"value": "uint8"}, frozenset({"TRUE", "UNKNOWN"})),
    )
}
PORTS = {
    "battery": TYPES["robot_msgs/Battery"],
    "path": TYPES["robot_msgs/Path"],
    "flag": TYPES["std_msgs/Bool"],
    "charged": TYPES["dyknow_msgs/Verdict"],
    "any": None,
}


@pytest.mark.parametrize(
    "text",
    [
        "battery.percentage > 0.2",
        "battery.supply_status == CHARGING",
        "battery.supply_status == SUPPLY_STATUS_FULL or battery.supply_status == OTHER",
        "battery.cells[0] == OTHER",
        "battery.header.stamp > 3 s",
        "battery.cells[2] > 1 and len(battery.cells) > 2 and norm(battery.cells) < 9",
        "battery.present and battery.present != false and flag and charged",
        "battery.location == 'bay'",
        "path.points[0].x - path.points[1].x < 1 and norm(path.points[0]) < 2",
        "any.thing.at[3].all > 2 and any.flag",
        "age(battery) < 1 and rate(path) > 2 and present(any)",
        "every ?c (battery.percentage > 0.2)",
    ],
)
def test_what_fits(text: str) -> None:
    parse(text).check(PORTS, TYPES.get)


@pytest.mark.parametrize(
    ("text", "column", "problem"),
    [
        ("batery.percentage > 1", 1, "there is no port 'batery'; did you mean battery?"),
        ("zebra.x > 1", 1, "there is no port 'zebra'; there are: battery, path, flag, charged"),
        (
            "1 < battery.percntage",
            5,
            "robot_msgs/Battery has no field 'percntage'; did you mean percentage? its fields "
            "are: header, percentage, supply_status, cells, present, location",
        ),
        ("battery.header.x > 1", 1, "std_msgs/Header has no field 'x'; its fields are: seq, "),
        ("battery.percentage.x > 1", 1, "'battery.percentage' has no fields: it is a number"),
        ("battery.percentage[0] > 1", 1, "'battery.percentage' has no index: it is a number"),
        (
            "battery.cells.x > 1",
            1,
            "it is an array float32[]; write an index, as battery.cells[0]",
        ),
        ("path.points[0].z > 1", 1, "robot_msgs/Point has no field 'z'"),
        ("battery.cells > 1", 1, "'battery.cells' cannot be compared: it is an array float32[]"),
        ("battery == 1", 1, "it is a robot_msgs/Battery: compare a field, one of header"),
        ("battery", 1, "'battery' is not true or false: it is a robot_msgs/Battery"),
        ("battery.percentage and flag", 1, "'battery.percentage' is not true or false"),
        ("battery.percentage == 'full'", 1, "a number is compared with a text"),
        ("battery.location > 'a'", 1, "a text or flag is compared with '==' or '!='"),
        ("battery.location + 1 > 2", 1, "'+' takes numbers, but 'battery.location' is a text"),
        ("abs(battery.location) > 2", 1, "abs cannot be applied to 'battery.location', a text"),
        ("norm(battery.percentage) > 2", 1, "norm cannot be applied to 'battery.percentage'"),
        ("norm(path) > 2", 1, "'path', a robot_msgs/Path: it takes arrays of numbers, and"),
        ("norm(path.points) > 2", 1, "norm cannot be applied to 'path.points', an array"),
        ("len(battery.percentage) > 2", 1, "len cannot be applied to 'battery.percentage'"),
        (
            "battery.cells[0] == OTHR",
            21,
            "robot_msgs/Battery has no constant 'OTHR'; did you mean OTHER?",
        ),
        (
            "battery.supply_status == CHARGIN",
            26,
            "robot_msgs/Battery has no constant 'CHARGIN'",
        ),
    ],
)
def test_what_does_not_fit(text: str, column: int, problem: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse(text).check(PORTS, TYPES.get)
    assert problem in caught.value.problem, caught.value
    assert caught.value.column == column, caught.value


def test_a_monitor_checks_the_first_message_of_a_port() -> None:
    class Battery:
        _type = "robot_msgs/Battery"
        __slots__ = ["percentage"]
        _slot_types = ["float32"]

    with pytest.raises(FormulaError, match="has no field 'percntage'; did you mean percentage"):
        parse("battery.percntage > 0.2").monitor().feed("battery", Battery(), 1.0)
