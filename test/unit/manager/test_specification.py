# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parsing specifications: what is accepted, what is refused, and what is said about it."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from specification_strategies import transformations

from dyknow.errors import Problem, SpecificationError
from dyknow.manager.specifications.ontology import load_ontology
from dyknow.manager.specifications.specification import parse, parse_file
from dyknow.manager.specifications.values import value_of
from dyknow.model.transformation import Parameter, Port, Program, Transformation

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[2] / "examples" / "transformations"
BAD = sorted((HERE / "bad").glob("*.xml"))


def problems_of(text, **kwargs):
    with pytest.raises(SpecificationError) as caught:
        parse(text, "x.xml", **kwargs)
    return caught.value.problems


def check(path):
    """Return the problems and the warnings of a file."""
    try:
        return (), parse_file(path).warnings
    except SpecificationError as error:
        return error.problems, error.warnings


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_each_bad_file_is_refused_with_every_problem_and_its_line(path):
    problems, _ = check(str(path))

    found = "".join(f"{problem.line}: {problem.message}\n" for problem in problems)
    assert found == path.with_suffix(".expected").read_text(encoding="utf-8")
    assert {problem.file for problem in problems} == {str(path)}


@pytest.mark.parametrize("name", ["undistort.xml", "relay.xml"])
def test_the_examples_are_clean(name):
    assert check(str(EXAMPLES / name)) == ((), ())


def test_children_may_stand_in_any_order():
    text = """<?xml version="1.0" encoding="utf-8"?>
    <!-- a comment -->
    <transformation cost="7">
      <tags><tag port=" in ">A(b)</tag></tags>
      <ports><port type="in" datatype="p/T">in</port></ports>
      <params><param name="x">1.5</param><param name="y" type="string"/></params>
      <source>p/<!-- in the middle -->A</source>
      <label><![CDATA[<a>]]></label>
    </transformation>"""

    assert parse(text).transformations == (
        Transformation(
            "<a>",
            "p/A",
            cost=7,
            parameters=(Parameter("x", "double", "1.5"), Parameter("y", "string", "")),
            ports=(Port("in", "in", "p/T", ("A(b)",)),),
        ),
    )


def test_a_topic_is_a_transformation_with_one_out_port():
    text = """<transformation type="topic" cost="0"><label>joints</label>
      <source>/joint_states</source><ports><port type="out">joint_states</port></ports>
      <params><param name="x">1</param></params></transformation>"""

    found = parse(text, "x.xml")

    assert found.transformations[0].type == "topic"
    assert found.warnings == (
        Problem("x.xml", 1, "a topic has no parameters; these will never be set"),
    )


def test_a_node_has_a_program_with_arguments():
    text = """<transformation type="node" isolated="true"><label>copier</label>
      <source>topic_tools/relay /scan '/a copy'</source></transformation>"""

    (found,) = parse(text).transformations

    assert found == Transformation(
        "copier", "topic_tools/relay /scan '/a copy'", "node", isolated=True
    )
    assert Program.of(found.source) == Program("topic_tools", "relay", ("/scan", "/a copy"))


def test_a_node_that_others_start_needs_no_source_and_takes_no_parameters():
    text = """<transformation type="node" node="/robot/camera" isolated="true">
      <label>camera</label><ports><port type="out">image</port></ports>
      <params><param name="x">1</param></params></transformation>"""

    found = parse(text, "x.xml")

    assert found.transformations[0].node == "/robot/camera"
    assert found.transformations[0].is_described
    assert [warning.message for warning in found.warnings] == [
        "a node that others start is as they start it; isolated has no effect",
        "a node that others start has no parameters; these will never be set",
    ]


def test_names_that_are_no_ros_names_are_accepted_with_a_warning():
    text = """<transformation><label>a</label><source>p/A</source>
      <params><param name="config-path" type="string">x</param></params>
      <ports><port type="in">raw-camera</port></ports></transformation>"""

    found = parse(text)

    assert [(w.line, w.message.split(" is ")[0]) for w in found.warnings] == [
        (2, "the parameter 'config-path'"),
        (3, "the port 'raw-camera'"),
    ]
    assert found.transformations[0].parameters[0].name == "config-path"


def test_a_tag_that_stands_twice_counts_once():
    text = """<transformation><label>a</label><source>p/A</source>
      <ports><port type="in">in</port></ports>
      <tags><tag port="in">A(b)</tag>
        <tag port="in">A(b)</tag></tags></transformation>"""

    found = parse(text)

    assert found.transformations[0].ports[0].tags == ("A(b)",)
    assert [warning.line for warning in found.warnings] == [4]


def test_a_tag_that_the_planner_cannot_use_is_accepted_with_a_warning():
    text = """<transformation><label>a</label><source>p/A</source>
      <ports><port type="in">in</port><port type="out">out</port></ports><tags>
        <tag port="in">Image(?camera)</tag>
        <tag port="in">Image(camera</tag>
        <tag port="out">http://dyknow.example.org/soccer#Ball</tag></tags></transformation>"""

    found = parse(text)

    assert [(warning.line, warning.message) for warning in found.warnings] == [
        (
            4,
            "the tag 'Image(camera' is passed over by the planner: "
            "expected Functor or Functor(arg, …)",
        ),
    ]
    assert found.transformations[0].ports[0].tags == ("Image(?camera)", "Image(camera")


def test_a_type_that_is_no_class_is_accepted_with_a_warning():
    text = """<transformation><label>a</label><source>p/A</source>
      <ports><port type="in">in</port></ports><tags>
        <tag port="in">Image(?camera: Camera, ?lens: ball)</tag></tags></transformation>"""

    ontology = load_ontology([str(EXAMPLES.parent / "ontologies" / "soccer.ttl")])

    assert parse(text).warnings == ()
    assert [each.message for each in parse(text, ontology=ontology).warnings] == [
        "the tag 'Image(?camera: Camera, ?lens: ball)' has the type 'ball', which is no class of "
        "the ontology"
    ]


def test_yaml_may_be_indented_like_the_xml_around_it():
    text = """<transformation><label>a</label><source>p/A</source><params>
      <param name="lens" type="yaml">
        k: [1, 2]
        model:
          name: fisheye
      </param></params></transformation>"""

    parameter = parse(text).transformations[0].parameters[0]

    assert parameter.text == "k: [1, 2]\nmodel:\n  name: fisheye"
    assert value_of(parameter) == {"k": [1, 2], "model": {"name": "fisheye"}}


def test_a_text_full_of_problems_is_cut_short():
    problems = problems_of("<transformations>" + "<x/>\n" * 5000 + "</transformations>")

    assert len(problems) == 1001
    assert problems[-1].message == "there are more than 1000 problems; the rest is not listed"


def test_a_file_that_cannot_be_read_is_a_problem_too(tmp_path):
    missing = str(tmp_path / "missing.xml")

    assert check(missing)[0] == (Problem(missing, 0, "cannot be read: No such file or directory"),)
    assert check(str(tmp_path))[0][0].message == "cannot be read: Is a directory"


def test_a_byte_order_mark_and_the_mac_and_windows_line_ends_are_fine(tmp_path):
    path = tmp_path / "windows.xml"
    path.write_bytes(
        b"\xef\xbb\xbf<transformation>\r\n<label>\xc3\xa9</label>\r\n<source>p/A</source>"
        b"</transformation>"
    )

    assert parse_file(str(path)).transformations[0].label == "é"


@given(st.one_of(st.text(), st.binary()))
def test_any_text_is_parsed_or_refused(text):
    _parse_or_refuse(text)


@given(transformations, st.data())
def test_any_damaged_specification_is_parsed_or_refused(transformation, data):
    text = transformation.to_xml()
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 20)))
    damage = data.draw(
        st.one_of(
            st.text(max_size=5),
            st.sampled_from(["<", "&", "${", "]]>", "\0", "\ud800", "<!--", "<a>", text]),
        )
    )

    _parse_or_refuse(text[:start] + damage + text[end:])


def _parse_or_refuse(text):
    try:
        found = parse(text, "x.xml")
    except SpecificationError as error:
        assert error.problems
        assert all(0 <= problem.line <= len(text) + 1 for problem in error.problems)
    else:
        for transformation in found.transformations:
            assert parse(transformation.to_xml()).transformations == (transformation,)
