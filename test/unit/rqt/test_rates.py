# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rates are computed over time, and start again where a stream does."""

from __future__ import annotations

import pytest

from dyknow.model.graph import PortRef
from dyknow.model.statistics import NodeletCount, PortCount
from dyknow_rqt.graph.measurements import Meter

REF, PERIOD = PortRef("/n", "out"), 0.8


class Source:
    """A port that sends, and a window that receives its counts.

    Time passes in steps of a period; ``rates`` are those that were shown after each.
    """

    def __init__(self):
        self.meter = Meter()
        self.meter.keep({REF: "/t"})
        self.time = self.messages = self.dropped = 0.0
        self.reconfigurations = 0
        self.up_since = -100.0
        self.age, self.size = None, 0

    def shown(self):
        traffic = self.meter.traffic.get(REF)
        return None if traffic is None else (traffic.rate, traffic.drop_rate)

    def passes(self, seconds, rate=0.0, lost=0.0, told=True):
        """Let time pass; returns the values that are shown meanwhile, each once."""
        found = []
        for _ in range(round(seconds / PERIOD)):
            self.time += PERIOD
            self.messages += rate * PERIOD
            self.dropped += lost * PERIOD
            if told:
                sums = int(self.messages + 1e-6), int(self.dropped + 1e-6)
                counts = {"out": PortCount(*sums, self.age, self.size)}
                uptime = self.time - self.up_since
                count = NodeletCount("/n", uptime, self.reconfigurations, counts)
                self.meter.take([count], self.time)
            found.append(self.shown())
        return list(dict.fromkeys(found))

    def rates(self, *args, **options):
        return [each if each is None else each[0] for each in self.passes(*args, **options)]


@pytest.mark.parametrize("hertz", [2, 10, 30, 1000])
def test_a_source_that_stops_is_silent_within_two_seconds(hertz):
    source = Source()
    source.passes(8.0, hertz)
    assert source.shown()[0] == pytest.approx(hertz, rel=0.15)
    source.messages += 1  # it stops just after a count
    source.passes(2 * PERIOD)
    assert source.shown() == (0.0, 0.0)
    assert 2 * PERIOD < 2.0
    assert source.meter.traffic[REF].text == "0 Hz"


@pytest.mark.parametrize("hertz", [0.15, 0.3, 0.7, 1.0])
def test_a_slow_source_is_not_called_silent_between_its_messages(hertz):
    source = Source()
    source.passes(40.0, hertz)
    assert all(rate == pytest.approx(hertz, rel=0.3) for rate in source.rates(60.0, hertz))
    source.passes(12.0)
    assert source.shown()[0] == 0.0


@pytest.mark.parametrize("told", [True, False])
def test_no_rate_is_averaged_over_a_pause(told):
    """Of the source, or of its process, which is not counted then."""
    source = Source()
    source.passes(8.0, 10)
    assert source.rates(16.0, told=told)[-1] == (0.0 if told else pytest.approx(10.0, rel=0.1))
    shown = source.rates(8.0, 10)
    assert all(rate is None or rate == pytest.approx(10.0, rel=0.15) for rate in shown[told:])
    assert source.shown()[0] == pytest.approx(10.0, rel=0.05)


@pytest.mark.parametrize("periods", range(1, 8))
@pytest.mark.parametrize("hertz", [2, 10, 30])
def test_no_rate_is_averaged_over_a_pause_at_the_beginning(periods, hertz):
    source = Source()
    assert set(source.rates(periods * PERIOD)) <= {None, 0.0}
    shown = source.rates(8.0, hertz)
    wrong = [each for each in shown if each and each != pytest.approx(hertz, rel=0.3)]
    assert len(wrong) <= (hertz == 2), "one message is no pace yet"
    assert source.shown()[0] == pytest.approx(hertz, rel=0.15)


def test_a_process_that_does_not_answer_has_no_rate():
    source = Source()
    source.passes(8.0, 10)
    source.meter.take([], source.time + 1.0)
    assert source.shown()
    source.meter.take([], source.time + 3.0)
    assert source.shown() is None


@pytest.mark.parametrize("what", ["by count", "by topic", "both"])
def test_a_new_connection_has_no_rate_and_no_drops_of_before(what):
    source = Source()
    source.passes(8.0, 10, lost=10)
    assert source.shown() == pytest.approx((10.0, 10.0), rel=0.1)
    if what != "by topic":
        source.reconfigurations += 1
    if what != "by count":
        source.meter.keep({REF: "/other"})
        assert source.shown() is None
    shown = source.passes(12.0, 20)
    assert shown[0] is None
    assert {drops for each in shown if each for drops in each[1:]} == {0.0}
    assert all(rate == pytest.approx(20.0) for rate, _ in shown[1:])


def test_counts_that_were_taken_before_a_connection_and_come_after_it_show_no_drops():
    source = Source()
    source.passes(8.0, 10, lost=10)
    source.meter.keep({REF: "/other"})
    source.passes(PERIOD, 10, lost=10)
    source.reconfigurations += 1
    assert {each[1] for each in source.passes(8.0, 10) if each} == {0.0}


def test_a_nodelet_that_was_loaded_again_begins_anew():
    source = Source()
    source.passes(8.0, 10, lost=5)
    source.up_since, source.messages, source.dropped = source.time, 0.0, 0.0
    assert source.passes(8.0, 30)[0] is None
    assert source.shown() == pytest.approx((30.0, 0.0))


def test_a_nodelet_that_was_loaded_again_at_once_begins_anew():
    source = Source()
    source.up_since = 0.0
    source.passes(PERIOD, 30)
    source.up_since, source.messages = source.time, 0.0
    assert source.rates(PERIOD, 10) == [None]
    assert {round(rate) for rate in source.rates(4.0, 10)} == {10}


def test_drops_are_counted_over_seconds():
    source = Source()
    source.passes(5.0, 7)
    drops = [each[1] for each in source.passes(20.0, 7, lost=0.7)][5:]
    assert all(0.4 <= each <= 0.9 for each in drops)
    assert source.meter.traffic[REF].text.startswith("7.0 Hz\n−0.")


def test_ports_that_are_not_known_are_not_measured():
    source = Source()
    source.passes(8.0, 10)
    source.meter.keep({})
    assert source.rates(8.0, 10) == [None]


def test_bandwidth_is_the_rate_times_the_size():
    source = Source()
    source.passes(8.0, 10)
    assert source.meter.traffic[REF].bandwidth is None, "no size is known"
    source.size = 2_000_000
    source.passes(8.0, 10)
    assert source.meter.traffic[REF].bandwidth == pytest.approx(20e6, rel=0.15)
    source.passes(8.0)
    assert source.meter.traffic[REF].bandwidth == 0.0


@pytest.mark.parametrize(
    ("age", "is_old"), [(None, False), (-5.0, False), (0.9, False), (1.5, True), (1e9, False)]
)
def test_messages_are_old_by_stamps_of_the_same_clock(age, is_old):
    source = Source()
    source.age = age
    source.passes(8.0, 10)
    traffic = source.meter.traffic[REF]
    assert traffic.is_old is is_old
    assert traffic.text == "10 Hz" + ("\n1.5 s old" if is_old else "")
    source.passes(8.0)
    assert not source.meter.traffic[REF].is_old, "what does not send is not old, it is silent"


def counted(meter, *seconds, **fields):
    """Let counts of a nodelet come whose callbacks, or processor time, grew so."""
    for number, (busy, cpu) in enumerate(seconds):
        count = NodeletCount("/n", 10.0 + number, 0, {}, busy=busy, cpu=cpu, **fields)
        meter.take([count], float(number))
    return meter.strains["/n"]


def test_a_load_is_measured_over_some_counts():
    meter = Meter()
    assert counted(meter, (5.0, None)).load == 0.0, "one count says nothing"
    assert counted(Meter(), (5.0, None), (5.5, None), (6.5, None)).load == pytest.approx(0.75)
    assert counted(Meter(), (5.0, 1.0), (6.0, 1.2)).load == pytest.approx(0.2), "not waiting"
    assert counted(Meter(), (5.0, None), (9.0, None)).load == 1.0, "with several threads"
    many = [(float(number), None) for number in range(9)]
    assert counted(Meter(), *many, *[(8.0, None)] * 5).load == 0.0, "it is over"


def test_only_a_high_load_and_late_errors_stand_out():
    calm = counted(Meter(), (0.0, None), (0.49, None))
    assert (calm.busy, calm.text) == (0.0, "")
    busy = counted(Meter(), (0.0, None), (0.83, None))
    assert (busy.busy, busy.text) == (pytest.approx(0.85), "85 % of a core")
    failing = counted(Meter(), (0.0, None), recent_error="ZeroDivisionError")
    assert failing.text.endswith(": ZeroDivisionError") and failing.busy == 0.0


def test_the_load_of_what_runs_no_more_is_forgotten():
    meter = Meter()
    meter.keep({REF: "/t"})
    counted(meter, (0.0, None), (1.0, None))
    meter.take([], 9.0)
    assert meter.strains == {}
    counted(meter, (0.0, None), (1.0, None))
    meter.keep({})
    assert meter.strains == {}
