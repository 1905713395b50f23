# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parameters of a spawn override those of the transformation, and fill in its variables."""

from __future__ import annotations

from typing import Dict, Tuple

import pytest
from unit.manager.witness import Concepts
from unit.manager.world import TRACKER, World

from dyknow.errors import InvalidParameters
from dyknow.manager.specifications.given import completed, set_on_load, undeclared
from dyknow.manager.specifications.specification import parse
from dyknow.manager.specifications.values import value_of
from dyknow.model.transformation import Parameter, Port, Transformation

TRANSFORMATION = Transformation(
    "tracker",
    "pkg/Tracker",
    parameters=(
        Parameter("frame", "string", "${?camera}_link"),
        Parameter("rate", "double", "30"),
        Parameter("number", "int", "${?number}"),
        Parameter("home", "string", "$${?camera}"),
    ),
    ports=(Port("in", "in", "", ("Image(?camera)", "Part(?camera, ?number)")),),
)

FORMULA = """<transformation type="formula"><label>f</label>
  <ports>
    <port type="in" datatype="std_msgs/Bool">a</port>
    <port type="in" datatype="std_msgs/Bool">b</port>
    <port type="in" datatype="std_msgs/Bool">d</port>
    <port type="out">h</port>
  </ports>
  <tags>
    <tag port="a">A(?r)</tag><tag port="b">B(?r, ?c)</tag><tag port="d">D({}, ?c)</tag>
    <tag port="h">H(?r)</tag>
  </tags>
  <formula>a and every ?c (b and d)</formula></transformation>"""


def given(**values: str) -> Tuple[Parameter, ...]:
    return tuple(Parameter(name.replace("v_", "?"), "", text) for name, text in values.items())


def values(*parameters: Parameter) -> Dict[str, str]:
    set_ = set_on_load(TRANSFORMATION, completed(TRANSFORMATION, parameters))
    return {each.name: each.text for each in set_}


def test_parameters_that_are_not_declared_are_reported() -> None:
    of_images = {"image_transport": "raw", "camera/image/compressed/png_level": "1"}
    asked = given(rte="5", rate="5", v_camera="left", **of_images)
    (remark,) = undeclared(TRANSFORMATION, asked)
    assert "declares no parameter 'rte'" in remark
    assert remark.endswith("did you mean rate?")
    bare = TRANSFORMATION._replace(parameters=())
    assert undeclared(bare, given(rte="5")) == []


def problems(*parameters: Parameter) -> Tuple[str, ...]:
    with pytest.raises(InvalidParameters) as raised:
        completed(TRANSFORMATION, parameters)
    assert "'tracker'" in str(raised.value)
    return raised.value.problems


def test_variables_fill_and_names_override() -> None:
    found = values(*given(v_camera="cam1", v_number="7", rate="5"), Parameter("new", "int", "1"))
    assert found == {
        "frame": "cam1_link",
        "rate": "5",
        "number": "7",
        "home": "${?camera}",
        "new": "1",
    }


def test_what_overrides_is_plain_and_needs_no_variable() -> None:
    found = values(*given(frame="${?camera}", number="3"))
    assert found == {"frame": "${?camera}", "rate": "30", "number": "3", "home": "${?camera}"}


def test_a_type_that_is_left_out_is_the_transformations_or_follows_from_the_text() -> None:
    done = completed(TRANSFORMATION, given(v_camera="a", v_number="1", rate="5", new="true"))
    types = {each.name: each.type for each in done}
    expected = {"?camera": "string", "?number": "string", "rate": "double", "new": "bool"}
    assert types == expected


def test_all_problems_are_named_at_once() -> None:
    assert problems(
        *given(v_camra="a", rate="fast"),
        Parameter("~x", "string", "1"),
        Parameter("?camera", "int", "1"),
        Parameter("?camera", "", "a b)"),
    ) == (
        "?camera is given more than once",
        "?camera is given 'a b)'; expected a name such as cam1",
        "?camera is given as int; expected a name, of type string",
        "unknown variable ?camra; known: ?camera, ?number; did you mean ?camera?",
        "the parameter 'rate': expected a double, such as 0.5 or 1e-3, found 'fast'",
        "'~x' is no name of a parameter; expected one like rate",
    )


def test_a_name_is_of_all_types_of_its_variable() -> None:
    ports = (Port("in", "in", "", ("Image(?c: camera)",)), Port("x", "in", "", ("At(?c: seen)",)))
    typed = Transformation("t", "pkg/T", ports=ports)
    concepts = Concepts({"left": "camera", "camera": "seen", "ball": "seen"})
    left, ball = given(v_c="left"), given(v_c="ball")
    assert [each.text for each in completed(typed, left, concepts)] == ["left"]
    with pytest.raises(InvalidParameters) as raised:
        completed(typed, ball, concepts)
    assert raised.value.problems == ("?c is given 'ball', which is no camera",)
    assert [each.text for each in completed(typed, ball)] == ["ball"], "it is not known"


def test_unfilled_and_wrongly_filled_ones_are_refused() -> None:
    assert problems(*given(v_number="seven")) == (
        "nothing says what ?camera in the parameter 'frame' stands for; give it, as in "
        "--param '?camera=NAME'",
        "the parameter 'number': expected an int, such as 42, found 'seven'",
    )


@pytest.mark.parametrize("name", ["no", "7", "camera #2", "left: wide", '24" monitor', "~"])
def test_in_yaml_a_variable_is_a_string(name: str) -> None:
    parameters = (Parameter("who", "yaml", "{robot: ${?camera}, rate: 5}"),)
    typed = TRANSFORMATION._replace(parameters=parameters)
    (found,) = set_on_load(typed, completed(typed, given(v_camera=name)))
    assert value_of(found) == {"robot": name, "rate": 5}


@pytest.mark.parametrize("name", ["nao", '24" monitor', "back\\slash", "😀"])
def test_individuals_of_a_formula_are_told_the_name_of_another_variable(name: str) -> None:
    (formula,) = parse(FORMULA.format(name)).transformations
    parameters = set_on_load(formula, completed(formula, given(v_r=name)))
    values = {each.name: value_of(each) for each in parameters}
    assert values["individuals"] == {"b": f"B({name}, ?c)", "d": f"D({name}, ?c)"}


# In the life of a nodelet

GIVEN = given(v_camera="cam1", rate="5")


@pytest.fixture
def world(tmp_path: object) -> World:
    world = World(f"{tmp_path}/state.db")
    world.manager.add_transformation(TRACKER)
    return world


def test_a_nodelet_keeps_what_it_was_given_for_life(world: World) -> None:
    with pytest.raises(InvalidParameters):
        world.spawn("tracker", "n")
    assert (world.states(), world.host.parameters) == ({}, {})
    world.spawn("tracker", "n", parameters=GIVEN)
    set_ = {"/n/frame": "cam1_link", "/n/rate": 5}
    assert world.host.parameters == set_
    status = world.manager.graph.get("/n").status
    assert status.parameters == (
        Parameter("?camera", "string", "cam1"),
        Parameter("rate", "int", "5"),
    )
    assert status.request.parameters == status.parameters
    world.host.parameters.clear()
    world.host.kill(status.manager)
    world.kill_manager()
    for _ in range(3):
        world.manager.look()
    assert world.states() == {"/n": "RUNNING"}
    assert world.host.parameters == set_
    assert world.manager.graph.get("/n").status.parameters == status.parameters
    world.manager.destroy("n")
    assert world.host.parameters == {}
