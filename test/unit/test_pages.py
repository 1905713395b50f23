# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The pages are true to the code: its API, its limits, and the tests that hold promises."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from pathlib import Path

import pytest

from dyknow.guards import Guards
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow_benchmark.main import MEASUREMENTS

ROOT = Path(__file__).resolve().parents[2]
API, STREAMS, REQUIREMENTS, SECURITY = (
    (ROOT / "doc" / page).read_text(encoding="utf-8")
    for page in ("api.rst", "streams.rst", "requirements.rst", "security.md")
)
SHOWN = re.findall(r"^\.\. auto\w+:: (\S+)$(?:\n +:members:(.*))?", API + STREAMS, re.MULTILINE)


def find(path):
    """Return the module, class or function of a dotted path."""
    parts = path.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for name in parts[count:]:
            found = getattr(found, name)
        return found
    raise AssertionError(f"{path} is on the page, but not in DyKnow")


def members(shown, names):
    if names.strip():
        return [name.strip() for name in names.split(",")]
    own = [
        name
        for name, value in vars(shown).items()
        if inspect.isroutine(value) or isinstance(value, (property, type))
    ]
    if inspect.ismodule(shown):
        own = [name for name in own if getattr(shown, name).__module__ == shown.__name__]
    return [name for name in own if not name.startswith("_")]


@pytest.mark.parametrize(("path", "names"), SHOWN, ids=[path for path, _ in SHOWN])
def test_everything_on_the_page_of_the_api_has_a_docstring(path, names):
    shown = find(path)  # autodoc omits members without one
    described = [shown, *(getattr(shown, name) for name in members(shown, names))]
    assert [str(it) for it in described if not inspect.getdoc(it)] == []


def test_the_page_on_security_lists_all_limits():
    rows = re.findall(r"^\| `(\w+)`[^|]*\| (\d+) \|", SECURITY, re.M)
    numbers = [
        (field.name, str(field.default))
        for kind in (Guards, SpecificationLimits)
        for field in dataclasses.fields(kind)
        if type(field.default) is int
    ]
    assert sorted(rows) == sorted(numbers)


def test_each_promise_of_security_names_a_test():
    text = SECURITY.partition("## What DyKnow does")[2].partition("\n## ")[0]
    paragraphs = re.split(r"\n\n|\n(?=\* )", text)
    promises = [each for each in paragraphs if re.match(r"\*\*|\* ", each)]
    assert len(promises) > 10
    assert [each for each in promises if "<!-- test: " not in each] == []


@pytest.mark.parametrize(
    "test",
    sorted(
        {
            *re.findall(r"<!-- test: (\S+) -->", SECURITY),
            *(f"test/{each}" for each in re.findall(r"``(unit/[\w/.]+)``", REQUIREMENTS)),
            *(f"test/ros/{each}" for each in re.findall(r"``([\w/]+\.test)``", REQUIREMENTS)),
        }
    ),
)
def test_each_test_that_a_page_names_is_there(test):
    path, *names = test.split("::")
    assert (ROOT / path).exists()
    for name in names:
        assert re.search(rf"^ *(class|def) {name}\b", (ROOT / path).read_text("utf-8"), re.M), name


def test_each_benchmark_of_the_requirements_is_there():
    named = re.findall(r"``benchmark (\w+)``", REQUIREMENTS)
    assert named and set(named) <= set(MEASUREMENTS)
