# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a release sets in several files is the same in all of them."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import yaml

import dyknow

ROOT = Path(__file__).resolve().parents[2]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())


def in_package(path: str, tag: str) -> str | None:
    return ElementTree.parse(ROOT / path).getroot().findtext(tag)


def test_one_version():
    assert {
        in_package("package.xml", "version"),
        in_package("dyknow_msgs/package.xml", "version"),
        CITATION["version"],
        dyknow.__version__,
    } == {dyknow.__version__}


def test_the_changelog_has_the_version_or_what_comes():
    heads = re.findall(r"^(\S.*)\n-+$", (ROOT / "CHANGELOG.rst").read_text(), re.M)
    assert heads[0] == "Forthcoming" or heads[0].startswith(f"{dyknow.__version__} (")


def test_one_licence():
    assert {
        in_package("package.xml", "license"),
        in_package("dyknow_msgs/package.xml", "license"),
        CITATION["license"],
    } == {"BSD-3-Clause"}


def test_the_paper_is_cited_alike():
    title = " ".join(CITATION["preferred-citation"]["title"].split())
    for page in ("README.md", "doc/index.rst", "dyknow/__init__.py"):
        text = re.sub(r"[\s>]+", " ", (ROOT / page).read_text())
        assert title in text, page
