# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The page on security promises only what a test holds, and names that test beside it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "doc" / "security.md").read_text(encoding="utf-8")
PROMISES = TEXT.partition("## What DyKnow does")[2].partition("\n## ")[0]


def test_each_promise_names_a_test():
    paragraphs = re.split(r"\n\n|\n(?=\* )", PROMISES)
    promises = [each for each in paragraphs if re.match(r"\*\*|\* ", each)]
    assert len(promises) > 10
    assert [each for each in promises if "<!-- test: " not in each] == []


@pytest.mark.parametrize("test", sorted(set(re.findall(r"<!-- test: (\S+) -->", TEXT))))
def test_each_test_exists(test):
    path, *names = test.split("::")
    text = (ROOT / path).read_text(encoding="utf-8")
    for name in names:
        assert re.search(rf"^ *(class|def) {name}\b", text, re.M), name
