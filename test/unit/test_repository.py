# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Facts that are written in several places agree: releases, names, exceptions."""

from __future__ import annotations

import ast
import inspect
import re
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path

import yaml

import dyknow
from dyknow import errors

ROOT = Path(__file__).resolve().parents[2]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
PACKAGES = ("dyknow", "dyknow_rqt", "dyknow_demo", "dyknow_benchmark")


def in_packages(tag: str) -> set[str | None]:
    paths = (ROOT / "package.xml", ROOT / "dyknow_msgs" / "package.xml")
    return {ElementTree.parse(path).getroot().findtext(tag) for path in paths}


def test_one_version_and_one_licence() -> None:
    assert in_packages("version") | {CITATION["version"]} == {dyknow.__version__}
    assert in_packages("license") | {CITATION["license"]} == {"BSD-3-Clause"}


def test_the_changelog_has_the_version_or_what_comes() -> None:
    heads = re.findall(r"^(\S.*)\n-+$", (ROOT / "CHANGELOG.rst").read_text(), re.M)
    assert heads[0] == "Forthcoming" or heads[0].startswith(f"{dyknow.__version__} (")


def test_the_paper_is_cited_alike() -> None:
    title = " ".join(CITATION["preferred-citation"]["title"].split())
    for page in ("README.md", "doc/index.rst", "dyknow/__init__.py"):
        text = re.sub(r"[\s>]+", " ", (ROOT / page).read_text())
        assert title in text, page


def test_a_public_class_name_stands_for_one_thing() -> None:
    found: dict[str, list[str]] = defaultdict(list)
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for statement in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(statement, ast.ClassDef) and not statement.name.startswith("_"):
                    found[statement.name].append(str(path.relative_to(ROOT)))
    assert not {name: paths for name, paths in found.items() if len(paths) > 1}


def drawn() -> dict[str, str]:
    """By name, the parent that the drawing gives each exception."""
    assert errors.__doc__ is not None
    parents: dict[str, str] = {}
    above: list[str] = ["Exception"]
    for line in errors.__doc__.splitlines():
        found = re.match(r"    ((?:│   |    )*)(├── |└── |)([A-Z]\w+(?:, \w+)*)$", line)
        if found:
            depth = len(found.group(1) + found.group(2)) // 4 + 1
            for name in found.group(3).split(", "):
                above[depth:] = [name]
                parents[name] = above[depth - 1]
    return parents


def test_the_drawing_of_exceptions_shows_each_below_its_parent() -> None:
    classes = inspect.getmembers(errors, inspect.isclass)
    real = {name: each for name, each in classes if issubclass(each, errors.DyKnowError)}
    assert drawn() == {name: each.__bases__[0].__name__ for name, each in real.items()}
