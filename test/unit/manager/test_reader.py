# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reading safely: sizes, depths and encodings of hostile texts."""

import socket
import sys

import pytest

from dyknow.errors import SpecificationError
from dyknow.manager.specifications import findings
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.specification import parse

GOOD = "<transformation><label>a</label><source>p/A</source></transformation>"


def problems_of(text, **limits):
    with pytest.raises(SpecificationError) as caught:
        parse(text, "x.xml", limits=SpecificationLimits(**limits))
    return [(problem.line, problem.message) for problem in caught.value.problems]


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


def test_what_is_complete_before_the_end_of_the_reading_is_checked_too():
    text = "<transformations>" + GOOD.replace("p/A", "") + "\n<?a?>\n" + "<a>" * 99

    assert [line for line, _ in problems_of(text)] == [1, 2, 3, 3]


def test_half_a_surrogate_pair_is_refused_with_its_line():
    text = GOOD.replace("<source>", "\n\ud800<source>")

    assert problems_of(text) == [(2, "half of a surrogate pair; expected UTF-8")]


def test_nothing_is_fetched_and_no_file_is_opened(monkeypatch):
    opened = []
    seen = {"active": True}

    def hook(event, args):
        if seen["active"] and (event.startswith("socket.") or event == "open"):
            opened.append((event, args))

    parse(GOOD)  # the schema is read once
    monkeypatch.setattr(socket, "socket", None)
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
        seen["active"] = False
    assert opened == []
