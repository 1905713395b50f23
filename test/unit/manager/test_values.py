# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The values of parameters."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from roslaunch.loader import convert_value

from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.values import BadValue, filled, infer_type, parse_value

TYPES = {"int": int, "double": float, "bool": bool, "string": str}


@pytest.mark.parametrize(
    ("type_", "text", "value"),
    [
        ("string", "", ""),
        ("string", "a  b", "a  b"),
        ("int", "-2147483648", -(2**31)),
        ("int", "+7", 7),
        ("int", "007", 7),
        ("double", "1", 1.0),
        ("double", "-1.5e-3", -0.0015),
        ("double", ".5", 0.5),
        ("double", "2.", 2.0),
        ("double", "inf", float("inf")),
        ("bool", "True", True),
        ("bool", "0", False),
        ("yaml", "{a: [1, 2.5, yes, x]}", {"a": [1, 2.5, True, "x"]}),
        ("yaml", "3", 3),
    ],
)
def test_values_are_what_the_parameter_server_is_to_hold(type_, text, value):
    found = parse_value(type_, text)

    assert found == value
    assert type(found) is type(value)


ALIKE = ["1", "-0.5", "1.e3", "1e3", "nan", "-inf", "TRUE", "yes", "", "1.2.3", "1e400", "nan."]


@pytest.mark.parametrize("text", ALIKE)
def test_a_parameter_without_type_gets_the_one_roslaunch_would_give(text):
    assert type(convert_value(text, "auto")) is TYPES[infer_type(text)]


@given(st.text("0123456789+-.eEx", max_size=8))
def test_each_text_gets_the_type_that_roslaunch_gives(text):
    assert type(convert_value(text, "auto")) is TYPES[infer_type(text)]


@pytest.mark.parametrize("text", ["1e400", "-1.0e999", "9" * 400])
def test_a_number_that_a_double_cannot_hold_is_refused(text):
    with pytest.raises(BadValue, match="expected a double of 64 bits, or inf, found"):
        parse_value("double", text)
    assert parse_value("double", "-Inf") == float("-inf")


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("{robot: ${?r}, rate: 5}", "no", {"robot": "no", "rate": 5}),
        ("- ${?r}", "7", ["7"]),
        ("[${?r}, '${?r}', \"${?r}\"]", "24\" 'x'", ["24\" 'x'"] * 3),
        ("${?r}", "~", "~"),
        ("${?r}_${?s}: [1.0e+20, .inf]", "a: b", {"a: b_left": [1e20, float("inf")]}),
        ("a: |\n  ${?r}\n  b\n", "camera #2", {"a": "camera #2\nb\n"}),
        ("['$${?r}', $$${?r}, \ue0000\ue002]", "x", ["${?r}", "$x", "\ue0000\ue002"]),
        ("[true, ${?r}] # ${?s}", "null", [True, "null"]),
    ],
)
def test_in_yaml_a_placeholder_stands_for_the_name(text, name, value):
    names = {"?r": name, "?s": "left"}
    assert parse_value("yaml", filled("yaml", text, names)) == value


@given(st.text(st.characters(blacklist_categories=("Cc", "Cs")), min_size=1))
def test_any_name_can_stand_in_yaml(name):
    text = filled("yaml", "{x: [${?r}, 'a ${?r}'], ${?r}: 1}", {"?r": name})
    assert parse_value("yaml", text) == {"x": [name, f"a {name}"], name: 1}


@pytest.mark.parametrize(
    ("type_", "text"),
    [
        ("yaml", '{text: "bell \\a"}'),
        ("yaml", '["\\0"]'),
        ("yaml", '{"\\e": 1}'),
        ("yaml", '"a\\r\\nb"'),
        ("string", "a\r\nb"),
        ("string", "bell \a"),
        ("string", "half \ud800"),
    ],
)
def test_text_that_the_parameter_server_cannot_hold_is_refused(type_, text):
    with pytest.raises(BadValue, match="expected text without control characters") as caught:
        parse_value(type_, text)
    assert str(caught.value).isprintable()
    assert parse_value("yaml", '"a\\tb\\nc"') == "a\tb\nc"


def test_an_unknown_type_names_the_known_ones():
    with pytest.raises(BadValue, match="string, int, double, bool or yaml, found 'float'"):
        parse_value("float", "1")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[" * 40, "nested at most 8 deep"),
        ("[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]", "at most 10 values"),
        ("{a: &x [1], b: *x}", "without aliases"),
        ("{<<: {a: 1}, b: !!int x}", "a value cannot be read"),
        ("!!int '" + "1" * 10**6 + "'", "at most 400 digits"),
        ("1:" * 1000 + "1", "at most 400 digits"),
        ("!!set {a, b}", "found a set"),
        ("2001-99-99", "a value cannot be read"),
    ],
)
def test_yaml_that_grows_or_does_not_fit_is_refused(text, expected):
    with pytest.raises(BadValue, match=expected):
        parse_value("yaml", text, SpecificationLimits(yaml_nodes=10, nesting=8))
