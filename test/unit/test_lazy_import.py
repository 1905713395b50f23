# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The layers without ROS can be used where there is no ROS: importing them must not import it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import dyknow

ROOT = Path(__file__).resolve().parents[2]


def printed(code: str) -> str:
    """What Python prints when it runs some code."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def modules_after(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*sys.modules)"
    return set(printed(code).splitlines()[-1].split())


def test_the_package_alone_loads_nothing() -> None:
    modules = modules_after("import dyknow")
    assert "rospy" not in modules
    assert [name for name in modules if name.startswith("dyknow.")] == []


ROS = {"rospy", "roslib", "genpy", "rosgraph", "dyknow_msgs"}
PARSERS = {"lxml", "rdflib", "urllib.request", "importlib.resources"}
#: A command that others do without.
SAVE_LOAD = "dyknow.cli.commands.save_load"
#: What rospy imports, and ours is not to.
LATE = {"numpy", "pyparsing"}


@pytest.mark.parametrize(
    ("statement", "unwanted"),
    [
        *((f"import dyknow; dyknow.{name}", ROS) for name in ("Nodelet", "NodeHandle")),
        ("import dyknow; dyknow.formulas.parse", ROS),
        ("from dyknow import ManagerClient", {"rospy"}),
        ("import dyknow.cli.nodelet as cli; cli.main(['nodelet', '--help'])", {"rospy"}),
        *(
            (f"import dyknow.cli.main as cli; cli.main({words})", {*ROS, SAVE_LOAD})
            for words in (["list", "--help"], ["check", "missing.xml"])
        ),
        # Each of these costs every re-wirable script its time at the start.
        ("import dyknow.ros.nodelets.script_process", PARSERS),
        *(
            (f"import dyknow.ros.lean, dyknow.ros.{name}", LATE)
            for name in (
                "manager.manager_node",
                "nodelets.nodelet_client",
                "nodelets.nodelet_manager",
                "nodelets.script_process",
                "shell.shell_client",
            )
        ),
    ],
)
def test_a_name_loads_what_it_needs_alone(statement: str, unwanted: set[str]) -> None:
    assert modules_after(statement).isdisjoint(unwanted)


def test_names_are_listed_and_others_refused() -> None:
    assert {"ManagerClient", "Nodelet", "NodeHandle", "acquire", "formulas"} <= set(dir(dyknow))
    with pytest.raises(AttributeError, match="nonesuch"):
        dyknow.nonesuch  # noqa: B018


ACCEPTED = """
import numpy
from genpy import message

kinds = {bool, bytes, float, int, str, *numpy.sctypeDict.values()}
print(*sorted({f"{kind.__module__}.{kind.__name__}" for kind in kinds if kind in FLOATS}))
""".replace("FLOATS", "message._valid_float_types")


def test_fields_of_floats_accept_what_genpy_accepts_with_numpy() -> None:
    accepted = printed(ACCEPTED)
    assert printed("import dyknow.ros.lean" + ACCEPTED) == accepted
    assert "numpy.float32" in accepted


CONDITIONS = """
from catkin_pkg.package import parse_package_string

package = parse_package_string(
    "<package format='3'><name>a</name><version>1.0.0</version><description>d</description>"
    "<license>BSD</license><maintainer email='a@b.org'>m</maintainer>"
    "<depend condition='$ROS_VERSION == 1 and $SIM != no'>rospy</depend>"
    "<depend condition='$ROS_VERSION == 2'>rclpy</depend><depend>tf</depend></package>"
)
package.evaluate_conditions({"ROS_VERSION": "1"})
print({each.name: each.evaluated_condition for each in package.exec_depends})
"""


def test_conditions_in_package_xml_are_evaluated_as_ever() -> None:
    found = printed("import dyknow.ros.lean, rospy" + CONDITIONS)
    assert found == "{'rospy': True, 'rclpy': False, 'tf': True}\n"


#: Runs a script up to its first connection; ends with 1 if a module of LATE is imported by then.
PROGRAM = f"""
import os, runpy, sys

def look(event, args):
    if event == "socket.connect":
        os._exit(not sys.modules.keys().isdisjoint({LATE}))

sys.addaudithook(look)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
os._exit(2)
"""


@pytest.mark.parametrize(
    "words", ["manager", "nodelet_manager", "nodelet unload a b", "dyknow list"]
)
def test_programs_do_without_what_is_slow_to_import(words: str, tmp_path: Path) -> None:
    environment = {**os.environ, "ROS_MASTER_URI": "http://localhost:9", "TMPDIR": str(tmp_path)}
    script, *arguments = words.split()
    command = [sys.executable, "-c", PROGRAM, str(ROOT / "scripts" / script), *arguments]
    assert subprocess.run(command, cwd=tmp_path, env=environment).returncode == 0
