# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Other programs rely on the names, types and order of the fields, and on the constants.

The checksum of ROS is made from just these, and from those of the messages inside.
"""

from __future__ import annotations

import importlib
from pathlib import Path

import genmsg
import genmsg.gentools
import pytest
import rospkg

FOLDER = Path(__file__).resolve().parents[3] / "dyknow_msgs"

CHECKSUMS = {
    "msg/PortConfig": "f4f01ed958e0e69f2e7e1b228cf3f18e",
    "msg/Port": "833aa6987825b9b3e56372b66cf36034",
    "msg/PortStatistics": "8ca914ff2d0bb96a4b1e3fa38c06a9f7",
    "msg/PortCount": "125e55bf98f6edddb4d50f909d32755a",
    "msg/NodeletCounts": "7641de04166209f0689283c6c8ddc407",
    "msg/Counts": "41e595f72bf8635a75c35a735f9ac8a9",
    "msg/Parameter": "2a06900160ca5ec95f57a5ec28eaaa33",
    "msg/Transformation": "7c24a1c43fdcd74ac24da278f0c5a365",
    "msg/Nodelet": "8996b71fc354c3d642ddafed2ab2fdcb",
    "msg/NodeletChanges": "2ba6b3a8e365f3b8757a209c5a809cc8",
    "msg/Guards": "c3ff0fe47fe2305aa3d3da49f6e98c2b",
    "msg/HandedTopic": "bc0193d668b6d8c1cefe0f6c538a3647",
    "msg/NodeletPorts": "07c38c94d603a6036a8a24f493bf705b",
    "msg/NodeletConfig": "d74996917a76170ce31a8804c223d741",
    "msg/Model": "a6674955af47d83032e8c9c16d3156d6",
    "msg/StreamStatus": "37a27e4a9e4def2f5d02a8f6b620408c",
    "msg/StreamEvent": "a516e6fd9112b91519932d980a85c920",
    "msg/Machine": "30253d1065697a1d5ec07dde1abedebf",
    "msg/HostStatus": "dcb418bd26dcf1767cd56b74fee09dd6",
    "msg/Verdict": "a85b746c8eec1aacfc72e2ec37792a5b",
    "srv/GetConfig": "c4f79754ec1a2cde67723ec0305318f8",
    "srv/SetConfig": "e12bebb6a7abf5ff9df9d7c23943a047",
    "srv/Connect": "991cf245e78188f1e46e5b6a5c13b61e",
    "srv/GetStatistics": "cbff6e580b0ddb2ad1bd16d63dfe3daf",
    "srv/Poll": "b654ee884cff67da3c15e0ec7d1d6920",
    "srv/HandOver": "a0f10ee59d188087375d946ace369e8d",
    "srv/AddTransformation": "da1e77c6fbc632ebf1004dfba76f5918",
    "srv/RemoveTransformation": "d74f6627fb1a814ad4bd7b097c68231c",
    "srv/Spawn": "72f3dae8304bf4bd46e25b1026736a25",
    "srv/Destroy": "d82dc6474dd88dad5e1615ab1b2ca74c",
    "srv/SetProtection": "85c5b27d9c9dd56f6fa3c25faac7dc4c",
    "srv/Restart": "cbde73b23c29b2878209d07360910b63",
    "srv/SetParameter": "5878252b231bd1e0483be0caba4760c8",
    "srv/GetModel": "c572abaf2202ca669154eaa0068924a5",
    "srv/AcquireStream": "e736d267134bf16b636411fbc07bd1c1",
    "srv/RenewStream": "f9ba79302b15003afdf785830dde7ea1",
    "srv/ReleaseStream": "9db6d3aea8e74e927023159bf69059b8",
    "srv/ReplanStream": "8b99d152281ef33d934adbc7c8e19c5d",
    "srv/PlanStream": "d4bcd7776af3929eae44df49f288060d",
    "srv/FindBindings": "86ae714e3f9217402fbc21a339b12dc9",
    "srv/ListHosts": "037d37b88378554dfc7b4e8337ad19f5",
    "srv/ListStreams": "e70aded8668682e86b04b2c8847caa61",
}


def checksum_of_file(name: str) -> str:
    """The checksum that the file would be given now; the generated code may be older."""
    kind, _, message = name.partition("/")
    context = genmsg.MsgContext.create_default()
    load = {"msg": genmsg.load_msg_by_type, "srv": genmsg.load_srv_by_type}[kind]
    spec = load(context, f"dyknow_msgs/{message}", {"dyknow_msgs": [str(FOLDER / kind)]})
    std_msgs = Path(rospkg.RosPack().get_path("std_msgs")) / "msg"
    folders = {"dyknow_msgs": [str(FOLDER / "msg")], "std_msgs": [str(std_msgs)]}
    genmsg.msg_loader.load_depends(context, spec, folders)
    return str(genmsg.gentools.compute_md5(context, spec))


def test_there_are_no_other_messages_and_services() -> None:
    files = [*FOLDER.glob("msg/*"), *FOLDER.glob("srv/*")]
    assert {f"{each.parent.name}/{each.stem}" for each in files} == set(CHECKSUMS)


@pytest.mark.parametrize("name", CHECKSUMS)
def test_a_message_is_as_programs_know_it(name: str) -> None:
    kind, _, message = name.partition("/")
    generated = getattr(importlib.import_module(f"dyknow_msgs.{kind}"), message)
    assert generated._md5sum == checksum_of_file(name) == CHECKSUMS[name]


@pytest.mark.parametrize(
    "path", sorted([*FOLDER.glob("msg/*.msg"), *FOLDER.glob("srv/*.srv")]), ids=lambda p: p.name
)
def test_every_field_has_a_comment(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert lines[0].startswith("# "), "a file begins with what it is for"
    for line in lines:
        if line.strip() and line != "---":
            assert "#" in line and line.split("#", 1)[1].strip(), line
