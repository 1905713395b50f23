"""The page about converting a node says how much changes; that is counted here."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "examples" / "convert"


def lines(name):
    return (EXAMPLE / name).read_text().splitlines()


def changes():
    """Lines of before.py that stay, that are replaced one by one, removed, and added."""
    before, after = lines("before.py"), lines("after.py")
    stay = replaced = removed = added = 0
    for kind, i, j, k, m in difflib.SequenceMatcher(None, before, after).get_opcodes():
        if kind == "equal":
            stay += j - i
            continue
        both = min(j - i, m - k)
        replaced += both
        removed += j - i - both
        added += m - k - both
    return {"stay": stay, "replaced": replaced, "removed": removed, "added": added}


def test_the_page_tells_the_numbers_of_the_files():
    page = (ROOT / "doc" / "convert_a_node.rst").read_text()
    said = re.search(
        r"Of (\d+) lines,\s+(\d+) stay as they are,\s+(\d+) are edited in place"
        r"\s+and\s+(\d+) go;\s+(\d+) (?:is|are) new",
        page,
    )
    assert said is not None
    counted = changes()
    assert [int(number) for number in said.groups()] == [
        len(lines("before.py")),
        counted["stay"],
        counted["replaced"],
        counted["removed"],
        counted["added"],
    ]


def test_most_edits_are_search_and_replace():
    before, after = lines("before.py"), lines("after.py")
    translated = [line.replace("rospy.", "self.nh.") for line in before]
    rest = [line for line in after if line not in translated]
    assert rest == [
        "import dyknow",
        "class BallFinder(dyknow.Nodelet):",
        "    def on_init(self):",
        "        self.nh = dyknow.NodeHandle(self.node_handle)",
    ]
