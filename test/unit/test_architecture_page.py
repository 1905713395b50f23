# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The page on the architecture is true: its modules exist, its rooms are those of the imports."""

from __future__ import annotations

import re
from pathlib import Path
from typing import List

import pytest

try:
    import tomllib
except ModuleNotFoundError:  # before Python 3.11
    import tomli as tomllib  # type: ignore[no-redef]

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "doc" / "architecture.rst").read_text()
MODULES = sorted(set(re.findall(r"\bdyknow(?:_[a-z]+)?(?:\.[a-z_]+)+", PAGE)))
#: What the page names that is no module: attributes of the package, which are loaded lazily.
ATTRIBUTES = ("dyknow.acquire",)


@pytest.mark.parametrize("module", [each for each in MODULES if each not in ATTRIBUTES])
def test_each_module_of_the_page_exists(module):
    path = ROOT / module.replace(".", "/")
    assert path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def layers() -> List[List[str]]:
    """The first contract's layers, without the small modules below all rooms."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    rows = [re.findall(r"[\w.]+", row) for row in contracts["contracts"][0]["layers"]]
    rooms = [[each for each in row if (ROOT / each.replace(".", "/")).is_dir()] for row in rows]
    return [sorted(row) for row in rooms if row]


def test_the_rooms_are_those_that_the_imports_are_held_to():
    drawing = PAGE.split(".. layers-begin")[1].split(".. layers-end")[0].split("text\n")[1]
    drawn = [sorted(line.split()) for line in drawing.splitlines() if line.strip()]
    assert drawn == layers()


def test_each_room_is_described():
    for package in (ROOT / "dyknow").iterdir():
        if (package / "__init__.py").is_file():
            assert f"dyknow.{package.name}" in PAGE
