# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Where modules come from, and which need a library."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Callable, Iterator, List

import pytest

from dyknow.nodelet.importer import Importer
from dyknow.nodelet.module_files import (
    Dependents,
    is_standard,
    reached_from,
    script_file,
    source_files,
)

Write = Callable[..., Path]


def parts(name: str) -> List[str]:
    """The parts of a path: `pack____init__` is `pack/__init__`."""
    parts = name.replace("____init__", "__@").split("__")
    return [part.replace("@", "__init__") for part in parts]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """Writes files into a folder on Python's path, and returns the folder."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def files(**texts: str) -> Path:
        for name, text in texts.items():
            file = tmp_path.joinpath(*parts(name)).with_suffix(".py")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        importlib.invalidate_caches()
        return tmp_path

    yield files


@pytest.mark.parametrize("name", ["os", "sys", "time", "argparse", "zipimport", "_thread"])
def test_pythons_own(name: str) -> None:
    assert is_standard(name)


def test_others(write: Write) -> None:
    write(mine="")
    for name in ("mine", "lxml", "pytest", "no_such_module"):
        assert not is_standard(name)


def test_who_needs_a_library(write: Write) -> None:
    write(
        plain="import os, json",
        direct="import time\nfrom  middle import x",
        middle="def later():\n    import middleware",
        circle="import circle_back\nimport middle",
        circle_back="import circle",
        apart="import middleware",
        user="import apart",
        pack____init__="",
        pack__test__it="import middleware",
        pack__msg__kind="import middleware",
        broken="import middleware (",
    )
    needs = Dependents("middleware", ["apart"])
    for name, needed in (
        ("plain", False),
        ("direct", True),
        ("middle", True),
        ("circle", True),
        ("circle_back", True),
        ("apart", False),
        ("user", False),
        ("pack", False),
        ("middleware", False),
        ("broken", True),
        ("os", False),
        ("no_such", False),
    ):
        assert needs.has(name) is needed, name


def test_what_files_import_is_read_again_when_they_change(write: Write) -> None:
    folder = write(lib="import middleware", mine="import os")
    needs, file = Dependents("middleware"), str(folder / "mine.py")
    assert needs.imported_by([file]) == frozenset()
    write(mine="import lib, os")
    os.utime(file, (1, 1))
    assert needs.imported_by([file]) == {"lib"}
    assert needs.imported_by([str(folder / "gone.py")]) == frozenset()


def test_files_that_a_module_reaches(write: Write) -> None:
    write(
        bag____init__="",
        bag__one="from . import two\nimport os",
        bag__two="def f():\n    from bag.deep.three import (\n        thing)",
        bag__deep____init__="from .. import five",
        bag__deep__three="from ..four import x",
        bag__four="def (",
        bag__five="",
        bag__six="import middleware",
    )
    files = source_files("bag")
    below = ("deep", "deep.three", "five", "four", "one", "six", "two")
    assert sorted(files) == ["bag", *(f"bag.{each}" for each in below)]
    reached = {Path(each).stem for each in reached_from("bag.one", files)}
    assert reached == {"__init__", "one", "two", "three", "four", "five"}
    assert reached_from("elsewhere", files) == []
    assert source_files("os") == {"os": os.__file__}
    assert source_files("sys") == source_files("no_such") == {}


RELAY = """\
# -*- coding: utf-8 -*-
# generated from catkin/cmake/template/__init__.py.in

__extended_path = '{source}'.split(';')
"""


def test_a_devel_space_is_followed_to_the_source(write: Write, tmp_path: Path) -> None:
    source = tmp_path / "source"
    (source / "relayed").mkdir(parents=True)
    (source / "relayed" / "__init__.py").write_text("from relayed.leaf import word")
    (source / "relayed" / "leaf.py").write_text("word = 'leaf'")
    write(relayed____init__=RELAY.format(source=source), relayed__extra="word = 'generated'")
    assert source_files("relayed")["relayed.leaf"] == str(source / "relayed" / "leaf.py")
    importer = Importer(lambda name: name == "relayed")
    assert importer.import_module("relayed").word == "leaf"  # type: ignore[attr-defined]
    assert importer.import_module("relayed.extra").word == "generated"  # type: ignore[attr-defined]
    assert "relayed" not in sys.modules


def test_a_script_of_a_devel_space_is_the_one_that_it_executes(tmp_path: Path) -> None:
    real, relay, link = tmp_path / "real.py", tmp_path / "relay", tmp_path / "link"
    real.write_text("print()")
    relay.write_text(f"#!/usr/bin/env python3\npython_script = '{real}'\nexec('...')\n")
    link.symlink_to(real)
    assert script_file(str(relay)) == script_file(str(link)) == str(real)
    assert script_file(str(tmp_path / "gone")) == str(tmp_path / "gone")
