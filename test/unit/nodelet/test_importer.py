# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Modules of one owner's own: copies, views, and what the process shares."""

from __future__ import annotations

import importlib
import json
import sys
import threading
import time
from pathlib import Path
from types import ModuleType
from typing import Any, Callable, Dict, List

import pytest

from dyknow.nodelet.importer import Importer, View

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


def script_importer(folder: str, **views: Callable[[], ModuleType]) -> Importer:
    return Importer(lambda name: False, [folder], views)


def run(importer: Importer, code: str) -> Dict[str, Any]:
    """Execute a script."""
    module = importer.prepare("__main__", "/script.py")
    exec(compile(code, "/script.py", "exec"), vars(module))
    return vars(module)


def test_siblings_are_copies_of_each_owner(folder: Folder) -> None:
    path = folder(sib_one="things = []")
    first, second = script_importer(path), script_importer(path)
    assert run(first, "import sib_one; sib_one.things.append(1)")["sib_one"].things == [1]
    assert run(second, "import sib_one")["sib_one"].things == []
    assert "sib_one" not in sys.modules


def test_everything_else_is_the_processs_own(folder: Folder) -> None:
    importer = script_importer(folder(sib_two="import json, json.decoder as decoder"))
    found = run(importer, "import sib_two, json, os.path; from os import path")
    assert found["json"] is json and found["sib_two"].json is json
    assert found["sib_two"].decoder is json.decoder
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
        sib_four="word = 'own'", sib_five="def find():\n import sib_four\n return sib_four.word"
    )
    found = run(script_importer(path), "import sib_five")
    heard = []
    thread = threading.Thread(target=lambda: heard.append(found["sib_five"].find()))
    thread.start()
    thread.join()
    assert heard == ["own"]


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
    with pytest.raises(ModuleNotFoundError, match="sib_none"):
        run(importer, "import sib_none")
    with pytest.raises(ModuleNotFoundError, match="sib_none"):
        run(importer, "import pack_six.sib_none")


def test_folders_that_the_code_puts_into_the_path(folder: Folder, tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "sib_seven.py").write_text("word = 'seven'")
    importer = script_importer(folder())
    with pytest.raises(ModuleNotFoundError):
        run(importer, "import sib_seven")
    importer.path.insert(0, str(tmp_path / "more"))
    assert run(importer, "import sib_seven")["sib_seven"].word == "seven"
    assert str(tmp_path / "more") not in sys.path


def test_dataclasses_whose_annotations_are_texts(folder: Folder) -> None:
    path = folder(
        sib_eight="from __future__ import annotations\nfrom dataclasses import dataclass, field\n"
        "@dataclass(order=True)\nclass Pair:\n  left: int\n  right: int = field(default=2)\n"
    )
    pair = run(script_importer(path), "import sib_eight")["sib_eight"].Pair
    assert pair(1) == pair(1, 2) and pair(0) < pair(1)
    assert "sib_eight" not in sys.modules


def test_import_module_and_what_stands_for_sys_modules(folder: Folder) -> None:
    path = folder(pack_nine____init__="", pack_nine__leaf="word = 'leaf'")
    importer = script_importer(path)
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
        lib_ten="import time", nodelet_ten="import time, lib_ten\nfrom nodelet_more import word",
        nodelet_more="word = 'more'",
    )  # fmt: skip
    view = View(time, {"sleep": "ours"})
    importer = Importer(
        lambda name: False, [path], {"time": lambda: view}, ("nodelet_ten", "nodelet_more")
    )
    module: Any = importer.import_module("nodelet_ten")
    assert module.time is time and module.lib_ten.time is view and module.word == "more"


def test_functions_take_the_place_of_built_in_ones(folder: Folder) -> None:
    importer = Importer(lambda name: False, [folder(sib_x="def ask(): return input()")],
                        functions={"input": lambda: "refused"})  # fmt: skip
    assert run(importer, "import sib_x; said = sib_x.ask()")["said"] == "refused"


def test_two_threads_import_one_module_once(folder: Folder) -> None:
    path = folder(sib_slow="import time\ntime.sleep(0.05)")
    importer, found = script_importer(path), []

    def find() -> None:
        found.append(importer.import_module("sib_slow"))

    threads = [threading.Thread(target=find) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(map(id, found))) == 1
