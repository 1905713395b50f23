# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The elements of specifications: what `transformations.rng` says, in the reader's words.

The schema is for people and their editors; a test compares the two.
"""

from __future__ import annotations

from dyknow.manager.specifications.xml_reader import ANY, NEEDED, Attribute, Element

_ARG = Element("arg", attributes={"label": NEEDED}, holds_text=True, may_repeat=True)
_PARAM = Element(
    "param",
    attributes={"name": NEEDED, "type": Attribute(("string", "int", "double", "bool", "yaml"))},
    holds_text=True,
    may_repeat=True,
)
_PORT = Element(
    "port",
    attributes={
        "type": Attribute(("in", "out"), is_required=True),
        "datatype": ANY,
        "rate": ANY,
        "latency": ANY,
    },
    holds_text=True,
    may_repeat=True,
)
_TAG = Element("tag", attributes={"port": NEEDED}, holds_text=True, may_repeat=True)

TRANSFORMATION = Element(
    "transformation",
    Element("label", holds_text=True, is_required=True),
    Element("source", holds_text=True, is_required=True, unless="node"),
    Element("args", _ARG),
    Element("params", _PARAM),
    Element("ports", _PORT),
    Element("tags", _TAG),
    attributes={
        "type": Attribute(("nodelet", "node", "topic")),
        "cost": ANY,
        "isolated": Attribute(("true", "false")),
        "node": ANY,
    },
    may_repeat=True,
)
TRANSFORMATIONS = Element("transformations", TRANSFORMATION)
