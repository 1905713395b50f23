# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Placeholders in the texts of parameters: their values, and texts that stand for themselves."""

from __future__ import annotations

from typing import Dict, List, Union

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow.manager.specifications.specification import parse
from dyknow.model.placeholders import Placeholder, cut, fill, join

NAMES: Dict[str, str] = {"?x": "cam1", "?long name": "${?x}"}
PLAIN = st.text(st.sampled_from("${}?xX"), max_size=6)
PIECES = st.lists(st.one_of(PLAIN, st.sampled_from(sorted(NAMES)).map(Placeholder)), max_size=6)


@pytest.mark.parametrize(
    ("text", "filled"),
    [
        ("${?x}", "cam1"),
        ("/dev/${?x}/${ ?x}", "/dev/cam1/${ ?x}"),
        ("${?x }${?x}", "cam1cam1"),
        ("$${?x}", "${?x}"),
        ("$$${?x}", "$cam1"),
        ("$$$${?x}", "$${?x}"),
        ("$$ ${X} $${X}", "$$ ${X} $${X}"),
        ("${?long name}", "${?x}"),
    ],
)
def test_names_are_put_for_placeholders_in_one_pass(text: str, filled: str) -> None:
    assert fill(text, NAMES) == filled


def test_a_placeholder_that_does_not_end_is_an_error() -> None:
    with pytest.raises(ValueError, match="without '}'"):
        cut("a ${?x")


@given(PIECES)
def test_what_is_joined_is_cut_into_the_same(pieces: List[Union[str, Placeholder]]) -> None:
    text = join(pieces)
    assert join(cut(text)) == text
    meant = [NAMES[each.variable] if isinstance(each, Placeholder) else each for each in pieces]
    assert fill(text, NAMES) == "".join(meant)


@given(st.lists(st.one_of(PLAIN.map(lambda text: text.replace(";", "")), st.none()), max_size=4))
def test_what_a_template_brings_in_is_plain(terms: List[Union[str, None]]) -> None:
    """A term is not searched for placeholders, nor is its combination with its neighbours."""
    args = {f"A{number}": term for number, term in enumerate(terms) if term}
    written = "".join(f'<arg label="{each}">{{{term}}}</arg>' for each, term in args.items())
    value = "".join(
        "${?x}" if term is None else f"${{A{number}}}"
        for number, term in enumerate(terms)
        if term != ""
    )
    text = f"""<transformation><label>a</label><source>p/A</source><args>{written}</args>
      <params><param name="p" type="string">{value}</param></params>
      <ports><port type="in">in</port></ports><tags><tag port="in">A(?x)</tag></tags>
      </transformation>"""
    (found,) = parse(text).transformations
    expected = "".join("cam1" if term is None else term for term in terms)
    assert fill(found.parameters[0].text, NAMES) == expected
    assert parse(found.to_xml()).transformations == (found,)
