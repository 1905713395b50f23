# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Damaged bags, and files that are not bags: one error for each, whatever rosbag raises."""

from __future__ import annotations

import random

import pytest
import rosbag
import rospy
from std_msgs.msg import String

from dyknow.errors import DyKnowError
from dyknow.formulas import parse
from dyknow.ros.formulas.bags import Bag
from dyknow.ros.shell.story import moments

FORMULA = parse('a.data == "x"')


def read(path):
    """Read a bag as ``why`` and as ``holds`` do; returns the errors."""
    errors = []
    for reading in (
        lambda: moments(path),
        lambda: list(Bag(path).verdicts(FORMULA.monitor(), {"a": "/a"}, lambda seconds: None)),
    ):
        try:
            reading()
        except DyKnowError as error:
            errors.append(str(error))
    return errors


@pytest.mark.parametrize("seed", range(30))
def test_a_damaged_bag_is_read_or_refused(tmp_path, seed):
    chance, path = random.Random(seed), str(tmp_path / "run.bag")
    with rosbag.Bag(path, "w") as bag:
        for number in range(20):
            bag.write("/a", String(str(number)), rospy.Time(1 + number))
    with open(path, "r+b") as file:
        size = file.seek(0, 2)
        if seed % 3 == 0:
            file.truncate(chance.randrange(size))
        for _ in range(3):
            file.seek(chance.randrange(size))
            file.write(bytes([chance.randrange(256)]))
    assert all(path in error for error in read(path))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x89PNG\r\n", "is damaged, or is no bag (UnicodeDecodeError"),
        (b"", "cannot be read"),
        (b"text\n", "cannot be read"),
        (None, "cannot be read: [Errno 2] No such file"),
    ],
)
def test_a_file_that_is_no_bag_is_refused(tmp_path, content, said):
    path = tmp_path / "run.bag"
    if content is not None:
        path.write_bytes(content)
    errors = read(str(path))
    assert len(errors) == 2 and all(said in error for error in errors)
