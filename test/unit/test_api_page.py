# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Everything that the page of the Python API shows has a docstring; autodoc would omit it."""

import importlib
import inspect
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "doc" / "api.rst"
SHOWN = re.findall(r"^\.\. auto\w+:: (\S+)$(?:\n +:members:(.*))?", PAGE.read_text(), re.MULTILINE)


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
def test_everything_on_the_page_has_a_docstring(path, names):
    shown = find(path)
    described = [shown, *(getattr(shown, name) for name in members(shown, names))]
    lacking = [getattr(it, "__name__", str(it)) for it in described if not inspect.getdoc(it)]
    assert not lacking
