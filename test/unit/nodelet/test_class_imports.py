# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A load runs the code that is on disk; nodelets of unchanged files share their modules."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, Iterator, List

import pytest

from dyknow.nodelet.importer import Importer
from dyknow.nodelet.plugins import ClassImports, PluginClass

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


#: What catkin puts into a devel space, in short.
RELAY = """# generated from catkin/cmake/template/__init__.py.in
import os, pkgutil, sys
__extended_path = '{source}'.split(';')
sys.path[:0] = __extended_path
__path__ = pkgutil.extend_path(__path__, __name__)
exec(open(os.path.join(__extended_path[0], __name__, '__init__.py')).read())
"""
GENERATED = """
import dyknow
{use}
class Teller(dyknow.Nodelet):
    own = Own
"""
#: How code imports what catkin generated.
USES = {
    "msg": "from {package}.msg import Own",
    "msg by its own module": "from {package}.msg._Own import Own",
    "srv": "from {package}.srv import Own",
    "cfg": "from {package}.cfg.OwnConfig import Own",
}


def in_devel_space(tmp_path: Path, package: Written, relay: str) -> Path:
    """Write what catkin generates for a package into a devel space, and return its folder."""
    folder = tmp_path / "devel/lib/python3/dist-packages"
    for module in ("__init__", "msg/__init__", "msg/_Own", "srv/__init__", "cfg/OwnConfig"):
        file = folder / package.name / f"{module}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("class Own: pass\n")
    for kind in ("msg", "srv"):
        init = folder / package.name / kind / "__init__.py"
        init.write_text(f"from {package.name}.msg._Own import Own\n")
    (folder / package.name / "cfg" / "__init__.py").touch()
    (folder / package.name / "__init__.py").write_text(relay)
    return folder


@pytest.mark.parametrize("with_libraries", [False, True], ids=["shared", "with libraries"])
@pytest.mark.parametrize("source_first", [False, True], ids=["relay first", "source first"])
@pytest.mark.parametrize("has_relay", [True, False], ids=["relay", "no setup.py"])
@pytest.mark.parametrize("use", USES)
def test_what_was_generated_for_a_package_in_a_devel_space(
    package: Written, use: str, has_relay: bool, source_first: bool, with_libraries: bool
) -> None:
    source = package.folder
    devel = in_devel_space(source, package, RELAY.format(source=source) if has_relay else "")
    sys.path[:0] = [str(source), str(devel)] if source_first else [str(devel)]
    package.write("nodelets", GENERATED.format(use=USES[use].format(package=package.name)))

    def own(context: Any, module: str, found: Any) -> Importer:
        return Importer(found.tops.__contains__, search=found.folders)

    imports_of = ClassImports(own) if with_libraries else ClassImports()
    first = load(imports_of, package)
    package.write("more", "")  # begins a generation
    second = load(imports_of, package)
    assert first is not second
    if use != "cfg":  # messages are the same for every module of the process
        assert first.own is second.own is sys.modules[f"{package.name}.msg"].Own
