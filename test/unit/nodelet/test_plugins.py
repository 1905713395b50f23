# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plugin descriptions: accepted and refused ones, and that a bad one does not hide others."""

from __future__ import annotations

import sys
import textwrap
from typing import cast

import pytest

from dyknow.errors import BrokenPlugin, UnknownNodeletType
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.plugins import ClassImports, PluginClass, PluginFile, Plugins, read

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


class Packages:
    """Packages in a folder, with modules of unique names."""

    def __init__(self, folder):
        self.folder = folder
        self.files = []
        self.looks = 0

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

    def find(self):
        self.looks += 1
        return list(self.files)


@pytest.fixture(name="packages")
def _packages(tmp_path):
    path, modules = list(sys.path), set(sys.modules)
    yield Packages(tmp_path)
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        del sys.modules[name]


def class_element(name="p/X", type_name="mod_x.X", base="dyknow.Nodelet"):
    return f'<class name="{name}" type="{type_name}" base_class_type="{base}"/>'


def test_a_description_is_read(packages):
    file = packages.add("good", GOOD.format(module="m"))
    assert read(file) == [
        PluginClass("good/Nodelet", "m.Good", "Does good.", file.directory / "src", file.file)
    ]


def test_several_libraries_in_one_file_are_read(packages):
    file = packages.add(
        "p",
        "<class_libraries>"
        f'<library path="a">{class_element("p/A")}</library>'
        f"<library>{class_element('p/B')}{class_element('p/C')}</library>"
        "</class_libraries>",
    )
    declared = read(file)
    assert [each.name for each in declared] == ["p/A", "p/B", "p/C"]
    assert [each.library.name for each in declared] == ["a", "p", "p"]


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
def test_a_broken_description_is_refused_with_its_place(packages, xml, reason):
    file = packages.add("broken", xml)
    with pytest.raises(BrokenPlugin) as caught:
        read(file)
    assert reason in str(caught.value)
    assert str(file.file) in str(caught.value)
    assert "'broken'" in str(caught.value)


def test_a_folder_in_place_of_the_file_is_a_broken_description(packages):
    file = packages.add("broken", None)
    file.file.mkdir()
    with pytest.raises(BrokenPlugin, match="cannot be read"):
        read(file)


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


def load(plugins, name):
    """Import what is declared as a name."""
    return ClassImports().load(plugins.find(name), cast(Context, None))


class TestLoading:
    def test_a_declared_class_is_imported_from_the_package(self, packages):
        packages.add("good", GOOD.format(module="mod_good"), mod_good=MODULE)
        found = load(Plugins(packages.find), "good/Nodelet")
        assert issubclass(found, Nodelet)
        assert found.__name__ == "Good"
        assert packages.looks == 1

    def test_a_library_that_does_not_exist_is_no_obstacle(self, packages):
        # In the install space the module comes from the Python path.
        packages.add("elsewhere", None, mod_installed=MODULE)
        sys.path.insert(0, str(packages.folder / "elsewhere" / "src"))
        packages.files.clear()
        packages.add(
            "good", GOOD.format(module="mod_installed").replace('path="src"', 'path="gone"')
        )
        before = list(sys.path)
        assert load(Plugins(packages.find), "good/Nodelet").__name__ == "Good"
        assert sys.path == before

    def test_an_unknown_type_is_looked_for_once_more_and_told_with_those_known(self, packages):
        packages.add("good", GOOD.format(module="mod_g"), mod_g=MODULE)
        packages.add("bad", "<broken")
        plugins = Plugins(packages.find)
        with pytest.raises(UnknownNodeletType) as caught:
            load(plugins, "no/Such")
        assert packages.looks == 1
        text = str(caught.value)
        assert "'no/Such'" in text
        assert "declared types: good/Nodelet" in text
        assert "of package 'bad'" in text and "not well-formed" in text
        with pytest.raises(UnknownNodeletType):
            load(plugins, "no/Such")
        assert packages.looks == 2

    def test_a_type_declared_meanwhile_is_found(self, packages):
        plugins = Plugins(packages.find)
        with pytest.raises(UnknownNodeletType):
            load(plugins, "good/Nodelet")
        packages.add("good", GOOD.format(module="mod_new"), mod_new=MODULE)
        assert load(plugins, "good/Nodelet").__name__ == "Good"

    def test_only_declared_classes_are_imported(self, packages):
        packages.add("good", GOOD.format(module="mod_h"), mod_h=MODULE)
        for name in ("mod_h.Good", "os.system", "mod_h/Good", ""):
            with pytest.raises(UnknownNodeletType):
                load(Plugins(packages.find), name)
        assert "mod_h" not in sys.modules

    def test_known_types_are_not_read_again(self, packages):
        packages.add("good", GOOD.format(module="mod_i"), mod_i=MODULE)
        plugins = Plugins(packages.find)
        assert load(plugins, "good/Nodelet") is load(plugins, "good/Nodelet")
        assert packages.looks == 1

    @pytest.mark.parametrize(
        ("type_name", "source", "reason"),
        [
            ("mod_missing.X", None, "cannot import 'mod_missing': ModuleNotFoundError"),
            ("mod_syntax.X", "def (", "cannot import 'mod_syntax': SyntaxError"),
            ("mod_raises.X", "raise ValueError('boo')", "ValueError: boo"),
            ("mod_exits.X", "import sys; sys.exit(2)", "cannot import 'mod_exits': SystemExit"),
            ("mod_other.X", MODULE, "has no class 'X'"),
            ("mod_stranger.Stranger", MODULE, "does not derive from dyknow.Nodelet"),
            ("mod_number.number", MODULE, "does not derive from dyknow.Nodelet"),
            ("Undotted", None, "expected a dotted path"),
            ("..X", None, "cannot import"),
        ],
    )
    def test_a_class_that_cannot_be_used_says_why(self, packages, type_name, source, reason):
        modules = {} if source is None else {type_name.split(".")[0]: source}
        packages.add("p", f'<library path="src">{class_element(type_name=type_name)}</library>')
        packages.add("p", None, **modules)
        packages.files.pop()
        packages.add("good", GOOD.format(module="mod_ok"), mod_ok=MODULE)
        plugins = Plugins(packages.find)
        with pytest.raises(BrokenPlugin) as caught:
            load(plugins, "p/X")
        assert reason in str(caught.value)
        assert "'p/X'" in str(caught.value)
        assert load(plugins, "good/Nodelet").__name__ == "Good"

    def test_a_class_that_was_mended_can_be_loaded(self, packages):
        xml = f'<library path="src">{class_element(type_name="mod_mended.Good")}</library>'
        file = packages.add("p", xml)
        plugins = Plugins(packages.find)
        with pytest.raises(BrokenPlugin, match="ModuleNotFoundError"):
            load(plugins, "p/X")
        (file.directory / "src" / "mod_mended.py").write_text(MODULE)
        assert load(plugins, "p/X").__name__ == "Good"

    def test_broken_packages_hide_no_others(self, packages):
        packages.add("a_broken", "<oops")
        packages.add("b_missing", None)
        packages.add("good", GOOD.format(module="mod_k"), mod_k=MODULE)
        packages.add("z_wrong", "<package/>")
        plugins = Plugins(packages.find)
        assert [each.name for each in plugins.declared()] == ["good/Nodelet"]
        assert load(plugins, "good/Nodelet").__name__ == "Good"

    def test_of_two_declarations_of_one_name_the_same_wins_in_any_order(self, packages):
        for package in ("b", "a"):
            packages.add(package, f"<library>{class_element('x/X', package + '.X')}</library>")
        plugins = Plugins(packages.find)
        assert [each.type for each in plugins.declared()] == ["a.X"]
        packages.files.reverse()
        assert [each.type for each in plugins.declared()] == ["a.X"]
