# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import contextlib
import csv
import math
import random

import pytest
import rospy

from dyknow_benchmark import arrival, isolation, system
from dyknow_benchmark.arrival import report_chain
from dyknow_benchmark.chains import KINDS, Block, Order, select
from dyknow_benchmark.main import FAILED, main, parse
from dyknow_benchmark.options import MEASUREMENTS, OUT
from dyknow_benchmark.parts import SwitchedIn, SwitchedOut, payload_of
from dyknow_benchmark.planning_libraries import LIBRARIES
from dyknow_benchmark.results import ARRIVALS, Results, Summary, median_interval
from dyknow_benchmark.switching import delays


def read(path):
    with path.open(newline="") as file:
        return list(csv.reader(file))


def report(found, frequency=100.0, hops=(1, 50), pairs=20):
    """Report a chain of which one message of four is lost."""
    factor = {"dyknow": 2.0, "nodelet": 1.9, "cpp_nodelet": 10.0}
    blocks = {
        kind: Block(4, {each: [times * each] * 3 for each in hops})
        for kind, times in factor.items()
    }
    differences = {each: [0.1 * each + index for index in range(pairs)] for each in hops}
    report_chain(found, frequency, blocks, differences)
    found.end()


def reported(*args, **kwds):
    found = Results()
    report(found, *args, **kwds)
    return found


@pytest.mark.parametrize("place", ["taken", "taken/folder"])
def test_a_place_that_cannot_be_written_to_is_refused_before_anything_is_measured(
    place, tmp_path, monkeypatch, capsys
):
    (tmp_path / "taken").touch()
    monkeypatch.setitem(MEASUREMENTS, "chain", lambda *_: pytest.fail("it is measured"))
    assert main(["--out", str(tmp_path / place)]) == FAILED
    assert str(tmp_path / "taken") in capsys.readouterr().err


def test_what_cannot_be_written_in_the_end_was_shown_and_is_one_line(
    tmp_path, monkeypatch, capsys
):
    def run(arguments, results):
        report(results)
        (tmp_path / "figure4.csv").mkdir()

    monkeypatch.setitem(MEASUREMENTS, "chain", run)
    assert main(["--out", str(tmp_path)]) == FAILED
    shown = capsys.readouterr()
    assert "targets" in shown.out
    assert shown.err.startswith("benchmark: ") and str(tmp_path / "figure4.csv") in shown.err


def test_figure_4_and_the_overhead_are_written_as_tables_and_drawn(tmp_path):
    written = reported().write(tmp_path)
    assert {path.name for path in written} == {
        "figure4.csv", "overhead.csv", "machine.csv", "targets.csv", "figure4.png", "figure4.svg",
    }  # fmt: skip
    header, *rows = read(tmp_path / "figure4.csv")
    assert header == ["kind", "hops", *ARRIVALS]
    assert [(row[0], row[1]) for row in rows] == [
        (kind, hops) for kind in ("dyknow", "nodelet", "cpp_nodelet") for hops in ("1", "50")
    ]
    assert rows[1] == ["dyknow", "50", "3", "1", "100.0", "100.0", "100.0", "100.0"]
    header, *rows = read(tmp_path / "overhead.csv")
    assert header == ["hops", "pairs", "median_us", "low_us", "high_us"]
    assert rows[0] == ["1", "20", "9.600", "5.100", "14.100"]
    assert [row[0] for row in rows] == ["1", "50"]
    assert (tmp_path / "figure4.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "figure4.svg").read_text()


@pytest.mark.parametrize(
    ("frequency", "limit"), [(1.0, 0.35), (5.0, 0.35), (50.0, 0.35), (100.0, 0.25), (200.0, 0.25)]
)
def test_the_target_depends_on_the_frequency(frequency, limit):
    ratio, added = reported(frequency).targets
    assert ratio[1:] == (pytest.approx(0.2), f"<= {limit}", "met")
    assert added[1:] == (pytest.approx(0.0145), "<= 0.02", "met")


def test_targets_are_for_50_hops_only():
    found = reported(hops=(1, 10))
    assert found.met and "no target applies" in found.show()


def test_a_target_is_met_up_to_its_limit():
    found = Results()
    found.verdict("x", 2.0, 2.0)
    found.verdict("x", 20.0, 20.0, at_least=True)
    assert found.met
    for measured, limit, at_least in ((2.1, 2.0, False), (19.9, 20.0, True)):
        found = Results()
        found.verdict("x", measured, limit, at_least)
        assert not found.met
    assert found.targets == [("x", 19.9, ">= 20", "NOT met")]


def test_a_chain_that_delivered_nothing_has_rows_and_meets_no_target():
    found = Results()
    report_chain(found, 5.0, {kind: Block(4, {50: []}) for kind in ("dyknow", "cpp_nodelet")}, {})
    assert [tuple(row[:4]) for row in found.tables[0].rows] == [
        ("dyknow", 50, 0, 4),
        ("cpp_nodelet", 50, 0, 4),
    ]
    assert not found.met and "no target applies" not in found.show()


def test_nothing_that_came_meets_no_target_between_processes():
    """A median of 0 would be better than any."""
    some, none = Summary.of([1.0, 2.0]), Summary.of([])
    for ours, theirs in ((none, some), (some, none)):
        found = Results()
        isolation._judge(found, "time", ("", *ours.arrivals(2)), ("", *theirs.arrivals(2)))
        assert not found.met


def test_a_measurement_that_breaks_off_is_not_a_target_that_is_not_met(monkeypatch, capsys):
    def run(arguments, results):
        raise rospy.ServiceException("transport error")

    monkeypatch.setitem(MEASUREMENTS, "images", run)
    assert main(["images", "--check"]) == FAILED
    assert "transport error" in capsys.readouterr().err


def test_a_size_that_is_given_twice_is_measured_once(monkeypatch):
    built = []
    monkeypatch.setattr(arrival, "Session", contextlib.nullcontext)
    monkeypatch.setattr(arrival, "build", lambda *given: built.append(given[-1]))
    monkeypatch.setattr(
        arrival, "alternating", lambda chains, orders: dict.fromkeys(chains, Block(0, {50: []}))
    )
    assert main(["images", "--sizes", "4x3", "time", "4x3"]) == 0
    assert built == ["time", "4x3"]


def test_the_warm_up_is_left_out_at_every_hop_alike():
    early = {1.0: 10.0, 2.0: 11.0, 3.0: 12.0, 4.0: 13.0}
    late = {1.0: 20.0, 3.0: 22.0, 4.0: 23.0}  # a message of the warm-up was lost on its way
    block = select({1: early, 2: late}, Order(warm_up=2, count=2, frequency=5.0))
    assert block == Block(2, {1: [12.0, 13.0], 2: [22.0, 23.0]})


@pytest.mark.parametrize(
    ("words", "command", "rate", "messages"),
    [
        ("", "chain", 5.0, 1000),
        ("--quick", "chain", 100.0, 400),
        ("--rate 7 --quick", "chain", 7.0, 400),
        ("images --messages 3", "images", 20.0, 3),
    ],
)
def test_without_a_name_the_measurement_is_the_chain_of_the_paper(words, command, rate, messages):
    found = parse(words.split())
    assert (found.command, found.rate, found.messages) == (command, rate, messages)
    assert found.out == (OUT if command == "chain" else None)
    if command == "chain":
        assert found.hops == [1, 2, 5, 10, 20, 50]
        assert found.kinds == [
            each for each in KINDS if each not in ("isolated", "script", "cpp_live")
        ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("chains", "invalid choice: 'chains'"),
        *((f"chain {each}", each.split()[0]) for each in ("--hops 0", "--kinds nodes")),
        *((f"chain {each}", each.split()[0]) for each in ("--messages x", "--rate 0")),
        ("images --sizes 4x", "640x480"),
        ("chain --qui", "--qui"),
    ],
)
def test_a_wrong_option_is_refused(words, said, capsys):
    with pytest.raises(SystemExit) as error:
        parse(words.split())
    assert error.value.code == 2
    assert said in capsys.readouterr().err


def test_a_payload_is_a_time_or_images_of_a_size():
    image = payload_of("4x3").make()
    assert (image.width, image.height, len(image.data)) == (4, 3, 36)
    assert payload_of("time").make().data.to_nsec() == 0
    for wrong in ("image", "0x3", "4x", "4x3x2"):
        with pytest.raises(ValueError, match="640x480"):
            payload_of(wrong)


# Statistics


def test_a_summary_does_not_depend_on_the_order():
    values = [float(each) for each in range(1, 201)]
    shuffled = values[:]
    random.Random(1).shuffle(shuffled)
    assert Summary.of(shuffled) == Summary.of(values) == Summary(200, 100.5, 100.5, 198.0, 200.0)
    assert Summary.of([]) == Summary(0, *[math.nan] * 4)


@pytest.mark.parametrize(
    ("count", "ranks"),
    [(1, (1, 1)), (5, (1, 5)), (6, (1, 6)), (20, (6, 15)), (100, (40, 61)), (5000, (2431, 2570))],
)
def test_the_interval_of_the_median_is_that_of_the_binomial_distribution(count, ranks):
    assert median_interval([float(each) for each in range(count, 0, -1)]) == ranks


# Messages by their numbers


def ticking():
    ticks = iter(range(0, 10**12, 10**9))
    return lambda: next(ticks)


@pytest.mark.parametrize(
    ("numbers", "lost", "doubled", "changes"),
    [
        ([0, 2, 4, 6], 0, 0, 0),
        ([10, 12, 13, 15, 16, 18], 0, 0, 2),
        ([10, 12, 15, 17], 0, 0, 1),  # 13 came before the switch, on the topic that was not ours
        ([10, 12, 11, 13], 0, 0, 1),  # the new topic was collected before the old one was left
        ([10, 12, 17, 19], 1, 0, 1),
        ([0, 2, 8, 10], 2, 0, 0),
        ([0, 2, 2, 4], 0, 1, 0),
        ([10, 12, 13, 12, 15], 0, 1, 1),
        ([10, 13, 10, 12, 16], 1, 1, 2),
    ],
)
def test_an_in_port_that_is_switched(numbers, lost, doubled, changes):
    watch = SwitchedIn(ticking())
    for number in numbers:
        watch.receive(number)
    assert watch.collect() == [lost, doubled, *map(float, range(changes))]


@pytest.mark.parametrize(
    ("arrivals", "lost", "doubled", "changes"),
    [
        ("l3 l4 l5", 0, 0, 0),
        ("l3 r4 r5 l6", 0, 0, 2),
        ("l3 r4 l4 r5", 0, 1, 1),
        ("l3 r6 r5 r7", 2, 1, 1),
    ],
)
def test_an_out_port_that_is_switched(arrivals, lost, doubled, changes):
    watch = SwitchedOut(ticking())
    for each in arrivals.split():
        watch.receive(each[0], int(each[1:]))
    assert watch.collect() == [lost, doubled, *map(float, range(changes))]


def test_each_request_is_paired_with_the_first_message_after_it_if_there_is_one():
    assert delays([1.0, 2.0, 3.0], [1.25, 2.5, 3.125]) == [250.0, 500.0, 125.0]
    assert delays([1.0, 2.0, 3.0], [0.5, 1.25, 3.5]) == [250.0, 500.0]
    assert delays([1.0], []) == []


def test_every_library_is_planned_over_for_every_sort_of_demand(tmp_path, capsys):
    assert main(["plan", "--transformations", "400", "--out", str(tmp_path)]) == 0
    with (tmp_path / "plan.csv").open(newline="") as file:
        rows = {(row["library"], row["demand"]): row for row in csv.DictReader(file)}
    assert {library for library, _ in rows} == set(LIBRARIES)
    assert {row["transformations"] for row in rows.values()} == {"400"}
    assert rows["deep", "ground"]["steps"] == "92"  # the last plan is for the 92nd of a chain
    assert int(rows["dense", "ground"]["steps"]) > 92
    assert int(rows["rules, three variables", "variable"]["steps"]) > 9
    assert int(rows["individuals with an ontology", "class"]["steps"]) > 9
    assert "400 transformations: slowest demand" in capsys.readouterr().out


def test_a_library_of_any_size_is_measured_and_a_target_that_is_not_met_fails_a_check(monkeypatch):
    monkeypatch.setattr(system, "_PLAN", -1.0)
    assert main(["plan", "--transformations", "1", "101"]) == 0
    assert main(["plan", "--transformations", "1", "--check"]) == 1
