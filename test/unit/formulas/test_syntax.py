# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas that are read, and those that are refused with line, column and expected text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples

from dyknow.errors import FormulaError
from dyknow.formulas import parse
from dyknow.formulas.syntax import MAX_DEPTH, MAX_HEIGHT, MAX_LENGTH


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("battery.percentage > 0.2", "battery.percentage > 0.2"),
        (
            "historically[0 s, 5 s] battery.percentage > 0.2",
            "historically[0 s, 5 s] (battery.percentage > 0.2)",
        ),
        ("once[200 ms, 2 min] p", "once[200 ms, 2 min] p"),
        ("once[.5, 1e1] p", "once[500 ms, 10 s] p"),
        ("once[2 s, inf] p", "once[2 s, inf] p"),
        ("once p since q", "(once p) since q"),
        ("p and q or not r implies s", "((p and q) or not r) implies s"),
        ("p -> q -> r", "p implies (q implies r)"),
        ("p until[0,1] q until[1,2] r", "p until[0 s, 1 s] (q until[1 s, 2 s] r)"),
        ("not p and q", "not p and q"),
        ("a.x + b.x * 2 < -c.y", "(a.x + (b.x * 2)) < -(c.y)"),
        ("(a.x + 1) * 2 >= 3 and (p)", "(((a.x + 1) * 2) >= 3) and p"),
        ("0 < a.x <= 1", "(0 < a.x) and (a.x <= 1)"),
        ("a.list[3].name == 'it\\'s'", "a.list[3].name == 'it\\'s'"),
        ("status.state == CHARGING", "status.state == CHARGING"),
        ("age(a) < 500 ms and rate(a, 2 s) > 5", "(age(a) < 0.5) and (rate(a, 2) > 5)"),
        ("present(a) and a.ok", "present(a) and a.ok"),
        ("rate(IMU) > 5 and IMU.x > 1", "(rate(IMU) > 5) and (IMU.x > 1)"),
        ("max(a.x, norm(a.p), len(a.l)) != 2", "max(a.x, norm(a.p), len(a.l)) != 2"),
        ("every ?c: Camera (p)", "every ?c: Camera (p)"),
        ("some ?c (once[0,1] p) and q", "some ?c (once[0 s, 1 s] p) and q"),
        ("always\n  p\n", "always p"),
        ("a.x > 0.30000000000000004", "a.x > 0.30000000000000004"),
        ("a.x > 18446744073709551615", "a.x > 18446744073709551615"),
        ("a.x > 1e22 or a.x > 1e400", "(a.x > 1e+22) or (a.x > 1e999)"),
    ],
)
def test_what_is_read(text: str, written: str) -> None:
    assert str(parse(text)) == written
    assert parse(written).tree == parse(text).tree


@pytest.mark.parametrize(
    ("text", "column", "problem"),
    [
        ("", 1, "expected a formula, found the end"),
        ("a.x >", 6, "expected a formula, found the end"),
        ("historicaly[0 s, 5 s] p", 1, "did you mean historically?"),
        ("historicaly p", 1, "did you mean historically?"),
        ("p && q", 3, "write 'and'"),
        ("p = q", 3, "write '=='"),
        ("p q", 3, "expected an operator such as 'and', or the end, found 'q'"),
        ("always p and q", 1, "'always' without bounds may only stand outermost: write bounds"),
        ("not always p", 5, "'always' without bounds may only stand outermost: write bounds"),
        ("p until q", 9, "expected the bounds of 'until', as until[0 s, 5 s], found 'q'"),
        ("always[0, inf] p", 11, "'always' needs an upper bound"),
        ("once[5, 2] p", 9, "the upper bound is below the lower one"),
        ("once[2] p", 7, "expected ',' between the bounds"),
        ("once[x, 2] p", 6, "expected a duration such as 5 s or 200 ms, found 'x'"),
        ("once[0, 9000 h] p", 9, "a bound is at most a year"),
        ("once[0, 2 p", 11, "expected ']' after the bounds"),
        ("mean(a.x) > 2", 1, "'mean' is not a function"),
        ("abs(a.x, a.y) > 2", 1, "abs takes 1 arguments, not 2"),
        ("rate(a.x) > 2", 1, "rate takes a port, not 'a.x'"),
        ("rate(a, b) > 2", 1, "the second argument of rate is a duration, as 5 s"),
        ("3 and p", 1, "'3' is not true or false: compare it"),
        ("a.x + 1", 1, "'(a.x + 1)' is not true or false: compare it"),
        ("CHARGING == 3", 1, "constant 'CHARGING' is not compared with a field"),
        ("CHARGING and p", 1, "constant 'CHARGING' is not compared with a field"),
        ("(a.x > 1) > 2", 14, "'a.x > 1' is true or false, and cannot be compared"),
        ("1 < 2", 6, "'1 < 2' reads no port, so it never changes"),
        ("every c (p)", 7, "expected a variable such as ?c, found 'c'"),
        ("every ?c: (p)", 11, "expected a concept such as Camera"),
        ("every ?c p", 10, "expected '(' before the formula of the individuals"),
        ("every ?c (some ?d (p))", 11, "a quantifier cannot stand within another one"),
        ("a[1.5] > 2", 1, "the index of 'a' is one whole number"),
        pytest.param(f"a[{'1' * 5000}] > 2", 1, "the index of 'a' is one whole", id="long index"),
        ("a.3 > 2", 2, "expected an operator such as 'and', or the end, found '.3'"),
        ("a.x > 'open", 7, "a text without its end is not part of a formula"),
        ("a.x > 2 $", 9, "'$' is not part of a formula"),
        ("(p", 3, "expected ')', found the end"),
        ("(" * (MAX_DEPTH + 1) + "p", MAX_DEPTH + 1, f"nested deeper than {MAX_DEPTH}"),
        ("not " * (MAX_DEPTH + 1) + "p", 4 * MAX_DEPTH - 3, f"nested deeper than {MAX_DEPTH}"),
        ("p" * (MAX_LENGTH + 1), 1, f"at most {MAX_LENGTH}"),
        (" and ".join(["p"] * MAX_HEIGHT), 1, f"more than {MAX_HEIGHT} levels"),
        (" or ".join(["p"] * 1500), 1, f"more than {MAX_HEIGHT} levels"),
        (" + ".join(["a.x"] * 1500) + " > 0", 1, f"more than {MAX_HEIGHT} levels"),
        ("-" * 3000 + "a.x > 0", 1, f"more than {MAX_HEIGHT} levels"),
        ("abs(" * 600 + "a.x" + ")" * 600 + " > 0", 1, f"more than {MAX_HEIGHT} levels"),
        ("p until[0,1] " * 400 + "p", 1, f"more than {MAX_HEIGHT} levels"),
        ("route.from == 1", 7, "'from' is a word of Python: the field is 'from_' in Python"),
        ("a.True > 0", 3, "'True' is a word of Python"),
        ("a.ok == True", 9, "'True' is a word of Python: write 'true'"),
        ("False or p", 1, "'False' is a word of Python: write 'false'"),
        ("p AND q", 3, "found 'AND'; did you mean and?"),
        ("a.x² > 0", 3, "expected the name of a field"),
        ("historically[0, 1e999999] p", 17, "a number is out of range"),
        ("a.x > 1e999999 s", 7, "a number is out of range"),
        ("a.x > 1e99999999999999999999", 7, "a number is out of range"),
        ("rate(a, 1e300) > 1", 1, "the second argument of rate is at most a year"),
        ("rate(a, 1e400) > 1", 1, "the second argument of rate is at most a year"),
    ],
)
def test_what_is_refused(text: str, column: int, problem: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse(text)
    assert problem in caught.value.problem, caught.value
    assert (caught.value.line, caught.value.column) == (1, column), caught.value


def test_an_error_points_at_its_place() -> None:
    with pytest.raises(FormulaError) as caught:
        parse("p and\n  q or\n  (r")
    assert str(caught.value) == (
        "formula, line 3, column 5: expected ')', found the end\n    (r\n      ^"
    )


@pytest.mark.parametrize(
    "text",
    [
        " and ".join(f"a.x > {number}" for number in range(MAX_HEIGHT - 1)),
        " + ".join(["a.x"] * (MAX_HEIGHT - 1)) + " > 0",
        "abs(" * (MAX_HEIGHT - 2) + "a.x" + ")" * (MAX_HEIGHT - 2) + " > 0",
    ],
)
def test_the_highest_formula_is_compiled(text: str) -> None:
    assert parse(text).monitor().due is None


@examples(300)
@given(st.text("pq.x[]()<>=!&|-+*/?:, 0123'\"\\\n") | st.text())
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        formula = parse(text)
    except FormulaError as error:
        assert error.line >= 1
        assert error.column >= 1
    else:
        assert parse(str(formula)).tree == formula.tree
