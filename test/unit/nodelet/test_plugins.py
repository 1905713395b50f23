# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plugin descriptions, and the import of the classes that they declare as the code on disk."""

from __future__ import annotations

import os
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, List

import pytest

from dyknow.errors import BrokenPlugin, UnknownNodeletType
from dyknow.nodelet.loading.importer import Importer
from dyknow.nodelet.loading.plugins import ClassImports, PluginClass, PluginFile, Plugins, read

GOOD = """
<library path="src">
  <class name="good/Nodelet" type="{module}.Good" base_class_type="dyknow.Nodelet">
    <description>
      Does   good.
    </description>
  </class>
</library>
"""

MODULE = """
import dyknow

class Good(dyknow.Nodelet):
    def on_init(self):
        pass

class Stranger:
    pass

number = 5
"""


#: Importers alone ask for the context of a nodelet.
NO_CONTEXT: Any = None


class Packages:
    """Packages in a folder, with modules of unique names."""

    def __init__(self, folder):
        self.folder = folder
        self.files = []
        self.looks = 0
        self.plugins = Plugins(self.find)

    def add(self, package, xml, **modules):
        directory = self.folder / package
        (directory / "src").mkdir(parents=True, exist_ok=True)
        file = directory / "dyknow_nodelets.xml"
        if xml is not None:
            file.write_text(xml)
        for name, text in modules.items():
            (directory / "src" / f"{name}.py").write_text(textwrap.dedent(text))
        described = PluginFile(package, directory, file)
        self.files.append(described)
        return described

    def add_good(self, module):
        self.add("good", GOOD.format(module=module), **{module: MODULE})

    def find(self):
        self.looks += 1
        return list(self.files)

    def load(self, name):
        """Import the class that is declared under a name."""
        return ClassImports().load(self.plugins.find(name), NO_CONTEXT)


@pytest.fixture(autouse=True)
def same_modules_afterwards():
    path, modules = list(sys.path), set(sys.modules)
    yield
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        del sys.modules[name]


@pytest.fixture(name="packages")
def _packages(tmp_path):
    return Packages(tmp_path)


def class_element(name="p/X", type_name="mod_x.X", base="dyknow.Nodelet"):
    return f'<class name="{name}" type="{type_name}" base_class_type="{base}"/>'


def test_descriptions_are_read(packages):
    file = packages.add("good", GOOD.format(module="m"))
    assert read(file) == [
        PluginClass("good/Nodelet", "m.Good", "Does good.", file.directory / "src", file.file)
    ]
    file = packages.add(
        "p",
        "<class_libraries>"
        f'<library path="a">{class_element("p/A")}</library>'
        f"<library>{class_element('p/B')}{class_element('p/C')}</library>"
        "</class_libraries>",
    )
    assert [(each.name, each.library.name) for each in read(file)] == [
        ("p/A", "a"),
        ("p/B", "p"),
        ("p/C", "p"),
    ]


@pytest.mark.parametrize(
    ("xml", "reason"),
    [
        (None, "cannot be read: No such file"),
        ("", "is not well-formed XML"),
        ("<library>", "is not well-formed XML"),
        ("no xml at all", "is not well-formed XML"),
        ("<package/>", "expected <library> at the root, found <package>"),
        ('<library><class type="m.X" base_class_type="dyknow.Nodelet"/></library>', "line 1"),
        ('<library>\n<class name="p/X" base_class_type="dyknow.Nodelet"/></library>', "line 2"),
        ('<library><class name="" type="m.X"/></library>', "expected <class name"),
        ('<library><class name="p/X" type="m.X"/></library>', "found None"),
        (f"<library>{class_element(base='nodelet::Nodelet')}</library>", "'nodelet::Nodelet'"),
    ],
)
def test_a_broken_description_is_refused_with_its_place_and_hides_no_other(packages, xml, reason):
    file = packages.add("broken", xml)
    with pytest.raises(BrokenPlugin) as caught:
        read(file)
    for text in (reason, str(file.file), "'broken'"):
        assert text in str(caught.value)
    packages.add_good("mod_k")
    assert [each.name for each in packages.plugins.declared()] == ["good/Nodelet"]
    assert packages.load("good/Nodelet").__name__ == "Good"


def test_entities_are_not_expanded_and_files_not_included(packages, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("secret")
    file = packages.add(
        "hostile",
        f'<!DOCTYPE library [<!ENTITY x SYSTEM "file://{secret}">]>'
        '<library><class name="p/X" type="m.X" base_class_type="dyknow.Nodelet">'
        "<description>a&x;b</description></class></library>",
    )
    try:
        described = read(file)
    except BrokenPlugin:
        return
    assert "secret" not in described[0].description


def test_a_library_that_does_not_exist_is_no_obstacle(packages):
    # In the install space the module comes from the Python path.
    packages.add("elsewhere", None, mod_installed=MODULE)
    sys.path.insert(0, str(packages.folder / "elsewhere" / "src"))
    packages.files.clear()
    packages.add("good", GOOD.format(module="mod_installed").replace('path="src"', 'path="gone"'))
    before = list(sys.path)
    assert packages.load("good/Nodelet").__name__ == "Good"
    assert sys.path == before


def test_an_unknown_type_is_looked_for_once_more_and_refused_with_those_known(packages):
    packages.add_good("mod_g")
    packages.add("bad", "<broken")
    for looks in (1, 2):
        with pytest.raises(UnknownNodeletType) as caught:
            packages.load("no/Such")
        assert packages.looks == looks
    text = str(caught.value)
    assert "'no/Such'" in text
    assert "declared types: good/Nodelet" in text
    assert "of package 'bad'" in text and "not well-formed" in text
    packages.add(
        "new", f'<library path="src">{class_element("no/Such", "mod_new.Good")}</library>'
    )
    (packages.folder / "new/src/mod_new.py").write_text(MODULE)
    assert packages.load("no/Such").__name__ == "Good"


def test_a_changed_description_is_read_again(packages):
    packages.add_good("mod_a")
    assert packages.load("good/Nodelet").__module__ == "mod_a"
    described = packages.files[0].file
    described.write_text(GOOD.format(module="mod_other"))
    assert packages.plugins.find("good/Nodelet").type == "mod_other.Good"
    described.unlink()
    with pytest.raises(UnknownNodeletType, match="cannot be read"):
        packages.load("good/Nodelet")


def test_only_declared_classes_are_imported(packages):
    packages.add_good("mod_h")
    for name in ("mod_h.Good", "os.system", "mod_h/Good", ""):
        with pytest.raises(UnknownNodeletType):
            packages.load(name)
    assert "mod_h" not in sys.modules


@pytest.mark.parametrize(
    ("type_name", "source", "reason"),
    [
        ("mod_missing.X", None, "cannot import 'mod_missing': ModuleNotFoundError"),
        ("mod_syntax.X", "def (", "cannot import 'mod_syntax': SyntaxError"),
        ("mod_raises.X", "raise ValueError('boo')", "ValueError: boo"),
        ("mod_exits.X", "import sys; sys.exit(2)", "cannot import 'mod_exits': SystemExit"),
        (
            "mod_silent.X",
            "raise type('Silent', (Exception,), {'__str__': lambda self: 5})",
            "cannot import 'mod_silent': Silent",
        ),
        ("mod_other.X", MODULE, "has no class 'X'"),
        ("mod_stranger.Stranger", MODULE, "does not derive from dyknow.Nodelet"),
        ("mod_number.number", MODULE, "does not derive from dyknow.Nodelet"),
        ("Undotted", None, "expected a dotted path"),
        ("..X", None, "cannot import"),
    ],
)
def test_a_class_that_cannot_be_used_says_why(packages, type_name, source, reason):
    modules = {} if source is None else {type_name.split(".")[0]: source}
    library = f'<library path="src">{class_element(type_name=type_name)}</library>'
    packages.add("p", library, **modules)
    with pytest.raises(BrokenPlugin) as caught:
        packages.load("p/X")
    assert reason in str(caught.value)
    assert "'p/X'" in str(caught.value)


def test_of_two_declarations_of_one_name_the_same_wins_in_any_order(packages):
    for package in ("b", "a"):
        packages.add(package, f"<library>{class_element('x/X', package + '.X')}</library>")
    assert [each.type for each in packages.plugins.declared()] == ["a.X"]
    packages.files.reverse()
    assert [each.type for each in packages.plugins.declared()] == ["a.X"]


# A load runs the code that is on disk; nodelets of unchanged files share their modules.

NODELET = """
import dyknow
from {package}.words import word
class Teller(dyknow.Nodelet):
    said = word
"""


def load_teller(imports: ClassImports, folder: Path, module: str) -> Any:
    """Import the class ``Teller`` of a module in a folder of plug-ins."""
    declared = PluginClass("p/Teller", f"{module}.Teller", "", folder, folder / "p.xml")
    return imports.load(declared, NO_CONTEXT)


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

    def load(self, imports: ClassImports) -> Any:
        return load_teller(imports, self.folder, f"{self.name}.nodelets")


@pytest.fixture
def package(tmp_path: Path, request: pytest.FixtureRequest) -> Written:
    return Written(tmp_path, f"pack_{abs(hash(request.node.name)) % 10**8}")


def own_importer(context: Any, module: str, found: Any) -> Importer:
    return Importer(found.tops.__contains__, search=found.folders)


def test_a_changed_file_begins_a_generation_and_unchanged_ones_are_shared(
    package: Written,
) -> None:
    imports = ClassImports()
    first = package.load(imports)
    assert package.load(imports) is first
    assert sys.modules[f"{package.name}.words"].word == "old"
    package.write("words", "word = 'new'")
    second, third = package.load(imports), package.load(imports)
    assert (first.said, second.said) == ("old", "new")
    assert second is third
    package.write("more", "")
    assert package.load(imports) is not second
    assert first.said == "old"


def test_nodelets_that_are_loaded_at_the_same_time_share_their_modules(
    package: Written, monkeypatch: pytest.MonkeyPatch, impatient_interpreter: None
) -> None:
    """Python's cache of folders has those without modules too, which every load forgets."""
    monkeypatch.setattr(sys, "path_importer_cache", dict(sys.path_importer_cache))
    together = threading.Barrier(8, timeout=60.0)

    def no_importer(*_: Any) -> None:
        together.wait()

    imports = ClassImports(no_importer)
    with ThreadPoolExecutor(8) as pool:
        for turn in range(20):
            package.write("words", f"word = {turn}")
            sys.path_importer_cache.update({f"/{turn}/{each}": None for each in range(1000)})
            loaded = set(pool.map(lambda _: package.load(imports), range(8)))
            assert [each.said for each in loaded] == [turn]


def test_a_changed_file_of_a_large_package_is_used(package: Written) -> None:
    for number in range(101):
        package.write(f"module_{number}", "")
    imports = ClassImports()
    assert package.load(imports).said == "old"
    package.write("words", "word = 'new'")
    assert package.load(imports).said == "new"


def test_a_mended_file_is_used(package: Written) -> None:
    imports = ClassImports()
    for broken, error in (("word = (", "SyntaxError"), ("raise ValueError('boo')", "boo")):
        package.write("words", broken)
        with pytest.raises(BrokenPlugin, match=error):
            package.load(imports)
        package.write("words", f"word = 'mended {error}'")
        assert package.load(imports).said == f"mended {error}"


def test_modules_with_libraries_are_those_of_one_nodelet(package: Written) -> None:
    asked: List[str] = []

    def own(context: Any, module: str, found: Any) -> Importer:
        asked.append(module)
        assert f"{package.name}.words" in found.files
        return own_importer(context, module, found)

    imports = ClassImports(own)
    assert package.load(imports) is not package.load(imports)
    assert asked == [f"{package.name}.nodelets"] * 2
    assert package.name not in sys.modules


def test_what_else_is_in_the_folder_stays_the_processs_own(package: Written) -> None:
    other = Written(package.folder, f"{package.name}_other")
    package.write("nodelets", f"import {other.name}\n{NODELET.format(package=package.name)}")
    imports = ClassImports()
    package.load(imports)
    package.write("words", "word = 'new'")
    assert package.load(imports).said == "new"
    module = sys.modules[package.load(imports).__module__]
    assert vars(module)[other.name] is sys.modules[other.name]


def test_modules_of_one_name_are_those_of_each_folder(tmp_path: Path) -> None:
    """Also in packages beside them, which change with them."""
    imports = ClassImports()

    def said(name: str) -> Any:
        return load_teller(imports, tmp_path / name, f"{name}_nodelets").said

    for name in ("one_a", "one_b"):
        (tmp_path / name / "parts").mkdir(parents=True)
        (tmp_path / name / f"{name}_nodelets.py").write_text(
            "import dyknow, common, parts.words\n"
            "class Teller(dyknow.Nodelet):\n  said = common.word, parts.words.word\n"
        )
        (tmp_path / name / "common.py").write_text(f"word = '{name}'")
        (tmp_path / name / "parts" / "__init__.py").write_text("")
        (tmp_path / name / "parts" / "words.py").write_text(f"word = '{name}'")
        assert said(name) == (name, name)
    for name in ("one_a", "one_b"):
        (tmp_path / name / "parts" / "words.py").write_text(f"word = 'changed {name}'")
        assert said(name) == (name, f"changed {name}")


#: The relay that catkin puts into a devel space, in short.
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
#: How code imports the modules that catkin generated.
USES = {
    "msg": "from {package}.msg import Own",
    "msg by its own module": "from {package}.msg._Own import Own",
    "srv": "from {package}.srv import Own",
    "cfg": "from {package}.cfg.OwnConfig import Own",
}


def in_devel_space(tmp_path: Path, package: Written, relay: str) -> Path:
    """Write a package's generated modules into a devel space as catkin does; return its folder."""
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
    imports_of = ClassImports(own_importer) if with_libraries else ClassImports()
    first = package.load(imports_of)
    package.write("more", "")  # begins a generation
    second = package.load(imports_of)
    assert first is not second
    if use != "cfg":  # messages are the same for every module of the process
        assert first.own is second.own is sys.modules[f"{package.name}.msg"].Own


@pytest.mark.parametrize("since", [-1000, 1000])
def test_versions_of_the_same_second_are_distinguished(packages, monkeypatch, since):
    """However long after it they are loaded."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    packages.add("fast", GOOD.format(module="fast_module"), fast_module=MODULE)
    file = packages.folder / "fast" / "src" / "fast_module.py"
    imports, declared = ClassImports(), packages.plugins.find("good/Nodelet")
    second = int(time.time()) + since
    for number in range(3, 7):  # all of the same size
        file.write_text(MODULE.replace("number = 5", f"number = {number}"))
        os.utime(file, ns=(0, second * 1_000_000_000 + number))
        found = imports.load(declared, NO_CONTEXT)
        assert found.on_init.__globals__["number"] == number
