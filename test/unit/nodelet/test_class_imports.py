# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A load runs the code that is on disk; nodelets of unchanged files share their modules."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, Iterator, List

import pytest

from dyknow.nodelet.class_imports import ClassImports
from dyknow.nodelet.importer import Importer
from dyknow.nodelet.plugins import PluginClass

NODELET = """
import dyknow
from {package}.words import word
class Teller(dyknow.Nodelet):
    said = word
"""


class Written:
    """A package of nodelets in a folder of plug-ins."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder = folder
        self.name = name
        self._seconds = 0
        (folder / name).mkdir()
        self.write("__init__", "")
        self.write("words", "word = 'old'")
        self.write("nodelets", NODELET.format(package=name))

    def write(self, module: str, text: str) -> None:
        file = self.folder / self.name / f"{module}.py"
        file.write_text(text)
        self._seconds += 1
        os.utime(file, (1e9 + self._seconds, 1e9 + self._seconds))

    def declared(self) -> PluginClass:
        name = f"{self.name}.nodelets.Teller"
        return PluginClass(f"{self.name}/Teller", name, "", self.folder, self.folder / "p.xml")


@pytest.fixture
def package(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Written]:
    before = list(sys.path)
    yield Written(tmp_path, f"pack_{abs(hash(request.node.name)) % 10**8}")
    sys.path[:] = before


def load(imports: ClassImports, package: Written) -> Any:
    return imports.load(package.declared(), None)  # type: ignore[arg-type]


def test_unchanged_files_are_shared(package: Written) -> None:
    imports = ClassImports()
    assert load(imports, package) is load(imports, package)
    assert sys.modules[f"{package.name}.words"].word == "old"


def test_a_changed_file_begins_a_generation(package: Written) -> None:
    imports = ClassImports()
    first = load(imports, package)
    package.write("words", "word = 'new'")
    second, third = load(imports, package), load(imports, package)
    assert (first.said, second.said) == ("old", "new")
    assert second is third
    package.write("more", "")
    assert load(imports, package) is not second
    assert first.said == "old"


def test_a_mended_file_is_used(package: Written) -> None:
    imports = ClassImports()
    package.write("words", "word = (")
    with pytest.raises(Exception, match="SyntaxError"):
        load(imports, package)
    package.write("words", "word = 'mended'")
    assert load(imports, package).said == "mended"
    package.write("words", "raise ValueError('boo')")
    with pytest.raises(Exception, match="boo"):
        load(imports, package)
    package.write("words", "word = 'again'")
    assert load(imports, package).said == "again"


def test_modules_with_libraries_are_those_of_one_nodelet(package: Written) -> None:
    asked: List[str] = []

    def own(context: Any, module: str, found: Any) -> Importer:
        asked.append(module)
        assert f"{package.name}.words" in found.files
        return Importer(found.tops.__contains__, search=found.folders)

    imports = ClassImports(own)
    assert load(imports, package) is not load(imports, package)
    assert asked == [f"{package.name}.nodelets"] * 2
    assert package.name not in sys.modules


def test_what_else_is_in_the_folder_stays_the_processs_own(package: Written) -> None:
    other = Written(package.folder, f"{package.name}_other")
    package.write("nodelets", f"import {other.name}\n{NODELET.format(package=package.name)}")
    imports = ClassImports()
    load(imports, package)
    package.write("words", "word = 'new'")
    assert load(imports, package).said == "new"
    module = sys.modules[load(imports, package).__module__]
    assert vars(module)[other.name] is sys.modules[other.name]
