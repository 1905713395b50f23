"""The schema, and the agreement of the reader with a real RelaxNG validator about it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree
from specification_strategies import transformations

from dyknow.manager.specifications.findings import Findings
from dyknow.manager.specifications.grammar import SCHEMA, UnsupportedSchema, roots
from dyknow.manager.specifications.limits import DEFAULT_LIMITS
from dyknow.manager.specifications.reader import read

SCHEMA_OF_LIBXML2 = etree.RelaxNG(etree.parse(str(SCHEMA)))

NAMES = st.sampled_from(
    ["transformations", "transformation", "label", "source", "args", "arg", "params", "param",
     "ports", "port", "tags", "tag", "other"]
)  # fmt: skip
ATTRIBUTES = st.dictionaries(
    st.sampled_from(["type", "name", "label", "port", "datatype", "other"]),
    st.sampled_from(["in", "out", "nodelet", "topic", "string", " int ", "", "x"]),
    max_size=2,
)


def element(name, attributes, text, children):
    made = etree.Element(name, attributes)
    made.text = text
    made.extend(children)
    return made


TREES = st.recursive(
    st.builds(element, NAMES, ATTRIBUTES, st.sampled_from(["", " ", "x"]), st.just([])),
    lambda children: st.builds(
        element,
        NAMES,
        ATTRIBUTES,
        st.sampled_from(["", "\n", "x"]),
        st.lists(children, max_size=4),
    ),
    max_leaves=8,
)


def reader_accepts(text):
    findings = Findings("x.xml", 1000)
    list(read(text, findings, DEFAULT_LIMITS))
    return not findings.problems


@given(TREES)
def test_the_reader_and_libxml2_agree_on_any_tree(tree):
    text = etree.tostring(tree)

    assert reader_accepts(text) == SCHEMA_OF_LIBXML2.validate(etree.fromstring(text))


@given(transformations, st.data())
def test_the_reader_and_libxml2_agree_on_a_damaged_specification(transformation, data):
    tree = etree.fromstring(transformation.to_xml())
    nodes = list(tree.iter())
    node = data.draw(st.sampled_from(nodes))
    damage = data.draw(
        st.sampled_from(["none", "remove", "double", "rename", "text", "attribute"])
    )
    if damage in ("remove", "double") and node.getparent() is not None:
        node.getparent().append(etree.fromstring(etree.tostring(node, with_tail=False)))
        if damage == "remove":
            for twin in [n for n in node.getparent() if n.tag == node.tag]:
                twin.getparent().remove(twin)
    elif damage == "rename":
        node.tag = data.draw(NAMES)
    elif damage == "text":
        node.text = "text"
    elif damage == "attribute":
        node.attrib.update(data.draw(ATTRIBUTES))
    text = etree.tostring(tree)

    assert reader_accepts(text) == SCHEMA_OF_LIBXML2.validate(etree.fromstring(text))


def test_the_rules_are_those_of_the_schema():
    rule = roots()["transformation"]

    assert sorted(roots()) == ["transformation", "transformations"]
    assert rule.required == ("label", "source")
    assert rule.attributes["type"].values == ("nodelet", "topic")
    assert roots()["transformations"].repeated == ("transformation",)
    assert rule.children["ports"].children["port"].required_attributes == ("type",)


def test_a_pattern_that_is_not_understood_is_not_passed_over(tmp_path):
    path = tmp_path / "new.rng"
    path.write_text(
        '<grammar xmlns="http://relaxng.org/ns/structure/1.0"><start><element name="a"><mixed/>'
        "</element></start></grammar>"
    )

    with pytest.raises(UnsupportedSchema, match="<mixed> in the rules of <a>"):
        roots(path)
