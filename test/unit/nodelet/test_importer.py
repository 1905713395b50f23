# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Modules of one owner's own (copies, views), where they come from, and which need a library."""

from __future__ import annotations

import importlib
import json
import os
import sys
import threading
import time
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Callable, Dict, List

import pytest
from clocks import Gate, eventually, in_thread, join, wait_for

from dyknow.nodelet.loading.importer import Importer, View
from dyknow.nodelet.loading.module_files import (
    Dependents,
    is_standard,
    reached_from,
    script_file,
    source_files,
)

Folder = Callable[..., str]


def parts(name: str) -> List[str]:
    """The parts of a path: `pack____init__` is `pack/__init__`."""
    parts = name.replace("____init__", "__@").split("__")
    return [part.replace("@", "__init__") for part in parts]


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    """Writes modules, by their path without `.py`, and returns their folder."""

    def write(**modules: str) -> str:
        for name, text in modules.items():
            file = tmp_path.joinpath(*parts(name)).with_suffix(".py")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        importlib.invalidate_caches()
        return str(tmp_path)

    return write


@pytest.fixture
def shared(folder: Folder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Folder:
    """The same, on Python's path."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return folder


def script_importer(folder: str, **views: Callable[[], ModuleType]) -> Importer:
    return Importer(lambda name: False, [folder], views)


def run(importer: Importer, code: str) -> Dict[str, Any]:
    """Execute a script."""
    module = importer.prepare("__main__", "/script.py")
    exec(compile(code, "/script.py", "exec"), vars(module))
    return vars(module)


def test_siblings_are_copies_of_each_owner_and_everything_else_is_shared(folder: Folder) -> None:
    path = folder(sib_one="import json, json.decoder as decoder\nthings = []")
    first, second = script_importer(path), script_importer(path)
    assert run(first, "import sib_one; sib_one.things.append(1)")["sib_one"].things == [1]
    found = run(second, "import sib_one, json, os.path; from os import path")
    assert found["sib_one"].things == []
    assert "sib_one" not in sys.modules
    assert found["json"] is json and found["sib_one"].json is json
    assert found["sib_one"].decoder is json.decoder
    assert found["path"] is found["os"].path


def test_views_take_the_place_of_modules_in_every_copy(folder: Folder) -> None:
    path = folder(sib_three="from time import sleep, monotonic\nimport time as clock")
    view = View(time, {"sleep": "ours"})
    importer = script_importer(path, time=lambda: view)
    found = run(importer, "import time\nfrom sib_three import *")
    assert found["time"] is view and found["clock"] is view
    assert found["sleep"] == "ours"
    assert found["monotonic"] is time.monotonic


def test_a_view_that_refuses_is_refused_at_each_import_alone(folder: Folder) -> None:
    def refuse() -> ModuleType:
        raise ImportError("needs a process of its own")

    importer = script_importer(folder(), tkinter=refuse)
    for statement in ("import tkinter", "import tkinter.ttk", "from tkinter import Tk"):
        with pytest.raises(ImportError, match="of its own"):
            run(importer, statement)


def test_imports_in_functions_and_threads_find_the_owners_modules(folder: Folder) -> None:
    path = folder(
        sib_four="import time\ntime.sleep(0.05)\nword = object()",
        sib_five="def find():\n import sib_four\n return sib_four.word",
    )
    importer, heard = script_importer(path), []
    find = run(importer, "import sib_five")["sib_five"].find
    join(*[in_thread(lambda: heard.append(find())) for _ in range(4)])
    assert len(heard) == 4
    assert set(heard) == {importer.modules["sib_four"].word}, "it is imported once"


def test_an_import_waits_for_no_other_module(folder: Folder) -> None:
    path = folder(sib_slow="from gate import pass_\npass_()", sib_done="", sib_new="import time")
    gate = Gate()
    views = {"gate": lambda: View(time, {"pass_": gate}), "time": lambda: View(time, {})}
    importer = script_importer(path, **views)
    find = run(importer, "import sib_done\ndef find():\n import sib_done, sib_new")["find"]
    slow = in_thread(lambda: importer.import_module("sib_slow"))
    wait_for(gate.begun)
    join(in_thread(find))
    gate.open()
    join(slow)
    assert "sib_new" in importer.modules


#: A module that waits for a gate, then runs a statement.
SLOW = "from gate import pass_\npass_()\n{}\nword = 'ours'"


@pytest.mark.parametrize("fails", [False, True])
@pytest.mark.parametrize(
    ("is_top", "code"),
    [
        (False, "from pack import slow as found"),
        (False, "import pack.slow as found"),
        (True, "import pack as found"),
        (True, "import pack.sub\n found = pack"),
    ],
)
def test_no_thread_finds_a_module_that_another_one_makes(
    folder: Folder, monkeypatch: pytest.MonkeyPatch, is_top: bool, code: str, fails: bool
) -> None:
    slow = SLOW.format("if pass_.fails: pass_.fails = False; 1 / 0")
    path = folder(
        pack____init__=f"from . import sub\n{slow if is_top else ''}",
        pack__sub="",
        pack__slow=slow,
    )
    gate, heard, waits = Gate(), [], threading.Event()
    vars(gate)["fails"] = fails
    importer = script_importer(path, gate=lambda: View(time, {"pass_": gate}))
    changed = importer._makers._changed
    wait = changed.wait
    monkeypatch.setattr(changed, "wait", lambda: (waits.set(), wait()))
    find = run(importer, f"def find():\n {code}\n return found")["find"]

    def make() -> None:
        if fails:
            with pytest.raises(ZeroDivisionError):
                importer.import_module(name)
        else:
            importer.import_module(name)

    name = "pack" if is_top else "pack.slow"
    maker = in_thread(make)
    wait_for(gate.begun)
    user = in_thread(lambda: heard.append(find().word))
    eventually(lambda: waits.is_set() or not user.is_alive())
    gate.open()
    join(maker, user)
    assert heard == ["ours"]


def test_modules_that_import_each_other_do_so_in_two_threads_too(folder: Folder) -> None:
    meet = View(time, {"other": threading.Barrier(2).wait})
    text = "from meet import other\nother()\nimport {}"
    path = folder(sib_left=text.format("sib_right"), sib_right=text.format("sib_left"))
    importer = script_importer(path, meet=lambda: meet)
    join(
        *[in_thread(partial(importer.import_module, f"sib_{each}")) for each in ("left", "right")]
    )
    left, right = vars(importer.modules["sib_left"]), vars(importer.modules["sib_right"])
    assert left["sib_right"].__dict__ is right and right["sib_left"].__dict__ is left


def test_packages_with_relative_and_circular_imports(folder: Folder) -> None:
    path = folder(
        pack____init__="from . import left\nfrom .sub.deep import depth",
        pack__left="from . import right\nname = 'left'",
        pack__right="from . import left\ndef other():\n return left.name",
        pack__sub____init__="",
        pack__sub__deep="from ..left import name\nfrom .. import right\ndepth = name",
    )
    found = run(
        script_importer(path), "import pack, pack.sub.deep as deep\nfrom pack import right"
    )
    assert found["pack"].depth == "left"
    assert found["right"].other() == "left"
    assert found["deep"].__name__ == "pack.sub.deep"


def test_a_module_that_fails_is_imported_again(folder: Folder) -> None:
    path = folder(sib_six="raise ValueError('first')", pack_six____init__="", pack_six__bad="1/0")
    importer = script_importer(path)
    with pytest.raises(ValueError, match="first"):
        run(importer, "import sib_six")
    with pytest.raises(ZeroDivisionError):
        run(importer, "import pack_six.bad")
    assert not hasattr(importer.modules["pack_six"], "bad")
    assert "sib_six" not in importer.modules
    for name in ("sib_none", "pack_six.sib_none"):
        with pytest.raises(ModuleNotFoundError, match="sib_none"):
            run(importer, f"import {name}")


def test_the_path_is_the_owners(folder: Folder, tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "sib_seven.py").write_text("word = 'seven'")
    importer = script_importer(folder())
    with pytest.raises(ModuleNotFoundError):
        run(importer, "import sib_seven")
    importer.path.insert(0, str(tmp_path / "more"))
    assert run(importer, "import sib_seven")["sib_seven"].word == "seven"
    assert str(tmp_path / "more") not in sys.path


def test_dataclasses_whose_annotations_are_texts(folder: Folder) -> None:
    """The process has another module of the script's name, ``__main__``."""
    before = sys.modules["__main__"]
    header = "from __future__ import annotations\nfrom dataclasses import InitVar, dataclass\n"
    path = folder(sib_eight=f"{header}@dataclass(order=True)\nclass Number:\n  value: int\n")
    found = run(
        script_importer(path),
        f"{header}from typing import ClassVar\nfrom sib_eight import Number\n"
        "@dataclass\nclass Made:\n  number: ClassVar[int] = 7\n  given: InitVar[int]\n"
        "  twice: int = 0\n  def __post_init__(self, given):\n    self.twice = 2 * given\n",
    )
    made = found["Made"](5)
    assert (made.twice, made.number, vars(made)) == (10, 7, {"twice": 10})
    assert found["Made"].__module__ == "__main__" and sys.modules["__main__"] is before
    assert found["Number"](0) < found["Number"](1)
    assert not any("sib_eight" in name for name in sys.modules)


def test_what_a_submodule_lacks_is_named(folder: Folder) -> None:
    path = folder(pack_three____init__="", pack_three__sub="import not_there_at_all")
    with pytest.raises(ModuleNotFoundError, match="'not_there_at_all'"):
        run(script_importer(path), "from pack_three import sub")
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        run(script_importer(path), "from pack_three import nothing")


def test_import_module_and_what_stands_for_sys_modules(folder: Folder) -> None:
    importer = script_importer(folder(pack_nine____init__="", pack_nine__leaf="word = 'leaf'"))
    found = run(
        importer,
        "import importlib\nleaf = importlib.import_module('.leaf', 'pack_nine')\n"
        "js = importlib.import_module('json')",
    )
    assert found["leaf"].word == "leaf" and found["js"] is json
    everything = importer.everything()
    assert everything["pack_nine.leaf"] is found["leaf"] and everything["json"] is json
    assert any(file.endswith("leaf.py") for file in importer.files())
    assert json.__file__ not in set(importer.files())


def test_blind_modules_see_the_process_and_their_libraries_the_views(folder: Folder) -> None:
    path = folder(
        lib_ten="import time\ndef ask(): return input()",
        nodelet_ten="import time, lib_ten\nfrom nodelet_more import word",
        nodelet_more="word = 'more'",
    )
    view = View(time, {"sleep": "ours"})
    importer = Importer(
        lambda name: False,
        [path],
        {"time": lambda: view},
        ("nodelet_ten", "nodelet_more"),
        functions={"input": lambda: "refused"},
    )
    module: Any = importer.import_module("nodelet_ten")
    assert module.time is time and module.lib_ten.time is view and module.word == "more"
    assert module.lib_ten.ask() == "refused"


def test_pythons_own_and_others(shared: Folder) -> None:
    shared(mine="")
    own = ["os", "sys", "time", "argparse", "zipimport", "_thread"]
    assert [*filter(is_standard, (*own, "mine", "lxml", "pytest", "no_such_module"))] == own


def test_modules_that_need_a_library(shared: Folder) -> None:
    shared(
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
        several="import os, sys as s,middleware as m",
    )
    needs = Dependents("middleware", ["apart"])
    for name in "direct middle circle circle_back broken several".split():
        assert needs.has(name), name
    for name in "plain apart user pack middleware os no_such".split():
        assert not needs.has(name), name


def test_imports_of_files_are_read_again_when_they_change(shared: Folder) -> None:
    path = shared(lib="import middleware", mine="import os")
    needs, file = Dependents("middleware"), f"{path}/mine.py"
    assert needs.imported_by([file]) == frozenset()
    shared(mine="import lib, os")
    os.utime(file, (1, 1))
    assert needs.imported_by([file]) == {"lib"}
    assert needs.imported_by([f"{path}/gone.py"]) == frozenset()


def test_files_that_a_module_reaches(shared: Folder) -> None:
    shared(
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


def test_a_devel_space_is_followed_to_the_source(shared: Folder, tmp_path: Path) -> None:
    source = tmp_path / "source"
    (source / "relayed").mkdir(parents=True)
    (source / "relayed" / "__init__.py").write_text("from relayed.leaf import word")
    (source / "relayed" / "leaf.py").write_text("word = 'leaf'")
    shared(
        relayed____init__="# generated from catkin/cmake/template/__init__.py.in\n"
        f"__extended_path = '{source}'.split(';')\n",
        relayed__extra="word = 'generated'",
    )
    assert source_files("relayed")["relayed.leaf"] == str(source / "relayed" / "leaf.py")
    importer = Importer(lambda name: name == "relayed")
    relayed: Any = importer.import_module("relayed")
    assert relayed.word == "leaf"
    assert importer.import_module("relayed.extra").__dict__["word"] == "generated"
    assert "relayed" not in sys.modules


def test_a_script_of_a_devel_space_is_the_one_that_it_executes(tmp_path: Path) -> None:
    real, relay, link = tmp_path / "real.py", tmp_path / "relay", tmp_path / "link"
    real.write_text("print()")
    relay.write_text(f"#!/usr/bin/env python3\npython_script = '{real}'\nexec('...')\n")
    link.symlink_to(real)
    assert script_file(str(relay)) == script_file(str(link)) == str(real)
    assert script_file(str(tmp_path / "gone")) == str(tmp_path / "gone")
