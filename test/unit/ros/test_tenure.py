# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Of two managers of one name exactly one goes on, whichever looks or registers first."""

from __future__ import annotations

import itertools
from typing import Any, Dict, Iterable, List, Tuple

import pytest
from clocks import HandClock

from dyknow.errors import PeerTimeout
from dyknow.periodic import ControlLoop
from dyknow.ros.manager.tenure import PATIENCE, VARIABLE, Tenure, TenureVerdict
from dyknow.ros.process.node_process import name_of

NAME = "/dyknow_manager"


class Parameters:
    """A master as far as tenures need one: parameters, and the last node that registered."""

    def __init__(self) -> None:
        self.values: Dict[str, Any] = {}
        self.holder = ""
        self.is_away = False

    def ask(self, question: str, key: str, *values: Any) -> Any:
        if self.is_away:
            raise PeerTimeout("the master", 1.0)
        if question == "setParam" and key == NAME:
            self.values.update({f"{NAME}/{name}": value for name, value in values[0].items()})
        elif question == "setParam":
            self.values[key] = values[0]
        elif key not in self.values:
            raise LookupError(key)
        elif question == "getParam":
            return self.values[key]
        else:
            del self.values[key]
        return 0

    def ask_all(self, questions: Iterable[Tuple[str, ...]]) -> List[Any]:
        if self.is_away:
            raise PeerTimeout("the master", 1.0)
        answers = {"getParam": self.values.get(f"{NAME}/tenure"), "lookupNode": self.holder}
        return [answers[question] for question, *_ in questions]


class Side:
    """One manager, whose registration and look are separate steps."""

    def __init__(self, master: Parameters, uri: str) -> None:
        self.now = 0.0
        self.master, self.uri = master, uri

    def start(self, kept: str = "") -> None:
        self.tenure = Tenure(NAME, self.master, kept, lambda: self.now)  # type: ignore[arg-type]
        self.verdict = TenureVerdict.HOLD
        self.tenure.take()
        self.tenure._uri = self.uri
        self.register()

    def register(self) -> None:
        self.master.holder = self.uri

    def look(self) -> None:
        if self.verdict is not TenureVerdict.HOLD:
            return
        self.verdict = self.tenure.look()
        if self.verdict is TenureVerdict.RETURN:
            self.tenure.take_back({})
            self.start(self.tenure.variables[VARIABLE])
            assert self.tenure.is_resumed


@pytest.fixture
def pair() -> Tuple[Side, Side]:
    """The elder, which was cut off, and the one that was started meanwhile."""
    master = Parameters()
    elder, younger = Side(master, "http://elder:1/"), Side(master, "http://younger:1/")
    elder.start()
    younger.start()
    return elder, younger


@pytest.mark.parametrize(
    "steps", sorted(set(itertools.permutations(["elder", "younger", "stray", "elder", "younger"])))
)
def test_the_elder_goes_on_in_whatever_order_they_look(pair, steps):
    elder, younger = pair
    for step in (*steps, "elder", "younger"):
        if step == "stray":  # a registration that the elder sent earlier arrives
            elder.register()
        else:
            (elder if step == "elder" else younger).look()
    assert younger.verdict is TenureVerdict.LEAVE
    assert elder.verdict is TenureVerdict.HOLD
    assert elder.master.holder == elder.uri


def test_a_manager_that_is_alone_holds_its_name_whatever_happens_to_it() -> None:
    side = Side(Parameters(), "http://elder:1/")
    side.start()
    for _ in range(3):
        side.look()
        side.now += PATIENCE
        assert (side.verdict, side.master.holder) == (TenureVerdict.HOLD, side.uri)
    side.master.values.clear()  # a new master gets the entry again
    side.look()
    assert side.master.values[f"{NAME}/tenure"] == list(side.tenure.entry or ())
    stranger = side.master.holder = "http://stranger:1/"  # which has no entry
    for pause, holder in ((0.0, stranger), (PATIENCE / 2, stranger), (PATIENCE, side.uri)):
        side.now += pause
        side.look()
        assert side.master.holder == holder


def test_while_the_master_is_away_nothing_is_decided_and_who_starts_is_the_younger() -> None:
    master = Parameters()
    elder, younger = Side(master, "http://elder:1/"), Side(master, "http://younger:1/")
    elder.start()
    master.is_away = True
    younger.start()
    elder.look()
    younger.look()
    assert elder.verdict is younger.verdict is TenureVerdict.HOLD
    master.is_away = False
    for side in (younger, elder, younger):
        side.look()
    assert (elder.verdict, younger.verdict) == (TenureVerdict.HOLD, TenureVerdict.LEAVE)


def test_an_end_on_purpose_removes_only_its_own_entry(pair: Tuple[Side, Side]) -> None:
    elder, younger = pair
    elder.tenure.give_back()
    assert younger.tenure.look() is TenureVerdict.HOLD
    younger.tenure.give_back()
    assert f"{NAME}/tenure" not in younger.master.values


def test_the_loop_looks_until_the_name_is_decided(pair: Tuple[Side, Side]) -> None:
    elder, younger = pair
    clock, done = HandClock(), []
    loop = ControlLoop(clock=clock)
    younger.tenure.watch(
        loop, younger.uri, lambda: done.append("leave"), lambda: done.append("come back")
    )

    def looks(until: float) -> int:
        count = 0
        for moment in loop.advance(until):
            clock.time = moment
            count += 1
        return count

    assert (looks(3.0), done) == (3, [])
    elder.look()
    assert (looks(100.0), done) == (1, ["leave"])


@pytest.mark.parametrize("given", ["robot1", "/robot1", "/robot1/"])
def test_the_name_is_global_however_its_namespace_is_given(given, monkeypatch):
    assert name_of(["manager", f"__ns:={given}"], "dyknow_manager") == "/robot1/dyknow_manager"
    monkeypatch.setenv("ROS_NAMESPACE", given)
    assert name_of(["manager", "__name:=m"], "dyknow_manager") == "/robot1/m"
