# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The page about converting nodes counts the changes; so does this."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "examples" / "convert"
#: Nodes, each with the names of its two files.
NODES = {
    "ball finder": ("before.py", "after.py"),
    "ball bearing": ("bearing_before.py", "bearing_after.py"),
    "velocity guard": ("guard_before.py", "guard_after.py"),
}


def lines(name):
    return (EXAMPLE / name).read_text().splitlines()


def changes(before, after):
    """Count the lines of a node that are there, stay, are replaced one by one, removed, added."""
    stay = replaced = removed = added = 0
    for kind, i, j, k, m in difflib.SequenceMatcher(None, before, after).get_opcodes():
        if kind == "equal":
            stay += j - i
            continue
        both = min(j - i, m - k)
        replaced += both
        removed += j - i - both
        added += m - k - both
    return [len(before), stay, replaced, removed, added]


def test_the_page_tells_the_numbers_of_the_files():
    page = (ROOT / "doc" / "convert_a_node.rst").read_text()
    said = re.search(
        r"Of (\d+) lines,\s+(\d+) stay as they are,\s+(\d+) are edited in place"
        r"\s+and\s+(\d+) are removed;\s+(\d+) (?:is|are) new",
        page,
    )
    assert said is not None
    assert [int(number) for number in said.groups()] == changes(*map(lines, NODES["ball finder"]))


#: Lines of the nodelet that search and replace does not produce.
INIT = ["    def on_init(self):", "        self.nh = dyknow.NodeHandle(self.node_handle)"]
BY_HAND = {
    "ball finder": ["import dyknow", "class BallFinder(dyknow.Nodelet):", *INIT],
    "ball bearing": ["import dyknow", "class BallBearing(dyknow.Nodelet):", *INIT],
    "velocity guard": [
        "import copy",
        "import dyknow",
        "class VelocityGuard(dyknow.Nodelet):",
        *INIT,
        '        period = self.nh.Duration(1.0 / self.nh.get_param("~rate", 20))',
        "        self.timer = self.nh.Timer(period, self.step)",
        "        command = copy.deepcopy(command)",
        "    def step(self, event):",
    ],
}


@pytest.mark.parametrize("node", NODES)
def test_most_edits_are_search_and_replace(node):
    before, after = map(lines, NODES[node])
    translated = {
        re.sub(r"rospy\.|message_filters\.(?=Subscriber)", "self.nh.", line).strip()
        for line in before
    }
    assert [line for line in after if line.strip() not in translated] == BY_HAND[node]
