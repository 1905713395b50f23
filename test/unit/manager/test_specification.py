# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parsing specifications: accepted and refused texts, hostile ones, warnings and problems."""

import contextlib
import json
import sys
import threading
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from specification_strategies import transformations

from dyknow.errors import Problem, SpecificationError
from dyknow.manager.planning.explanation import read_tree, tree_as_dot
from dyknow.manager.specifications import findings
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.ontologies.ontology import Ontology
from dyknow.manager.specifications.specification import parse, parse_file
from dyknow.manager.specifications.tags import read_tags
from dyknow.manager.specifications.values import filled, infer_type, parse_value, value_of
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import Parameter, Port, Program, Transformation

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[2] / "examples" / "transformations"
BAD = sorted((HERE / "bad").glob("*.xml"))


LONG = 2**19
GOOD = "<transformation><label>a</label><source>p/A</source></transformation>"


def problems_of(text, **limits):
    """The lines and messages of a text's problems."""
    with pytest.raises(SpecificationError) as caught:
        parse(text, "x.xml", limits=SpecificationLimits(**limits))
    return [(problem.line, problem.message) for problem in caught.value.problems]


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


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (  # children in any order
            """<?xml version="1.0" encoding="utf-8"?><!-- a comment -->
            <transformation cost="7">
            <tags><tag port=" in ">A(b)</tag><tag port="in">A(b)</tag></tags>
            <ports><port type="in" datatype="p/T">in</port></ports>
            <params><param name="x">1.5</param><param name="y" type="string"/></params>
            <source>p/<!-- in the middle -->A</source>
            <label><![CDATA[<a>]]></label></transformation>""",
            Transformation(
                "<a>",
                "p/A",
                cost=7,
                parameters=(Parameter("x", "double", "1.5"), Parameter("y", "string", "")),
                ports=(Port("in", "in", "p/T", ("A(b)",)),),
            ),
        ),
        (
            """<transformation type="topic" cost="0"><label>joints</label>
            <source>/states</source><ports><port type="out">s</port></ports></transformation>""",
            Transformation("joints", "/states", "topic", cost=0, ports=(Port("s", "out"),)),
        ),
        (
            """<transformation type="node" isolated="true"><label>copier</label>
            <source>topic_tools/relay /scan '/a copy'</source></transformation>""",
            Transformation("copier", "topic_tools/relay /scan '/a copy'", "node", isolated=True),
        ),
        (  # a user starts it
            """<transformation type="node" node="/robot/camera"><label>camera</label>
            </transformation>""",
            Transformation("camera", "", "node", node="/robot/camera"),
        ),
    ],
)
def test_each_kind_of_transformation_is_read(text, expected):
    assert parse(text).transformations == (expected,)


def test_a_program_has_arguments():
    source = "topic_tools/relay /scan '/a copy'"

    assert Program.of(source) == Program("topic_tools", "relay", ("/scan", "/a copy"))


SOURCE = "<label>a</label><source>p/A</source>"
IMAGE = f'<transformation>{SOURCE}<ports><port type="in">in</port></ports>'


@pytest.mark.parametrize(
    ("text", "warnings"),
    [
        (
            """<transformation type="topic"><label>a</label><source>/a</source>
            <ports><port type="out">a</port></ports>
            <params><param name="x">1</param></params></transformation>""",
            [(1, "a topic has no parameters; these will never be set")],
        ),
        (
            """<transformation type="node" node="/a" isolated="true"><label>a</label>
            <params><param name="x">1</param></params></transformation>""",
            [
                (1, "a node that others start is as they start it; isolated has no effect"),
                (1, "a node that others start has no parameters; these will never be set"),
            ],
        ),
        (
            f"""<transformation>{SOURCE}
            <params><param name="config-path" type="string">x</param></params>
            <ports><port type="in">raw-camera</port></ports></transformation>""",
            [(2, "the parameter 'config-path' is"), (3, "the port 'raw-camera' is")],
        ),
        (
            f"""{IMAGE}<tags><tag port="in">A(b)</tag>
            <tag port="in">A(b)</tag></tags></transformation>""",
            [(2, "")],
        ),
        (
            f"""{IMAGE}<tags><tag port="in">Image(?camera)</tag>
            <tag port="in">http://dyknow.example.org/soccer#Ball</tag>
            <tag port="in">Image(camera</tag></tags></transformation>""",
            [(3, "the tag 'Image(camera' is passed over by the planner: expected Functor or")],
        ),
    ],
)
def test_what_has_no_effect_is_accepted_with_a_warning(text, warnings):
    found = parse(text).warnings

    assert [warning.line for warning in found] == [line for line, _ in warnings]
    assert all(each.message.startswith(said) for each, (_, said) in zip(found, warnings))


def test_a_type_that_is_no_class_is_accepted_with_a_warning():
    text = f"""{IMAGE}<tags>
        <tag port="in">Image(?camera: Camera, ?lens: ball)</tag></tags></transformation>"""
    ontology = Ontology([str(EXAMPLES.parent / "ontologies" / "soccer.ttl")])

    assert parse(text).warnings == ()
    assert [each.message for each in parse(text, ontology=ontology).warnings] == [
        "the tag 'Image(?camera: Camera, ?lens: ball)' has the type 'ball', which is no class of "
        "the ontology"
    ]


def test_the_concept_of_a_quantifier_restricts_the_tags_of_its_ports():
    text = """<transformation type="formula"><label>all</label>
        <ports><port type="in" datatype="std_msgs/Bool">image</port>
        <port type="in" datatype="std_msgs/Bool">scan</port><port type="out">holds</port></ports>
        <tags><tag port="image">Image(?c)</tag><tag port="scan">Scan(?d: Laser)</tag></tags>
        <formula>every ?c: Camera (image) and some ?c (image) and every ?d (scan)</formula>
        </transformation>"""
    (found,) = parse(text).transformations
    given = {each.name: each.text for each in found.parameters}
    tags = {"image": "Image(?c: Camera)", "scan": "Scan(?d: Laser)"}
    assert json.loads(given["individuals"]) == tags

    ontology = Ontology([str(EXAMPLES.parent / "ontologies" / "soccer.ttl")])
    text = text.replace("Camera", "Camra").replace("?d: Laser", "?d")
    assert [each.message for each in parse(text, ontology=ontology).warnings] == [
        "a quantifier has the concept 'Camra', which is no class of the ontology"
    ]


def test_a_setting_of_a_formula_that_is_given_is_set_even_if_it_is_the_default_of_most():
    """A formula over verdicts has another delay unless it states one."""
    text = """<transformation type="formula"><label>all</label>
        <ports><port type="in" datatype="std_msgs/Bool">on</port><port type="out">holds</port>
        </ports><formula delay="0.1">on.data</formula></transformation>"""
    (found,) = parse(text).transformations
    assert Parameter("delay", "double", "0.1") in found.parameters
    assert "period" not in {each.name for each in found.parameters}


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
    assert problems[-1][1] == "there are more than 1000 problems; the rest is not listed"


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


# Sizes, depths and encodings of hostile texts


@pytest.mark.parametrize("convert", [str, str.encode])
def test_a_text_whose_encoded_size_is_too_large_is_refused_unread(convert):
    text, size = convert(GOOD.replace("a<", "é<")), len(GOOD) + 1

    assert parse(text, limits=SpecificationLimits(text_size=size)).transformations
    assert problems_of(text, text_size=size - 1) == [
        (0, f"the text has {size} bytes; expected at most {size - 1}")
    ]


def test_values_that_are_too_long_are_refused_in_elements_and_attributes():
    text = (
        f"<transformation><label>{'x' * 11}</label>\n<source>p/A</source>\n"
        f'<ports><port type="in" datatype="{"y" * 12}">in</port></ports></transformation>'
    )

    assert problems_of(text, string_length=10) == [
        (1, "<label> has 11 characters; expected at most 10"),
        (3, "attribute datatype has 12 characters; expected at most 10"),
    ]


def test_deep_nesting_ends_the_reading():
    text = GOOD.replace("</label>", "<a>" * 10**6)

    assert problems_of(text)[-1] == (1, "elements nest deeper than 32")


def test_too_many_ports_end_the_reading():
    ports = "".join(f'<port type="in">p{number}</port>\n' for number in range(6))
    text = GOOD.replace("</source>", f"</source><ports>{ports}</ports>")

    assert len(parse(text, limits=SpecificationLimits(items=6)).transformations[0].ports) == 6
    assert problems_of(text, items=5) == [
        (6, "more than 5 args, params, ports and tags in one <transformation>")
    ]


def test_the_same_problem_without_end_ends_the_reading(monkeypatch):
    monkeypatch.setattr(findings, "_MAX_REPETITIONS", 1000)

    assert problems_of("<transformations>" + "<a/>" * 2000) == [
        (1, "unexpected <a> in <transformations>; expected <transformation>")
    ]


def test_the_yaml_of_a_text_is_limited_as_a_whole():
    params = "".join(f'<param name="p{n}" type="yaml">[{n}, 1]</param>' for n in range(4))
    text = GOOD.replace("</source>", f"</source><params>{params}</params>")

    assert parse(text, limits=SpecificationLimits(yaml_size=24)).transformations
    assert problems_of(text, yaml_size=23) == [(1, "more than 23 characters of YAML in this text")]


@pytest.mark.parametrize(
    "text",
    ["<transformation " + "x='y' " * 3_000_000, "<!--" + "x" * 20_000_000, "<" + "a" * 20_000_000],
    ids=["tag", "comment", "name"],
)
def test_a_tag_that_does_not_end_is_not_kept_for_ever(text):
    assert problems_of(text) == [(1, "a tag or comment here is too long")]


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (variables_of, "$" * LONG + "x${?a}"),
        (partial(parse_value, "double"), "1" * LONG + "x"),
        (infer_type, "1" * LONG + "x."),
        (partial(filled, "yaml", names={"?a": "b"}), "\ue000" + "\ue001" * LONG + "${?a}"),
        (lambda text: read_tags(tuple(f"{text}{each}?" for each in range(2**12))), " " * 4090),
        (read_tree, "plan\n" + "─ " * LONG),
        (lambda text: tree_as_dot(f"plan\n└─ {text} (new)"), "a [?" + "=" * LONG),
    ],
    ids=["dollars", "double", "type", "YAML", "tags", "plan", "bindings"],
)
def test_a_text_is_read_in_the_time_of_its_length(read, text):
    """Or for minutes, if that grows with its square."""
    with contextlib.suppress(ValueError):
        read(text)


def test_what_is_complete_before_the_end_of_the_reading_is_checked_too():
    text = "<transformations>" + GOOD.replace("p/A", "") + "\n<?a?>\n" + "<a>" * 99

    assert [line for line, _ in problems_of(text)] == [1, 2, 3, 3]


def test_half_a_surrogate_pair_is_refused_with_its_line():
    text = GOOD.replace("<source>", "\n\ud800<source>")

    assert problems_of(text) == [(2, "half of a surrogate pair; expected UTF-8")]


def test_nothing_is_fetched_and_no_file_is_opened():
    opened = []
    #: A hook stays; earlier tests leave threads.
    watched = {threading.get_ident()}

    def hook(event, args):
        is_access = event.startswith("socket.") or event == "open"
        if is_access and threading.get_ident() in watched:
            opened.append((event, args))

    parse(GOOD)  # the schema is read once
    sys.addaudithook(hook)
    try:
        for text in (
            '<!DOCTYPE a SYSTEM "http://localhost:1/a.dtd">' + GOOD,
            '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>' + GOOD.replace("p/A", "&x;"),
            '<transformations xmlns:xi="http://www.w3.org/2001/XInclude">'
            '<xi:include href="file:///etc/passwd"/></transformations>',
            '<?xml-stylesheet href="http://localhost:1/"?>' + GOOD,
        ):
            with pytest.raises(SpecificationError):
                parse(text)
    finally:
        watched.clear()
    assert opened == []
