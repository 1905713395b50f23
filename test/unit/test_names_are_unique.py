# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""One public class name stands for one thing over the whole repository."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("dyknow", "dyknow_rqt", "dyknow_demo", "dyknow_benchmark")


def classes() -> dict[str, list[str]]:
    """Modules in which a public class is defined, by its name."""
    found: dict[str, list[str]] = defaultdict(list)
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for statement in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(statement, ast.ClassDef) and not statement.name.startswith("_"):
                    found[statement.name].append(str(path.relative_to(ROOT)))
    return found


def test_a_public_class_name_stands_for_one_thing() -> None:
    assert not {name: paths for name, paths in classes().items() if len(paths) > 1}
