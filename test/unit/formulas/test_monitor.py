# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts from messages: their times, runs and reasons, and the states that they are about."""

from __future__ import annotations

import math
import re
import weakref
from types import SimpleNamespace
from typing import Any, Iterable, List, Optional, Tuple

import pytest

from dyknow.errors import BadParameter, FormulaError
from dyknow.formulas import Truth, Verdict, parse
from dyknow.formulas.log import Log


def message(stamp: float | None = None, **fields: Any) -> Any:
    if stamp is not None:
        fields["header"] = SimpleNamespace(stamp=stamp)
    return SimpleNamespace(**fields)


class Referable(SimpleNamespace):
    """A message with weak references."""

    __hash__ = object.__hash__  # type: ignore[assignment]


def runs(verdicts: List[Verdict]) -> List[str]:
    """The first verdict of each run."""
    return [str(each) for each in verdicts if each.stamp == each.since]


@pytest.mark.parametrize(
    ("formula", "why"),
    [
        ("a.x > 1 and b.x > 1", "b.x = 0 at 1"),
        ("a.x < 1 or b.x > 1", "a.x = 2 at 0, b.x = 0 at 1"),
        ("a.x > 1 implies b.x > 1", "a.x = 2 at 0, b.x = 0 at 1"),
        ("not (a.x > 1 or b.x > 1)", "a.x = 2 at 0"),
        ("historically[0, 1] b.x > 1", "b.x = 0 at 1"),
        ("once[0 s, 1 s] b.x > 5", "b.x = 2 at 0"),
        ("a.x > 1 since b.x > 5", "b.x = 2 at 0"),
        ("abs(a.x - b.x) < 1", "a.x = 2 at 0, b.x = 0 at 1"),
        ("age(a) < 1 and b.x > 1", "age(a) = 1"),
        ("present(a) and rate(b, 1 s) > 9", "rate(b, 1) = 1"),
        ("a.name == 'left'", "a.name = 'right' at 0"),
        ("not a.ok", "a.ok = true at 0"),
    ],
)
def test_why_a_formula_is_false(formula: str, why: str) -> None:
    monitor = parse(formula).monitor(0.5, delay=0.0)
    first = message(x=2, name="right", ok=True)
    events = [("a", first, 0.0), ("b", message(x=2), 0.0), ("b", message(x=0), 1.0)]
    verdicts = [
        verdict
        for port, each, received in events
        if port in parse(formula).ports
        for verdict in monitor.feed(port, each, received)
    ]
    verdicts += monitor.advance(1.1)
    assert verdicts[-1].value is Truth.FALSE
    assert verdicts[-1].stamp == 10**9
    assert verdicts[-1].why == why


@pytest.mark.parametrize(
    ("formula", "given", "why"),
    [
        ("a.x > 1", {}, "a: no message yet"),
        ("a.x > 1", {"a": message(x=math.nan)}, "a.x = nan at 1"),
        ("a.x[3] > 1", {"a": message(x=[1])}, "a.x[3]: no such value at 1"),
        ("1 / a.x > 1", {"a": message(x=0)}, "a.x = 0 at 1"),
        ("sqrt(a.x) > 1", {"a": message(x=-1.0)}, "a.x = -1 at 1"),
        ("norm(a) < 1", {"a": message(z=7.0)}, "a = <SimpleNamespace> at 1"),
        ("min(a.x, 2) > 1", {"a": message(x=math.nan)}, "a.x = nan at 1"),
        ("a.x > 1", {"a": message(x="text")}, "a.x = 'text' at 1"),
        ("rate(a, 5 s) > 1", {"a": message()}, "rate(a, 5) = unknown"),
    ],
)
def test_why_a_formula_is_unknown(formula: str, given: dict[str, Any], why: str) -> None:
    monitor = parse(f"{formula} and z.ok").monitor(1.0, delay=0.0)
    verdicts = monitor.feed("z", message(ok=True), 1.0)
    for port, each in given.items():
        verdicts += monitor.feed(port, each, 1.0)
    (verdict,) = verdicts + monitor.finish()
    assert (verdict.value, verdict.why) == (Truth.UNKNOWN, why)


def explained(formula: str, values: Iterable[Tuple[Any, Any]], **settings: Any) -> List[str]:
    """The first verdicts of runs about messages with x and y, one a second."""
    monitor = parse(formula).monitor(1.0, delay=0.0, **settings)
    verdicts = []
    for now, (x, y) in enumerate(values):
        verdicts += monitor.feed("a", message(x=x, y=y), float(now))
    return runs(verdicts + monitor.finish())


@pytest.mark.parametrize(
    ("formula", "values", "run"),
    [
        (
            "a.y > 0 and once a.x > 0",
            [(1, -1), (-1, -1), (-1, -1), (-1, -1), (-1, 5)],
            "4.000 TRUE  a.y = 5 at 4",
        ),
        (
            "not once a.x > 0 or a.y > 0",
            [(1, -1), (-1, -1), (-1, -1), (-1, -1), (-1, 5)],
            "4.000 TRUE  a.y = 5 at 4",
        ),
        (
            "a.y > 0 or historically a.x > 0",
            [(-1, 5), (1, 5), (1, 5), (1, 5), (1, -1)],
            "4.000 FALSE  a.y = -1 at 4",
        ),
        (
            "a.x > 0 since a.y > 0",
            [(1, 1), (1, -1), (1, -1), (-9, -1)],
            "3.000 FALSE  a.x = -9 at 3",
        ),
        (
            "a.x > 0 since[1, 3] a.y > 0",
            [(1, 1), (1, 1), (1, -1), (-9, -1)],
            "3.000 FALSE  a.x = -9 at 3",
        ),
        (
            "a.x > 0 since[0, 2] a.y > 0",
            [(1, 1), (1, -1), (1, -1), (1, -1)],
            "3.000 FALSE  a.y = -1 at 1",
        ),
        (
            "a.x > 0 until[0, 3] a.y > 0",
            [(1, 1), (1, -1), (1, -1), (-9, -1), (1, 1)],
            "1.000 FALSE  a.x = -9 at 3",
        ),
        ("once[1, 2] a.x > 0", [(1, 1), (1, 1)], "0.000 FALSE  no earlier state"),
        ("a.x > 0 since[1, 2] a.y > 0", [(1, 1), (1, 1)], "0.000 FALSE  no earlier state"),
        ("always[2, 2] not once[0, 1] a.y > 0", [(1, -1), (1, 1)], "0.000 FALSE  a.y = 1 at 1"),
        (
            "always[3, 3] (a.x > 0 since[2, 3] a.y > 0)",
            [(1, 1), (1, 1), (-9, 1)],
            "0.000 FALSE  a.x = -9 at 2",
        ),
        (
            "a.x > 0 or historically a.y > 0",
            [(1, None), (1, 1), (-9, 2)],
            "2.000 UNKNOWN  a.x = -9 at 2, a.y = 1 at 1",
        ),
    ],
)
def test_no_atom_is_named_that_did_not_decide(
    formula: str, values: List[Tuple[int, Optional[int]]], run: str
) -> None:
    assert run in explained(formula, values)


def test_exact_decides_more_and_names_the_unknown_atoms() -> None:
    formula = "a.x > 0 or not a.x > 0"
    assert explained(formula, [(None, 0)]) == ["0.000 UNKNOWN  a.x = unknown at 0"]
    assert explained(formula, [(None, 0)], exact=True) == ["0.000 TRUE  a.x = unknown at 0"]
    before = explained(f"once[1, 1] ({formula})", [(None, 0), (5, 0)], exact=True)
    assert before == ["0.000 FALSE  no earlier state", "1.000 TRUE  a.x = unknown at 0"]


@pytest.mark.parametrize(
    ("formula", "run", "most"),
    [
        ("a.x > 0 since a.y > 0", "700.000 FALSE  a.x = -1 at 700", 100),
        ("a.x > 0 or (a.x < 9 since a.x > 9)", "700.000 FALSE  a.x = -1 at 700", 100),
        ("a.x > 0 and once a.y > 0", "700.000 FALSE  a.x = -1 at 700", 100),
        (
            "(historically[0 s, 300 s] once[0 s, 300 s] a.x > -9) and a.x > 0",
            "700.000 FALSE  a.x = 1 at 0, a.x = -1 at 700",
            10_000,
        ),
    ],
)
def test_an_explanation_takes_few_steps_however_long_it_runs(
    formula: str, run: str, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = []
    atom = Log.atom

    def counted(log: Log, wanted: Any, state: int) -> int:
        looked.append(state)
        return atom(log, wanted, state)

    monkeypatch.setattr(Log, "atom", counted)
    values = [(1, 1 if number == 0 else -1) for number in range(700)]
    assert explained(formula, [*values, (-1, -1)])[-1] == run
    assert len(looked) < most


def test_an_explanation_that_takes_too_long_names_all_values() -> None:
    deep = "once[0 s, 9 s] " * 40
    values = [(number + 1, 1) for number in range(30)]
    found = explained(f"a.y < 0 or not {deep} a.x > 0", values)
    assert found == ["0.000 FALSE  a.y = 1 at 0, a.x = 1 at 0"]
    found = explained(f"{deep} a.x < 0 or a.y < 0", [*values, (31, -1)])
    assert found[-1] == "30.000 TRUE  a.x = 1 at 0, a.y = -1 at 30"


def test_individuals_that_take_too_long_to_explain_name_all_values() -> None:
    deep = "once[0 s, 9 s] " * 40
    monitor = parse(f"every ?c (not {deep} a.x > 5)").monitor(1.0, delay=0.0)
    verdicts = monitor.individuals("?c", ["left", "right"], 0.0)
    for now in range(20):
        verdicts += monitor.feed("a", message(x=now), float(now), "left")
        verdicts += monitor.feed("a", message(x=0), float(now), "right")
    assert runs(verdicts)[-1] == "6.000 FALSE  left: a.x = 6 at 6, right: a.x = 0 at 0"


def test_a_message_has_a_value_for_as_long_as_it_is_held() -> None:
    monitor = parse("a.x > 1").monitor(0.5, hold=1.0)
    verdicts = monitor.feed("a", message(0.5, x=2), 0.5) + monitor.advance(3.0)
    assert runs(verdicts) == [
        "0.500 TRUE  a.x = 2 at 0.5",
        "2.000 UNKNOWN  a: no message since 0.5",
    ]


def test_a_state_is_due_after_the_delay() -> None:
    monitor = parse("a.x > 0 and b.x > 0").monitor(1.0, delay=0.5)
    assert monitor.due is None
    for port in "ab":
        assert monitor.feed(port, message(0.9, x=1), 0.95) == []
    assert len([v for port in "ab" for v in monitor.feed(port, message(1.2, x=1), 1.25)]) == 1
    assert monitor.due == 2.5
    assert monitor.advance(2.5) == []
    assert [verdict.stamp for verdict in monitor.advance(2.6)] == [2 * 10**9]


def test_a_stamp_ahead_of_the_clock_waits_for_it() -> None:
    monitor = parse("a.x > 0").monitor(1.0)
    assert monitor.feed("a", message(1.0, x=1), 0.5) == []
    assert monitor.feed("a", message(2.5, x=1), 0.6) == []
    assert [each.stamp for each in monitor.advance(1.2)] == [10**9]


@pytest.mark.parametrize("stamp", [50.0, 3e6, 1.7e9])
@pytest.mark.parametrize("number", [0, 5])
def test_one_stamp_far_ahead_of_the_clock_changes_no_verdict(stamp: float, number: int) -> None:
    """It is neither the first state, nor the last one, nor passed by its port."""
    found = []
    for wrong in (False, True):
        monitor = parse("a.x > 0").monitor(0.1, delay=1.0)
        verdicts = []
        for each in range(40):
            now = 1.0 + each / 10
            is_wrong = wrong and each == number
            verdicts += monitor.feed("a", message(stamp if is_wrong else now - 0.45, x=1), now)
            assert len(verdicts) <= 40
        verdicts += monitor.finish()
        found.append([each.stamp for each in verdicts if each.value is Truth.TRUE])
        assert monitor.late <= 15 * wrong
    right, disturbed = found
    assert right[-1] == 4_400_000_000
    assert [each for each in right if each > 2_000_000_000] == disturbed[-24:]


@pytest.mark.parametrize(("ahead", "most"), [(5.0, 60), (3600.0, 1), (1e9, 1)])
def test_messages_ahead_of_the_clock_take_no_more_memory_than_ten_seconds_of_them(
    ahead: float, most: int
) -> None:
    monitor = parse("a.x > 0 or b.x > 0").monitor(0.1)
    alive: weakref.WeakSet[Any] = weakref.WeakSet()
    for number in range(500):
        now = number / 10
        each = Referable(header=SimpleNamespace(stamp=now + ahead), x=1)
        alive.add(each)
        verdicts = monitor.feed("a", each, now) + monitor.feed("b", message(now, x=1), now)
        assert {verdict.value for verdict in verdicts} <= {Truth.TRUE}
    del each
    assert 0 < len(alive) <= most


def test_the_last_message_that_is_far_ahead_has_a_value_when_its_time_has_come() -> None:
    monitor = parse("a.x > 0").monitor(1.0)
    for stamp, x in ((5.0, 1), (100.0, -1), (200.0, -1), (50.0, 1)):
        monitor.feed("a", message(stamp, x=x), 1.0)
    verdicts = monitor.advance(300.0)
    assert runs(verdicts) == ["5.000 TRUE  a.x = 1 at 5"]


def test_the_end_closes_no_state_that_has_not_come() -> None:
    monitor = parse("a.x > 0").monitor(0.1)
    verdicts = monitor.feed("a", message(1.0, x=1), 1.0) + monitor.feed(
        "a", message(3e6, x=1), 1.1
    )
    verdicts += monitor.finish()
    assert [each.stamp for each in verdicts] == [1_000_000_000, 1_100_000_000]


def test_stamps_alone_do_not_turn_time_back() -> None:
    """Two ports of different latency, without times of receipt."""
    monitor = parse("once a.x > 0 and b.x > 0").monitor(0.1, delay=1.0)
    verdicts = monitor.feed("a", message(0.9, x=1)) + monitor.feed("a", message(1.0, x=-1))
    for number in range(11, 30):
        verdicts += monitor.feed("a", message(number / 10, x=-1))
        verdicts += monitor.feed("b", message(number / 10 - 0.5, x=1))
    verdicts += monitor.finish()
    assert [each.stamp for each in verdicts] == [each * 10**8 for each in range(9, 30)]
    assert {each.value for each in verdicts} == {Truth.TRUE}
    # Another trace may begin after the end.
    verdicts = monitor.feed("a", message(0.2, x=1)) + monitor.feed("b", message(0.2, x=1))
    assert [each.stamp for each in verdicts + monitor.finish()] == [2 * 10**8]


def test_time_that_jumps_back_begins_a_new_sequence() -> None:
    monitor = parse("once a.x > 0").monitor(1.0)
    verdicts = monitor.feed("a", message(x=1), 10.0) + monitor.feed("a", message(x=-1), 11.5)
    assert runs(verdicts) == ["10.000 TRUE  a.x = 1 at 10"]
    assert [each.stamp for each in verdicts] == [10 * 10**9, 11 * 10**9]
    assert monitor.feed("a", message(x=-1), 2.0) == []
    assert runs(monitor.advance(3.5)) == ["2.000 FALSE  a.x = -1 at 2"]
    # A small step back, as when a clock is adjusted, is none.
    assert monitor.advance(3.2) == []


def test_time_that_jumps_far_ahead_begins_a_new_sequence() -> None:
    monitor = parse("once a.x > 0").monitor(0.1)
    monitor.feed("a", message(x=1), 1.0)
    monitor.advance(1.7e9)
    verdicts = monitor.feed("a", message(x=-1), 1.7e9) + monitor.finish()
    assert runs(verdicts) == ["1700000000.000 FALSE  a.x = -1 at 1700000000"]


def test_always_is_silent_until_it_is_false_for_good() -> None:
    monitor = parse("always a.x > 0").monitor(1.0)
    found = [monitor.feed("a", message(x=x), number) for number, x in enumerate([1, 1, -1, 1, 1])]
    verdicts = [verdict for each in found for verdict in each] + monitor.finish()
    assert [str(each) for each in verdicts] == [
        f"{number}.000 FALSE  a.x = -1 at 2" for number in (2, 3, 4)
    ]
    monitor = parse("eventually a.x < 0").monitor(1.0)
    verdicts = [v for n, x in enumerate([1, -1, 1]) for v in monitor.feed("a", message(x=x), n)]
    assert [each.value for each in verdicts + monitor.finish()] == [Truth.TRUE] * 2


def test_verdicts_about_the_future_that_the_end_decides() -> None:
    monitor = parse("a.x > 0 implies eventually[0 s, 2 s] a.x < 0").monitor(1.0)
    for number in range(4):
        monitor.feed("a", message(x=1), number)
    assert [str(each) for each in monitor.finish()] == [
        "1.000 FALSE  a.x = 1 at 0",
        "2.000 UNKNOWN  no later state",
        "3.000 UNKNOWN  no later state",
    ]


def test_verdicts_of_another_formula_and_flags_are_truths() -> None:
    def verdict(value: int) -> Any:
        return SimpleNamespace(value=value, TRUE=1, FALSE=0, UNKNOWN=2)

    monitor = parse("flag and charged").monitor(1.0, delay=0.0)
    verdicts = []
    for now, value in enumerate((1, 0, 2)):
        verdicts += monitor.feed("flag", message(data=True), now)
        verdicts += monitor.feed("charged", verdict(value), now)
    verdicts += monitor.finish()
    assert [each.value for each in verdicts] == [Truth.TRUE, Truth.FALSE, Truth.UNKNOWN]
    assert verdicts[0].why == "flag = true at 0, charged = TRUE at 0"


def test_times_and_constants_of_messages() -> None:
    class Status:
        STATE_READY = 3
        READY = 7

        def __init__(self, state: int) -> None:
            self.state = state
            self.channels = [0, state]
            self.since = SimpleNamespace(to_sec=lambda: 2.5)

    ready = "(s.state == STATE_READY or s.channels[1] == READY or s.channels[0] == READY)"
    monitor = parse(f"s.since < 3 s and {ready}").monitor(1.0)
    verdicts = [v for n in range(3) for v in monitor.feed("s", Status(n + 2), float(n))]
    verdicts += monitor.finish()
    assert [each.value for each in verdicts] == [Truth.FALSE, Truth.TRUE, Truth.FALSE]


@pytest.mark.parametrize(
    ("formula", "holds"),
    [
        ("t.zero == 0", True),
        ("0 == t.zero", True),
        ("t.zero != 0", False),
        ("t.long == 2 s", True),
        ("t.long != 2 s", False),
        ("t.long == 2", True),
        ("t.long == 3", False),
        ("t.long != 3 s", True),
        ("t.half == 500 ms", True),
        ("t.long - t.long == 0", True),
        ("t.long - t.half == 1.5 s", True),
        ("t.later - t.now == 100 ms", True),
        ("t.later - t.now != 100 ms", False),
        ("t.later - t.now <= 100 ms", True),
        ("t.later - t.now < 100 ms", False),
        ("t.now == 1700000000.1", True),
        ("t.now == t.later", False),
        ("t.now == t.now", True),
        ("t.now != t.long", True),
        ("t.long + 1 == 3", True),
        ("t.half * 4 == t.long", True),
        ("abs(t.half - t.long) == 1.5", True),
        ("min(t.long, 2) == 2", True),
        ("max(t.long, t.half) != 2", False),
        ("t.number == t.zero", False),
        ("t.number == 5", True),
        ("t.number != 4", True),
        ("t.nan == 0", None),
        ("t.nan != 0", None),
        ("t.nan == t.nan", None),
        ("t.name == 'left'", True),
        ("t.name != 'right'", True),
        ("t.name == 5", False),
        ("t.name != 5", True),
        ("t.ok == true", True),
        ("t.ok != false", True),
        ("t.missing == 0", None),
    ],
)
def test_times_are_equal_to_their_seconds(formula: str, holds: Optional[bool]) -> None:
    genpy = pytest.importorskip("genpy")
    given = message(
        zero=genpy.Duration(0),
        half=genpy.Duration(0, 500_000_000),
        long=genpy.Duration(2),
        now=genpy.Time(1_700_000_000, 100_000_000),
        later=genpy.Time(1_700_000_000, 200_000_000),
        number=5,
        nan=math.nan,
        name="left",
        ok=True,
    )
    for exact in (False, True):
        monitor = parse(formula).monitor(1.0, exact=exact)
        (verdict,) = monitor.feed("t", given, 1.0) + monitor.finish()
        expected = {True: Truth.TRUE, False: Truth.FALSE, None: Truth.UNKNOWN}[holds]
        assert verdict.value is expected, verdict


def test_individuals() -> None:
    monitor = parse("every ?c: Camera (rate(image, 1 s) > 5)").monitor(0.1)
    verdicts = monitor.individuals("?c", ["left", "right"], 0.0)
    for number in range(60):
        for name in ("left", "right"):
            if name == "left" or number < 30 or number > 40:
                verdicts += monitor.feed("image", None, number / 10, name)
    verdicts += monitor.individuals("?c", ["left"], 6.0)
    verdicts += monitor.feed("image", None, 6.05, "right")  # it is not there any more
    verdicts += monitor.individuals("?c", [], 7.0) + monitor.advance(8.0)
    assert runs(verdicts) == [
        "0.000 UNKNOWN  left: rate(image, 1) = unknown, right: rate(image, 1) = unknown",
        "0.900 TRUE  left: rate(image, 1) = 10, right: rate(image, 1) = 10",
        "3.400 FALSE  right: rate(image, 1) = 5",
        "4.600 TRUE  left: rate(image, 1) = 10, right: rate(image, 1) = 6",
        "6.400 FALSE  left: rate(image, 1) = 5",
        "7.000 TRUE",
    ]


@pytest.mark.parametrize(
    "formula",
    [
        "every ?c: Camera (image) and some ?c: Camera (image == true)",
        "some ?c (image == true) and every ?c (image)",
        "every ?c (image) and some ?d (image)",
        "every ?c (image) and every ?c (once image) and some ?c (present(image) and base)",
    ],
)
def test_all_quantifiers_over_a_port_hear_its_messages(formula: str) -> None:
    monitor = parse(formula).monitor(1.0, delay=0.0)
    verdicts = []
    for variable in parse(formula).variables:
        verdicts += monitor.individuals(variable, ["left"], 1.0)
    for now in (1.0, 2.0, 3.0):
        for port in parse(formula).ports:
            verdicts += monitor.feed(port, True, now, "left")
    verdicts += monitor.advance(3.5)
    assert [each.value for each in verdicts] == [Truth.TRUE] * 3
    assert monitor.late == 0


def test_an_individual_begins_with_its_last_message_before() -> None:
    """States of before its arrival were open when the message came."""
    monitor = parse("every ?c (image.x > 0) and base.x > 0").monitor(0.1, delay=0.5)
    verdicts = monitor.individuals("?c", [], 0.0) + monitor.individuals("?c", ["left"], 1.0)
    for number in range(10, 21):
        for port in ("image", "base"):
            stamp = number / 10 - 0.28
            verdicts += monitor.feed(port, message(stamp, x=1), number / 10, "left")
    verdicts += monitor.finish()
    left = [each for each in verdicts if each.stamp >= 10**9]
    assert len(left) == 8 and {each.value for each in left} == {Truth.TRUE}


@pytest.mark.parametrize("delay", [0.0, 0.7, 5.0])
@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("every ?c (image)", "FALSE FALSE TRUE TRUE UNKNOWN TRUE"),
        ("some ?c (once image)", "FALSE FALSE FALSE FALSE UNKNOWN TRUE"),
        ("every ?c (eventually[0 s, 3 s] image)", "UNKNOWN UNKNOWN TRUE TRUE TRUE TRUE"),
    ],
)
def test_an_individual_that_comes_back_has_left(delay: float, formula: str, expected: str) -> None:
    """Also if the states without it are still open."""
    monitor = parse(formula).monitor(1.0, delay=delay)
    verdicts = monitor.individuals("?c", ["left"], 0.0) + monitor.feed("image", False, 0.0, "left")
    verdicts += monitor.individuals("?c", [], 1.5) + monitor.individuals("?c", [], 2.5)
    verdicts += monitor.individuals("?c", ["left"], 3.5)
    verdicts += monitor.feed("image", True, 4.5, "left")
    verdicts += monitor.advance(5.0 + delay + 0.1) + monitor.finish()
    assert " ".join(each.value.name for each in verdicts).startswith(expected)


@pytest.mark.parametrize("delay", [0.0, 5.0])
def test_an_individual_that_misses_no_state_has_not_left(delay: float) -> None:
    monitor = parse("every ?c (once image)").monitor(1.0, delay=delay)
    verdicts = monitor.individuals("?c", ["left"], 0.0) + monitor.feed("image", True, 0.0, "left")
    verdicts += monitor.individuals("?c", [], 1.5) + monitor.individuals("?c", ["left"], 1.7)
    verdicts += monitor.feed("image", False, 1.7, "left") + monitor.advance(10.0)
    assert {each.value for each in verdicts} == {Truth.TRUE}
    assert monitor.late == 0


@pytest.mark.parametrize("delay", [0.0, 0.7, 5.0])
def test_one_that_leaves_is_named_in_the_states_that_it_is_in(delay: float) -> None:
    monitor = parse("every ?c (image)").monitor(1.0, delay=delay)
    verdicts = monitor.individuals("?c", ["left", "right"], 0.0)
    for name in ("left", "right"):
        verdicts += monitor.feed("image", name == "right", 0.0, name)
    verdicts += monitor.individuals("?c", ["right"], 1.5) + monitor.advance(10.0)
    assert runs(verdicts) == [
        "0.000 FALSE  left: image = false at 0",
        "2.000 TRUE  right: image = true at 0",
    ]


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        (
            "historically[2 s, 5 s] every ?c (image)",
            [
                "0.000 TRUE  no earlier state",
                "2.000 FALSE  left: image = false at 0",
                "6.000 TRUE  right: image = true at 0",
            ],
        ),
        (
            "once[2 s, 3 s] some ?c (not image)",
            [
                "0.000 FALSE  no earlier state",
                "2.000 TRUE  left: image = false at 0",
                "4.000 FALSE  right: image = true at 0",
            ],
        ),
        (
            "some ?c (not image) and eventually[3 s, 3 s] every ?c (image)",
            [
                "0.000 TRUE  left: image = false at 0, right: image = true at 0",
                "1.000 FALSE  right: image = true at 0",
            ],
        ),
        (
            "every ?c (eventually[9 s, 9 s] not image)",
            ["0.000 FALSE  right: image = true at 0", "1.000 UNKNOWN  right: no later state"],
        ),
    ],
)
@pytest.mark.parametrize("delay", [0.0, 1.0])
@pytest.mark.parametrize("is_gone", [False, True])
def test_an_individual_that_decided_is_named_though_it_has_changed_or_gone(
    is_gone: bool, delay: float, formula: str, expected: List[str]
) -> None:
    monitor = parse(formula).monitor(1.0, delay=delay)
    verdicts = monitor.individuals("?c", ["left", "right"], 0.0)
    for now in range(10):
        if now == 1 and is_gone:
            verdicts += monitor.individuals("?c", ["right"], 0.5)
        for name in ("left", "right"):
            if name == "right" or not (now and is_gone):
                verdicts += monitor.feed("image", now > 0 or name == "right", now, name)
    found = runs(verdicts + monitor.finish())
    # What the other one adds if it is still there.
    assert [re.sub("left: (image = true at 1|no later state), ", "", e) for e in found] == expected


def test_the_messages_of_an_individual_that_has_gone_are_dropped() -> None:
    monitor = parse("historically[0 s, 60 s] every ?c (image.x > 0)").monitor(1.0)
    image = Referable(x=1)
    dropped = weakref.ref(image)
    monitor.individuals("?c", ["left"], 1.0)
    monitor.feed("image", image, 1.0, "left")
    del image
    monitor.individuals("?c", [], 2.0)
    monitor.advance(4.0)
    assert dropped() is None


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize(
    "formula",
    [
        "historically[0, 60] (a and b)",
        "(once[0, 60] not a) or not b or rate(a, 1 s) > 2",
        "present(a) and b and every ?c (historically[0, 60] (a and image))",
        "b and present(a) and every ?c (historically b or image)",
    ],
)
def test_a_monitor_that_forgets_a_port_goes_on_as_a_new_one(formula: str, exact: bool) -> None:
    old, new = (parse(formula).monitor(0.5, delay=1.0, exact=exact) for _ in range(2))
    ports = [port for port in ("b", "image") if port in parse(formula).ports]

    def feed(monitor: Any, port: str, value: bool, now: float) -> List[Verdict]:
        return monitor.feed(port, value, now, "left" if port == "image" else "")

    before = old.individuals("?c", ["left"], 1.0)
    for now in (1.0, 2.0, 3.0):
        for port in ("a", "image", "b"):
            if port in parse(formula).ports:
                before += feed(old, port, now == 3.0, now)
    old.forget(["a"])
    # The other ports have the values that they had.
    found = old.individuals("?c", ["left"], 9.0) + feed(old, "b", True, 9.0)
    expected = new.individuals("?c", ["left"], 9.0)
    for port in reversed(ports):
        expected += feed(new, port, True, 9.0)
    for now in (10.0, 10.6, 11.1, 14.0):
        value = now != 11.1
        found += feed(old, "a", value, now)
        expected += feed(new, "a", value, now)
    found, expected = found + old.advance(16.0), expected + new.advance(16.0)
    assert [(each.stamp, each.value) for each in found] == [
        (each.stamp, each.value) for each in expected
    ]
    assert len({each.value for each in found}) > 1


@pytest.mark.parametrize("formula", ["rate(a, 5 s) > 1 or b", "every ?c (rate(a, 5 s) > 1) or b"])
def test_rates_are_not_counted_over_the_states_that_forgetting_leaves_out(formula: str) -> None:
    monitor = parse(formula).monitor(0.5, delay=0.5)
    individual = "left" if "every" in formula else ""
    monitor.individuals("?c", [individual], 1.0)
    monitor.feed("b", False, 1.0)
    for number in range(60):
        monitor.feed("a", 1, 1.0 + 0.1 * number, individual)
    monitor.forget(["b"])
    found = monitor.feed("b", False, 37.0) + monitor.feed("a", 1, 37.0, individual)
    found += monitor.advance(43.1)
    assert [each.value for each in found] == 9 * [Truth.UNKNOWN] + 3 * [Truth.FALSE]


@pytest.mark.parametrize(
    "formula", ["present(a) and rate(b) < 15", "every ?c (rate(b) < 15) and a"]
)
def test_rate_counts_no_message_from_before_its_window(formula: str) -> None:
    monitor = parse(formula).monitor(delay=5.0)
    individual = "left" if "every" in formula else ""
    verdicts = monitor.individuals("?c", [individual], 100.0)
    for number in range(80):
        now = 100.0 + number / 10
        verdicts += monitor.feed("a", True, now)
        verdicts += monitor.feed("b", message(now - 2.95), now + 0.05, individual)
    assert [each.split(" ")[1] for each in runs(verdicts)] == ["UNKNOWN", "TRUE"]
    assert runs(verdicts)[1].endswith("rate(b) = 10") or "rate(b) = 10," in runs(verdicts)[1]


def test_a_monitor_that_forgets_publishes_no_verdict_about_an_earlier_state() -> None:
    monitor = parse("a.x > 0").monitor(0.1, delay=1.0)
    verdicts = monitor.feed("a", message(1.0, x=1), 1.0) + monitor.feed("a", message(1.95, x=1), 2)
    monitor.forget(["a"])
    verdicts += monitor.feed("a", message(1.5, x=0), 2.0) + monitor.advance(4.0)
    stamps = [each.stamp for each in verdicts]
    assert stamps == sorted(set(stamps))
    assert verdicts[-1].value is Truth.FALSE and monitor.late == 0


@pytest.mark.parametrize(
    ("formula", "hold", "why"),
    [
        ("a.x > 0", None, "TRUE  a.x = 1 at 40"),
        ("a.x > 0", 2.0, "UNKNOWN  a: no message since 40"),
        ("some ?c (a.x > 0)", None, "TRUE  left: a.x = 1 at 40"),
    ],
)
def test_a_first_state_sees_what_was_latched_before(
    formula: str, hold: Optional[float], why: str
) -> None:
    monitor = parse(formula).monitor(hold=hold)
    verdicts = []
    if parse(formula).variables:
        verdicts = monitor.individuals("?c", [], 99.0) + monitor.individuals("?c", ["left"], 100.0)
    verdicts += monitor.feed("a", message(40.0, x=1), 100.03, "left") + monitor.advance(101.0)
    verdicts += monitor.feed("a", message(41.0, x=0), 101.0, "left") + monitor.advance(102.0)
    assert runs(verdicts)[-1].endswith(f" {why}") and monitor.late == 1


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: parse("p").monitor(period=0.0), BadParameter, "period"),
        (lambda: parse("p").monitor(period=1e300), BadParameter, "period.* below 2147483648"),
        (lambda: parse("p").monitor(hold=-1.0), BadParameter, "hold"),
        (lambda: parse("p").monitor(delay=math.inf), BadParameter, "delay"),
        (lambda: parse("p").monitor().feed("q", True, 0.0), BadParameter, "port"),
        (lambda: parse("p").monitor().feed("p", True), BadParameter, "received"),
        (
            lambda: parse("once[50 ms, 60 ms] p").monitor(),
            FormulaError,
            r"no state lies within \[50 ms, 60 ms\]: states are 0.100 s apart",
        ),
        (lambda: parse("once[0, 30 h] p").monitor(), FormulaError, "1080000 states of 0.100 s"),
        (lambda: parse("rate(p, 30 h) > 1").monitor(), FormulaError, "1080000 states of 0.100 s"),
        (
            lambda: parse("q and every ?c (eventually[0, 1] p)").monitor(exact=True),
            FormulaError,
            "column 7: exact cannot reason about a quantifier that looks ahead",
        ),
    ],
)
def test_what_a_monitor_refuses(make: Any, error: Any, text: str) -> None:
    with pytest.raises(error, match=text):
        make()
