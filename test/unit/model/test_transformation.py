# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Transformations as values, and their canonical XML."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from specification_strategies import transformations

from dyknow.manager.specifications.specification import parse
from dyknow.manager.specifications.values import value_of
from dyknow.model.transformation import Parameter, Port, Transformation

UNDISTORT = Transformation(
    label="undistort(cam1)",
    source="package/Undistort",
    parameters=(Parameter("config-path", "string", "/path/cam1/"),),
    ports=(
        Port("undist", "out", "sensor_msgs/Image", ("Undistorted(cam1)", "Image(cam1)")),
        Port("rawcamera", "in"),
    ),
)


@given(
    st.lists(
        transformations, max_size=5, unique_by=(lambda t: t.label, lambda t: t.node or t.label)
    )
)
def test_many_transformations_survive_together(many):
    text = "<transformations>" + "".join(t.to_xml() for t in many) + "</transformations>"

    assert parse(text).transformations == tuple(many)


def test_the_canonical_xml_is_what_a_person_would_write():
    assert UNDISTORT.to_xml() == (
        '<transformation type="nodelet" cost="1">\n'
        "  <label>undistort(cam1)</label>\n"
        "  <source>package/Undistort</source>\n"
        "  <params>\n"
        '    <param name="config-path" type="string">/path/cam1/</param>\n'
        "  </params>\n"
        "  <ports>\n"
        '    <port type="out" datatype="sensor_msgs/Image">undist</port>\n'
        '    <port type="in">rawcamera</port>\n'
        "  </ports>\n"
        "  <tags>\n"
        '    <tag port="undist">Undistorted(cam1)</tag>\n'
        '    <tag port="undist">Image(cam1)</tag>\n'
        "  </tags>\n"
        "</transformation>\n"
    )


def test_a_mapping_read_from_a_parameter_belongs_to_the_reader():
    parameter = Parameter("lens", "yaml", "{k1: 0.5}")

    value: Any = value_of(parameter)
    value["k1"] = 7

    assert value_of(parameter) == {"k1": 0.5}
