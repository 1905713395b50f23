# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Wirings as XML: the round trip, and everything that is wrong with a file."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from specification_strategies import labels, texts, transformations
from unit.cli.fake_client import cases

from dyknow.errors import SpecificationError
from dyknow.model.graph import SpawnRequest
from dyknow.model.transformation import Parameter
from dyknow.wiring.wiring import Wiring, read_wiring

names = st.from_regex(r"(/[a-z][a-z0-9_]{0,6}){1,3}", fullmatch=True)
ports = st.sampled_from(["in", "~image", "/a/b", "x<&'\"y", "é"])
blanks = st.text(" \t\r\n", max_size=2)
parameters = st.builds(
    Parameter,
    st.sampled_from(["rate", "?camera"]),
    st.sampled_from(["", "string"]),
    st.builds("{}{}{}".format, blanks, texts, blanks),
)
nodelets = st.builds(
    SpawnRequest,
    labels,
    names,
    st.dictionaries(ports, names, max_size=3),
    st.booleans(),
    st.booleans(),
    st.one_of(st.just(""), names),
    st.lists(parameters, max_size=2, unique_by=lambda each: each.name).map(tuple),
)


def _sorted(key: str):
    return lambda items: tuple(sorted(items, key=lambda item: getattr(item, key)))


wirings = st.builds(
    Wiring,
    st.lists(
        transformations,
        max_size=3,
        unique_by=(lambda each: each.label, lambda each: each.node or each.label),
    ).map(_sorted("label")),
    st.lists(nodelets, max_size=4, unique_by=lambda each: each.name).map(_sorted("name")),
)


@given(wirings)
def test_reading_gives_back_what_was_written(wiring: Wiring) -> None:
    text = wiring.to_xml()
    again = read_wiring(text.encode("utf-8"), "w.xml")
    assert again == wiring
    assert again.to_xml() == text


#: Texts that are not wirings, and the error in line 1; WIRING is the beginning of a wiring.
NO_WIRINGS = r"""
 | no element found at column 1; expected well-formed XML
<wiring | unclosed token
<other/> | unexpected <other> as the root; expected <wiring>
<wiring/> | <wiring> has no attribute version; expected one, '1'
<wiring version="2"/> | <wiring version="2">: expected '1'
WIRING\xff</wiring> | the byte 0xff is not UTF-8; expected UTF-8
<!DOCTYPE wiring [<!ENTITY a "b">]>WIRING</wiring> | a DOCTYPE is refused; expected <wiring> alone
WIRING<node/></wiring> | unexpected <node> in <wiring>; expected <nodelets> or <transformations>
WIRING<nodelets/><nodelets/></wiring> | a second <nodelets>; expected one
WIRING!</wiring> | text '!' directly in <wiring>; expected <nodelets> or <transformations>
"""


@pytest.mark.parametrize(("text", "said"), cases(NO_WIRINGS))
def test_what_is_no_wiring_is_refused(text: str, said: str) -> None:
    data = text.replace("WIRING", '<wiring version="1">').encode()
    with pytest.raises(SpecificationError) as refused:
        read_wiring(data.replace(rb"\xff", b"\xff"), "w.xml")
    found = list(map(str, refused.value.problems))
    assert any(problem.startswith(f"w.xml:1: {said}") for problem in found), found


BROKEN = """<wiring version="1">
<transformations>
  <transformation>
    <label>a</label>
  </transformation>
  <nonsense/>
</transformations>
<nodelets>
  <nodelet name="a" transformation="t"/>
  <nodelet name="/b" protected="maybe" colour="red">
    <connection port="in" topic="/x y"/>
    <connection port="out"/>
    <connection port="in" topic="/z"/>
  </nodelet>
  <nodelet name="/b" transformation="t"><what><ever/></what></nodelet>
</nodelets>
</wiring>"""


def test_every_problem_is_told_with_its_line() -> None:
    with pytest.raises(SpecificationError) as refused:
        read_wiring(BROKEN.encode(), "w.xml")
    found = list(map(str, refused.value.problems))
    lines = [int(problem.split(":")[1]) for problem in found]
    assert lines == sorted(lines)
    text = "\n".join(found)
    assert "w.xml:3: " in text and "w.xml:6: " in text  # the specification's own
    for said in (
        "w.xml:9: name=\"a\"; expected a global name, '/a'",
        "w.xml:10: <nodelet> has no attribute transformation; expected one",
        "w.xml:10: <nodelet protected=\"maybe\">: expected 'true' or 'false' or ",
        "w.xml:10: unexpected attribute colour of <nodelet>; expected host or isolated or manager",
        "w.xml:11: '/x y' is not a valid topic",
        "w.xml:12: <connection> has no attribute topic; expected one",
        "w.xml:13: the port 'in' is there already; expected it once",
        "w.xml:15: unexpected <what> in <nodelet>; expected <connection>",
    ):
        assert said in text, found
    assert "the nodelet '/b' is there already, in line 10" in text


def test_a_nodelet_twice_in_one_line_is_refused() -> None:
    twice = '<nodelet name="/a" transformation="t"/>' * 2
    with pytest.raises(SpecificationError, match="the nodelet '/a' is there already, in line 1"):
        read_wiring(f'<wiring version="1"><nodelets>{twice}</nodelets></wiring>'.encode(), "w.xml")


def test_a_slash_at_the_end_of_a_name_is_none() -> None:
    (nodelet,) = read_wiring(
        b'<wiring version="1"><nodelets><nodelet name="/a/" transformation="t" manager="/m/">'
        b'<connection port="in" topic="/b/"/></nodelet></nodelets></wiring>',
        "w.xml",
    ).nodelets
    assert (nodelet.name, nodelet.manager, nodelet.config) == ("/a", "/m", {"in": "/b"})


def test_a_wiring_of_too_many_nodelets_is_read_no_further() -> None:
    asked = []

    def limit() -> int:
        asked.append(True)
        return 2500

    nodelet = '<nodelet name="/n{}" transformation="a"/>\n'
    text = "".join(map(nodelet.format, range(2500)))
    wiring = '<wiring version="1"><nodelets>\n{}</nodelets></wiring>'
    with pytest.raises(SpecificationError):
        read_wiring(wiring.format(text).encode(), "w.xml")
    assert len(read_wiring(wiring.format(text).encode(), "w.xml", limit).nodelets) == 2500
    with pytest.raises(SpecificationError) as refused:
        # The text after the limit is not even XML.
        read_wiring(wiring.format(text + nodelet.format("") + "<<").encode(), "w.xml", limit)
    (problem,) = refused.value.problems
    assert "more than 2500 nodelets; the manager allows no more" in str(problem)
    assert problem.line == 2502
    assert asked, "the manager may allow more than it does by default"
