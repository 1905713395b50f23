# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The page on security names every limit with the value that the code has."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from dyknow.guards import Guards
from dyknow.manager.specifications.limits import SpecificationLimits

PAGE = Path(__file__).parents[2] / "doc" / "security.md"


def test_the_page_on_security_lists_all_limits():
    rows = re.findall(r"^\| `(\w+)`[^|]*\| (\d+) \|", PAGE.read_text(encoding="utf-8"), re.M)
    numbers = [
        (field.name, str(field.default))
        for kind in (Guards, SpecificationLimits)
        for field in dataclasses.fields(kind)
        if type(field.default) is int
    ]
    assert sorted(rows) == sorted(numbers)
