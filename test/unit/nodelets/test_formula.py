# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet of a formula."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Dict, List, Optional

import pytest
from genpy import Time
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Bool, Header

from dyknow.errors import LoadFailed
from dyknow.formulas import parse
from dyknow.nodelets.formula import FormulaNodelet


@pytest.fixture
def nodelet():
    """The nodelet of a formula, with a clock at `now`, timers and verdicts."""
    nodelet: Any = FormulaNodelet()
    nodelet._context = SimpleNamespace(name="/formula")
    nodelet.individuals, nodelet.waiting, nodelet.late = None, {}, 0
    nodelet.now, nodelet.timers, nodelet.verdicts, nodelet.warnings = 1.0, [], [], []
    nodelet.pub = SimpleNamespace(publish=lambda verdict: nodelet.verdicts.append(verdict.value))
    nodelet.nh = SimpleNamespace(
        Duration=float,
        Time=SimpleNamespace(now=lambda: nodelet.now),
        get_time=lambda: nodelet.now,
        Timer=lambda *args, oneshot: nodelet.timers.append((*args, oneshot)),
        logwarn_throttle=lambda period, text, *args: nodelet.warnings.append(text % args),
    )
    return nodelet


def test_the_timer_goes_on_after_an_error(nodelet):
    def advance(now):
        raise ValueError(now)

    timers = nodelet.timers
    nodelet.monitor = SimpleNamespace(advance=advance, due=None)
    with pytest.raises(ValueError, match="1.0"):
        nodelet.on_timer(None)
    assert timers == [(0.1, nodelet.on_timer, True)]


def test_messages_wait_until_their_individual_is_present(nodelet):
    present: List[Optional[Dict[str, List[str]]]] = [None]
    nodelet.individuals = SimpleNamespace(present=lambda: present[-1])
    nodelet.monitor = parse("f implies every ?c (g)").monitor(1.0)
    nodelet.on_message("f", "", Bool(True))  # the only one, of a latched topic
    nodelet.on_message("g", "left", Bool(True))
    nodelet.on_message("g", "right", Bool(False))
    both = ["left", "right"]
    for nodelet.now, names in ((2.0, ["left"]), (4.0, both), (6.0, both)):
        present.append({"?c": names})
        nodelet.on_timer(None)
    assert nodelet.verdicts == [1, 1, 0, 0]


def test_messages_wait_for_the_individual_of_their_own_variable(nodelet):
    present: Dict[str, List[str]] = {"?c": [], "?d": ["left"]}
    nodelet.individuals = SimpleNamespace(present=lambda: present)
    nodelet.monitor = parse("some ?c (f and g) and every ?d (h)").monitor(1.0)
    for port in "fh":
        nodelet.on_message(port, "left", Bool(True))
    present["?c"] = ["left"]
    nodelet.on_message("g", "left", Bool(True))
    nodelet.now = 3.0
    nodelet.on_timer(None)
    assert nodelet.verdicts == [1, 1]


def test_a_formula_over_verdicts_sees_those_that_the_delay_decides(nodelet_harness):
    alive = {"formula": "age(beat) < 0.5 s", "out": "alive"}
    gone = {"formula": "not alive", "datatypes": {"alive": "dyknow_msgs/Verdict"}}
    nodelet_harness.load(FormulaNodelet, "/a", {"beat": "/beat", "alive": "/alive"}, alive)
    nodelet_harness.load(FormulaNodelet, "/b", {"alive": "/alive", "holds": "/gone"}, gone)
    verdicts = nodelet_harness.listen("/gone")
    for _ in range(20):
        nodelet_harness.publish("/beat", Bool(True))
        nodelet_harness.advance(0.05)
    assert verdicts[-1].value == 0
    nodelet_harness.advance(2.0)
    assert verdicts[-1].value == 1


@pytest.mark.parametrize(
    ("topics", "verdicts"),
    [
        (["/other"], {0}),  # a repair: the same individual
        (["", "/other"], set()),  # another one, which is silent
        (["/f", "", "/f"], set()),
    ],
)
def test_a_port_that_is_disconnected_forgets_its_messages(nodelet_harness, topics, verdicts):
    given = {"formula": "historically[0 s, 60 s] f and g"}
    wiring = {"f": "/f", "g": "/g", "holds": "/holds"}
    nodelet = nodelet_harness.load(FormulaNodelet, "/a", wiring, given)
    before = nodelet_harness.listen("/holds")
    nodelet_harness.publish("/g", Bool(True))  # the only one: a map, say
    for value in (True, False, True):
        nodelet_harness.publish("/f", Bool(value))
        nodelet_harness.advance(1.0)
    for topic in topics:
        nodelet_harness.connect(nodelet, {"f": topic})
        nodelet_harness.drain()
    after = nodelet_harness.listen("/holds")
    nodelet_harness.advance(1.0)
    assert {each.value for each in after} == verdicts
    nodelet_harness.publish(topics[-1], Bool(True))
    nodelet_harness.advance(1.0)
    assert after[-1].value == (0 if verdicts else 1)
    stamps = [each.header.stamp for each in before]
    assert stamps == sorted(set(stamps))


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({}, "expected a formula"),
        ({"formula": 5}, "'~formula' is 5: expected a text"),
        ({"period": "abc"}, "'~period' is 'abc': expected seconds"),
        ({"period": 0}, "expected seconds from 1e-06 to below"),
        ({"hold": -1}, "expected seconds from 0 to below"),
        ({"exact": "false"}, "'~exact' is 'false': expected true or false"),
        ({"max_nodes": "x"}, "'~max_nodes' is 'x': expected an integer"),
        ({"individuals": ["a"]}, "'~individuals' is ['a']: expected tags by port"),
    ],
)
def test_parameters_are_checked(nodelet_harness, parameters, problem):
    given = {"formula": "f", **parameters} if parameters else {}
    with pytest.raises(LoadFailed) as caught:
        nodelet_harness.load(FormulaNodelet, "/a", parameters=given)
    assert problem in str(caught.value)


def test_messages_wait_until_ros_time_begins(nodelet):
    """With simulated time it is zero until a first clock has come."""
    nodelet.monitor = parse("present(f)").monitor(1.0)
    nodelet.now = 0.0
    nodelet.on_message("f", "", PointStamped(header=Header(stamp=Time(100))))
    for nodelet.now in (100.0, 103.0):
        nodelet.on_timer(None)
    assert nodelet.verdicts == [1, 1, 1]


def test_messages_that_come_late_are_reported(nodelet):
    nodelet.monitor = parse("f.header.seq > 0").monitor(0.1)
    for nodelet.now, stamp in ((1.0, 1.0), (2.0, 2.0), (2.5, 2.1)):
        nodelet.on_message("f", "", PointStamped(header=Header(seq=1, stamp=Time(stamp))))
    (warning,) = nodelet.warnings
    assert "a message of port f came more than ~delay after its stamp" in warning
    assert "1 so far" in warning
