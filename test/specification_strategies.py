# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Strategies for the property tests of specifications."""

from hypothesis import strategies as st

from dyknow.manager.specifications.specification import parse
from dyknow.model.transformation import Parameter, Port, Program, Requirement, Transformation

BLANK = " \t\r\n"
CHARACTERS = st.characters(
    blacklist_categories=["Cs"],
    blacklist_characters=[chr(c) for c in range(32) if chr(c) not in "\t\n\r"]
    + ["\ufffe", "\uffff"],
)


def _stripped(text):
    return text.strip(BLANK)


texts = st.one_of(
    st.text(CHARACTERS, max_size=20),
    st.sampled_from(["${X}", "$${X}", "$$", "a ${", "<&>\"'", "]]>", "a\r\nb", "cam1", "é…"]),
).map(_stripped)
labels = texts.filter(bool)
names = st.one_of(
    st.from_regex(r"[a-z][a-z0-9_]{0,8}(/[a-z]{1,4})?", fullmatch=True),
    st.sampled_from(["config-path", "a&b", "x<y", "${P}", "über"]),
)
datatypes = st.sampled_from(["", "std_msgs/Header", "sensor_msgs/Image"])
parameters = st.one_of(
    st.builds(Parameter, names, st.just("string"), texts.filter(lambda text: "\r" not in text)),
    st.builds(Parameter, names, st.just("int"), st.integers(-(2**31), 2**31 - 1).map(str)),
    st.builds(Parameter, names, st.just("double"), st.floats().map(repr)),
    st.builds(Parameter, names, st.just("bool"), st.sampled_from(["true", "False", "0", "1"])),
    st.builds(
        Parameter,
        names,
        st.just("yaml"),
        st.sampled_from(["[1, 2.5, x]", "a:\n  b: [1]\nc: d", "- x\n- y: true", "'#'"]),
    ),
)
port_names = st.one_of(names, st.sampled_from(["~image", "/camera/image_raw"]))
tags = st.lists(labels, max_size=3, unique=True).map(tuple)
stated = st.one_of(st.just(0.0), st.integers(0, 10**12).map(lambda number: number / 10**6))
ports = st.one_of(
    st.builds(Port, port_names, st.just("in"), datatypes, tags, st.just(0.0), st.just(0.0)),
    st.builds(Port, port_names, st.just("out"), datatypes, tags, stated, stated),
)


def _unique(items):
    return st.lists(items, max_size=4, unique_by=lambda item: item.name).map(tuple)


costs = st.integers(0, 2**32 - 1)
programs = st.builds(
    lambda name, arguments: Program(name[0], name[1], tuple(arguments)).source,
    st.sampled_from([("topic_tools", "relay"), ("my-pkg", "node.py")]),
    st.lists(st.sampled_from(["/scan", "${X}", "a b", "it's", "", "x\ty", "<&>"]), max_size=3),
)
requires = st.lists(
    st.builds(Requirement, st.sampled_from(["Holds(charged, nao)", "Raining"]), st.booleans()),
    max_size=2,
    unique=True,
).map(tuple)
FORMULAS = """
<transformations>
  <transformation type="formula" cost="3" isolated="true">
    <label>charged &amp; there</label>
    <formula period="0.5" hold="2" exact="true">
      a.x &lt; 1 and every ?c: Camera (rate(b) &gt; 5)
    </formula>
    <ports>
      <port type="in" datatype="sensor_msgs/BatteryState">a</port>
      <port type="out">holds</port>
      <port type="in" datatype="sensor_msgs/Image">b</port>
    </ports>
    <tags>
      <tag port="a">Battery(?robot: Robot)</tag>
      <tag port="holds">Holds(charged, ?robot)</tag>
      <tag port="b">Image(?robot, ?c: Camera)</tag>
    </tags>
    <requires initially="false">Holds(there, ?robot)</requires>
  </transformation>
  <transformation type="formula">
    <label>late</label>
    <formula>age(image) &gt; 500 ms implies 'a' != image.frame</formula>
    <ports>
      <port type="in" datatype="sensor_msgs/Image">image</port>
      <port type="out">late</port>
    </ports>
  </transformation>
</transformations>
"""
node_names = st.sampled_from(["/camera_driver", "/robot/camera"])
transformations = st.one_of(
    st.builds(
        Transformation,
        labels,
        names,
        st.just("nodelet"),
        costs,
        _unique(parameters),
        _unique(ports),
        st.booleans(),
        st.just(""),
        requires,
    ),
    st.builds(
        Transformation,
        labels,
        programs,
        st.just("node"),
        costs,
        _unique(parameters),
        _unique(ports),
        st.booleans(),
        st.just(""),
        requires,
    ),
    st.builds(
        Transformation,
        labels,
        st.one_of(st.just(""), programs),
        st.just("node"),
        costs,
        st.just(()),
        _unique(ports),
        st.just(False),
        node_names,
        requires,
    ),
    st.builds(
        Transformation,
        labels,
        names,
        st.just("topic"),
        costs,
        st.just(()),
        ports.map(lambda port: (port._replace(direction="out"),)),
        st.just(False),
        st.just(""),
        requires,
    ),
    st.sampled_from(parse(FORMULAS).transformations),
)
