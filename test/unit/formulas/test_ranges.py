# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ranges of quantifiers, and the tags of their ports."""

from __future__ import annotations

import pytest

from dyknow.errors import DyKnowError, FormulaError
from dyknow.formulas import Range, parse
from dyknow.manager.specifications.tags import parse_tag, tag_of_individuals


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("p", {}),
        ("every ?c (image)", {"image": ("?c", "")}),
        ("every ?c: Camera (image and info.x > 1)", {"image": ("?c", "Camera")}),
        ("every ?c: Camera (image) and some ?c: Camera (info)", {"info": ("?c", "Camera")}),
        ("some ?c (info) or some ?c: Camera (image)", {"info": ("?c", "Camera")}),
        ("some ?c: Camera (image) or some ?c (info)", {"info": ("?c", "Camera")}),
        ("every ?c: Camera (image) and some ?d: Lidar (scan)", {"scan": ("?d", "Lidar")}),
        ("every ?c (image and base) and base", {"image": ("?c", "")}),
        ("every ?c (image) and every ?c (base) and base", {"image": ("?c", "")}),
    ],
)
def test_the_range_of_each_port(formula: str, expected: dict[str, tuple[str, str]]) -> None:
    read = parse(formula)
    found = read.ranges()
    assert found.items() >= expected.items()
    assert {*found} == {*read.of_individuals}


@pytest.mark.parametrize(
    ("formula", "column", "problem"),
    [
        (
            "every ?c (image) and some ?d (image)",
            22,
            "the port 'image' has a stream for each ?c: a quantifier of ?d cannot read it",
        ),
        (
            "every ?c: Camera (a) and some ?c: Lidar (b)",
            26,
            "?c is of the concept Camera in another quantifier: expected it, or another variable",
        ),
        ("every ?c (image) and image", 1, "?c has no individuals: each port below the quantifier"),
        ("every ?c (a) and some ?d (a and b) and a", 1, "?c has no individuals"),
    ],
)
def test_ranges_that_are_refused(formula: str, column: int, problem: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse(formula).ranges()
    assert problem in caught.value.problem
    assert caught.value.column == column


@pytest.mark.parametrize(
    ("tag", "concept", "expected"),
    [
        ("Image(?c)", "", "Image(?c)"),
        ("Image(?c)", "Camera", "Image(?c: Camera)"),
        ("Image(?c: Camera)", "", "Image(?c: Camera)"),
        ("Image(?c: Camera)", "Camera", "Image(?c: Camera)"),
        ("Image(nao, ?c, ?x)", "Camera", "Image(nao, ?c: Camera, ?x)"),
        ("Image(?c, ?c: Camera)", "Camera", "Image(?c: Camera, ?c: Camera)"),
    ],
)
def test_tags_have_the_concept_of_the_quantifier(tag: str, concept: str, expected: str) -> None:
    assert str(tag_of_individuals("p", parse_tag(tag), Range("?c", concept))) == expected


@pytest.mark.parametrize(
    ("tag", "problem"),
    [
        (
            "Battery(?x)",
            "the tag Battery(?x) of the port 'p' has the variable ?x; expected the quantifier's, "
            "?c",
        ),
        (
            "Battery(nao)",
            "the tag Battery(nao) of the port 'p' has no variable; expected the quantifier's, ?c",
        ),
        (
            "Battery(?c: Lidar)",
            "the tag Battery(?c: Lidar) of the port 'p' has the variable ?c with the concept "
            "Lidar; expected the quantifier's, Camera",
        ),
    ],
)
def test_tags_that_do_not_fit_a_quantifier(tag: str, problem: str) -> None:
    with pytest.raises(DyKnowError) as caught:
        tag_of_individuals("p", parse_tag(tag), Range("?c", "Camera"))
    assert str(caught.value) == problem
