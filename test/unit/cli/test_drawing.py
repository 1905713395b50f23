# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The graph in DOT, read back by graphviz."""

from __future__ import annotations

import json
import shutil
import subprocess

import pytest
from clocks import PATIENCE
from unit.cli.fake_client import Outcome, run

from dyknow.cli.commands.graph import to_dot
from dyknow.graphviz import CannotDraw, render
from dyknow.model.graph import Model, NodeletStatus, PortState, State

needs_graphviz = pytest.mark.skipif(shutil.which("dot") is None, reason="graphviz is missing")


def nodelet(name, *ports, transformation="", is_protected=False, state=State.RUNNING):
    fixed = ("/m", is_protected, False, False)
    return NodeletStatus(name, transformation, *fixed, state, "", ports)


MODEL = Model(
    1,
    1,
    (
        nodelet("/cam", PortState("image", "out", "sensor_msgs/Image", "/cam/image")),
        nodelet(
            "/robot/arm/grip",
            PortState("in", "in", "sensor_msgs/Image", "/cam/image"),
            PortState("out", "out", "*", "/robot/held"),
            PortState("loose", "out", "a/B", ""),
            transformation='grip("left\\right")\n<b>',
            is_protected=True,
        ),
        nodelet("/robot/base", state=State.LOST),
    ),
    (),
)


def layout(dot):
    done = subprocess.run(
        ["dot", "-Tjson"], input=dot, capture_output=True, text=True, timeout=PATIENCE, check=True
    )
    assert done.stderr == ""
    return json.loads(done.stdout)


@needs_graphviz
def test_graphviz_reads_what_was_meant_in_any_order():
    assert to_dot(Model(1, 1, MODEL.nodelets[::-1], ())) == to_dot(MODEL)
    drawn = layout(to_dot(MODEL))
    objects = drawn["objects"]
    shapes = {each["name"]: each["shape"] for each in objects if "shape" in each}
    assert shapes == {
        "n/cam": "ellipse",
        "n/robot/arm/grip": "ellipse",
        "n/robot/base": "ellipse",
        "t/cam/image": "box",
        "t/robot/held": "box",
    }
    edges = {
        (objects[each["tail"]]["name"], objects[each["head"]]["name"], each["label"])
        for each in drawn["edges"]
    }
    assert edges == {
        ("n/cam", "t/cam/image", "image"),
        ("t/cam/image", "n/robot/arm/grip", "in"),
        ("n/robot/arm/grip", "t/robot/held", "out"),
    }
    boxes = {each["name"]: each["label"] for each in objects if each["name"].startswith("cluster")}
    assert boxes == {"cluster /robot": "/robot", "cluster /robot/arm": "/robot/arm"}
    inside = {
        each["name"]: {objects[member]["name"] for member in each.get("nodes", [])}
        for each in objects
        if each["name"] in boxes
    }
    assert inside["cluster /robot/arm"] == {"n/robot/arm/grip"}
    assert {"n/robot/base", "t/robot/held"} <= inside["cluster /robot"]
    assert all("t/cam/image" not in members for members in inside.values())
    assert drawn["rankdir"] == "LR"
    positions = {
        each["name"]: float(each["pos"].split(",")[0]) for each in objects if "pos" in each
    }
    assert positions["n/cam"] < positions["t/cam/image"] < positions["n/robot/arm/grip"]


@needs_graphviz
def test_files_and_standard_output(chain, tmp_path, capfdbinary):
    assert run(chain, f"graph --png {tmp_path / 'g.png'}").code == 0
    assert (tmp_path / "g.png").read_bytes().startswith(b"\x89PNG")
    assert run(chain, f"graph --svg {tmp_path / 'g.svg'}").code == 0
    assert run(chain, "graph --svg -") == Outcome(0, "", "")
    drawn = capfdbinary.readouterr().out
    assert b"<svg" in drawn and drawn == (tmp_path / "g.svg").read_bytes()


def test_without_graphviz_it_says_what_to_do(client, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    done = run(client, "graph --svg x.svg")
    assert done.code == 1
    assert "install graphviz, or use --dot" in done.err


@needs_graphviz
def test_an_endless_layout_is_given_up():
    with pytest.raises(CannotDraw, match=r"needs more than 0\.001 s"):
        render(to_dot(MODEL), "svg", timeout=0.001)
