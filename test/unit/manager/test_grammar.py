# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The schema, and the agreement of the reader with a real RelaxNG validator about it."""

import contextlib
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from lxml import etree
from specification_strategies import transformations

from dyknow.manager.specifications import specification
from dyknow.manager.specifications.findings import EnoughProblems, Findings
from dyknow.manager.specifications.specification import TRANSFORMATION, TRANSFORMATIONS
from dyknow.manager.specifications.xml_reader import XmlReader

SCHEMA = Path(specification.__file__).with_name("transformations.rng")
SCHEMA_OF_LIBXML2 = etree.RelaxNG(etree.parse(str(SCHEMA)))


NAMES = st.sampled_from(
    ["transformations", "transformation", "label", "source", "args", "arg", "params", "param",
     "ports", "port", "tags", "tag", "formula", "requires", "other"]
)  # fmt: skip
_VALUES = st.sampled_from(
    ["in", "out", "nodelet", "node", "topic", "formula", "string", " int ", "", "x"]
)
# Of numbers the schema says the range; the reader leaves that to the builder.
_NUMBERS = st.just("2.5")
_BOOLEANS = st.sampled_from(["true", "false", "x"])
ATTRIBUTES = st.fixed_dictionaries(
    {},
    optional={
        **dict.fromkeys(["type", "name", "label", "port", "datatype", "node", "other"], _VALUES),
        **dict.fromkeys(["rate", "latency", "period", "hold", "delay", "max_nodes"], _NUMBERS),
        **dict.fromkeys(["isolated", "exact", "initially"], _BOOLEANS),
    },
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
    findings = Findings("x.xml")
    with contextlib.suppress(EnoughProblems):
        list(XmlReader(findings, TRANSFORMATION, TRANSFORMATIONS).read(text))
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
