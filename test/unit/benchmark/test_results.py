# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import csv

import pytest

from dyknow_benchmark import chain, ratios, tables
from dyknow_benchmark.chain import HEADER, OVERHEAD_HEADER, ChainPlan
from dyknow_benchmark.control import Block, Order, select
from dyknow_benchmark.fan import last_arrivals
from dyknow_benchmark.main import FAILED, main, parser, with_measurement
from dyknow_benchmark.outside import spread
from dyknow_benchmark.parts import payload_of
from dyknow_benchmark.results import Results
from dyknow_benchmark.targets import Verdict


def read(path):
    with path.open(newline="") as file:
        return list(csv.reader(file))


def measured(frequency=100.0, hops=(1, 50), pairs=20):
    kinds = ["dyknow", "nodelet", "cpp_nodelet"]
    plan = ChainPlan(kinds, hops, frequency, 4, 2, pairs)
    factor = {"dyknow": 2.0, "nodelet": 1.9, "cpp_nodelet": 10.0}
    blocks = {kind: Block(4, {each: [factor[kind] * each] * 3 for each in hops}) for kind in kinds}
    differences = {each: [0.1 * each + index for index in range(pairs)] for each in hops}
    return chain.results_of(plan, blocks, differences, [], [("cores", 2)])


@pytest.mark.parametrize("place", ["taken", "taken/folder"])
def test_a_place_that_cannot_be_written_to_is_refused_before_anything_is_measured(
    place, tmp_path, monkeypatch, capsys
):
    (tmp_path / "taken").touch()
    monkeypatch.setattr(chain, "run", lambda arguments: pytest.fail("it is measured"))
    assert main(["--out", str(tmp_path / place)]) == FAILED
    assert f"{tmp_path / 'taken'} is not a folder" in capsys.readouterr().err


def test_what_cannot_be_written_in_the_end_was_shown_and_is_one_line(
    tmp_path, monkeypatch, capsys
):
    def run(arguments):
        (tmp_path / "taken").touch()
        return measured()

    monkeypatch.setattr(chain, "run", run)
    assert main(["--out", str(tmp_path / "taken")]) == FAILED
    shown = capsys.readouterr()
    assert "targets" in shown.out
    assert shown.err.startswith(f"benchmark: cannot write to {tmp_path / 'taken'}: ")


def test_figure_4_has_one_row_for_each_kind_and_number_of_hops(tmp_path):
    measured().write(tmp_path)
    header, *rows = read(tmp_path / "figure4.csv")
    assert header == list(HEADER)
    assert [(row[0], row[1]) for row in rows] == [
        (kind, hops) for kind in ("dyknow", "nodelet", "cpp_nodelet") for hops in ("1", "50")
    ]
    assert rows[1] == ["dyknow", "50", "3", "1", "100.0", "100.0", "100.0", "100.0"]


def test_the_overhead_has_one_row_for_each_number_of_hops(tmp_path):
    measured().write(tmp_path)
    header, *rows = read(tmp_path / "overhead.csv")
    assert header == list(OVERHEAD_HEADER)
    assert rows[0] == ["1", "20", "9.600", "5.100", "14.100"]
    assert [row[0] for row in rows] == ["1", "50"]


def test_the_figure_is_drawn_in_both_formats(tmp_path):
    written = measured().write(tmp_path)
    assert {path.name for path in written} == {
        "figure4.csv", "overhead.csv", "machine.csv", "targets.csv", "figure4.png", "figure4.svg",
    }  # fmt: skip
    assert (tmp_path / "figure4.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "figure4.svg").read_text()


@pytest.mark.parametrize(("frequency", "limit"), [(100.0, 0.25), (5.0, 0.35)])
def test_the_target_depends_on_the_frequency(frequency, limit):
    ratio, added = measured(frequency).verdicts
    assert (ratio.measured, ratio.limit, ratio.met) == (pytest.approx(0.2), limit, True)
    assert (added.measured, added.limit, added.met) == (pytest.approx(0.0145), 0.02, True)


def test_targets_are_for_50_hops_only():
    results = measured(hops=(1, 10))
    assert results.verdicts == []
    assert "no target applies" in results.show()
    assert results.met


def test_a_verdict_says_whether_the_target_is_met():
    assert Verdict("x", 2.0, 2.0).met and Verdict("x", 20.0, 20.0, at_least=True).met
    assert not Verdict("x", 2.1, 2.0).met and not Verdict("x", 19.9, 20.0, at_least=True).met
    assert Verdict("x", 19.9, 20.0, at_least=True).row == ("x", 19.9, ">= 20", "NOT met")
    assert not Results([], [Verdict("x", 1, 2), Verdict("x", 3, 2)]).met


def test_a_chain_that_delivered_nothing_has_rows_but_no_verdict():
    plan = ChainPlan(["dyknow", "cpp_nodelet"], [50], 5.0, 4, 1, 0)
    results = chain.results_of(plan, {kind: Block(4, {50: []}) for kind in plan.kinds}, {}, [], [])
    assert [tuple(row[:4]) for row in results.tables[0].rows] == [
        ("dyknow", 50, 0, 4),
        ("cpp_nodelet", 50, 0, 4),
    ]
    assert results.verdicts == []


def test_the_warm_up_is_left_out_at_every_hop_alike():
    early = {1.0: 10.0, 2.0: 11.0, 3.0: 12.0, 4.0: 13.0}
    late = {1.0: 20.0, 3.0: 22.0, 4.0: 23.0}  # a message of the warm-up was lost on its way
    block = select({1: early, 2: late}, Order(warm_up=2, count=2, frequency=5.0))
    assert block == Block(2, {1: [12.0, 13.0], 2: [22.0, 23.0]})


def test_the_blocks_of_a_plan_add_up():
    orders = ChainPlan(["dyknow"], [1], 5.0, 1003, 10, 0).orders()
    assert sum(order.count for order in orders) == 1003
    assert {order.count for order in orders} == {100, 101}
    assert len(ChainPlan(["dyknow"], [1], 5.0, 3, 10, 0).orders()) == 3


def test_numbers_stand_to_the_right_in_a_table():
    assert tables.render(("kind", "us"), [("a", 1.0), ("bcdef", 1234.5)]).splitlines() == [
        "kind       us",
        "-----  ------",
        "a       1.000",
        "bcdef  1234.5",
    ]
    assert tables.render(("kind",), []).splitlines() == ["kind", "----"]


def test_without_options_the_setting_is_the_papers():
    plan = chain.plan_of(parser().parse_args(["chain"]))
    assert plan == chain.PAPER
    assert (plan.hops, plan.frequency, plan.messages) == (
        (1, 2, 5, 10, 20, 50),
        5.0,
        1000,
    )
    assert set(plan.kinds) == {
        "dyknow", "nodelet", "node", "cpp_nodelet", "cpp_node", "function",
    }  # fmt: skip


def test_without_a_name_the_measurement_is_the_chain(capsys):
    assert with_measurement([]) == ["chain"]
    assert with_measurement(["--quick"]) == ["chain", "--quick"]
    assert with_measurement(["images", "--quick"]) == ["images", "--quick"]
    assert with_measurement(["--help"]) == ["--help"]
    with pytest.raises(SystemExit):
        parser().parse_args(with_measurement(["chains"]))
    assert "invalid choice: 'chains'" in capsys.readouterr().err


def test_the_chain_is_never_measured_for_nothing():
    assert parser().parse_args(["chain"]).out == chain.OUT
    assert parser().parse_args(["idle"]).out is None


def test_options_go_over_the_quick_setting():
    arguments = ["chain", "--quick", "--kinds", "node", "dyknow", "--hops", "3", "1", "3"]
    plan = chain.plan_of(parser().parse_args(arguments))
    assert (plan.kinds, plan.hops) == (("dyknow", "node"), (1, 3))
    assert plan.frequency == chain.QUICK.frequency
    assert not plan.paired


@pytest.mark.parametrize(
    "wrong", [["--hops", "0"], ["--kinds", "nodes"], ["--messages", "x"], ["--rate", "0"]]
)
def test_a_wrong_option_is_refused(wrong, capsys):
    with pytest.raises(SystemExit) as error:
        parser().parse_args(["chain", *wrong])
    assert error.value.code == 2
    assert wrong[0] in capsys.readouterr().err


def test_the_last_receiver_counts_and_a_block_with_a_gap_does_not():
    assert last_arrivals(Block(2, {1: [1.0, 5.0], 2: [2.0, 4.0]})) == [2.0, 5.0]
    assert last_arrivals(Block(2, {1: [1.0, 5.0], 2: [2.0]})) == []


def test_subscribers_outside_are_spread_over_the_chain():
    assert spread(50, 0) == []
    assert spread(50, 1) == [50]
    assert spread(10, 3) == [4, 7, 10]
    assert spread(4, 4) == [1, 2, 3, 4]


def test_a_payload_is_a_time_or_images_of_a_size():
    image = payload_of("4x3").make()
    assert (image.width, image.height, len(image.data)) == (4, 3, 36)
    assert payload_of("time").make().data.to_nsec() == 0
    for wrong in ("image", "0x3", "4x", "4x3x2"):
        with pytest.raises(ValueError, match="640x480"):
            payload_of(wrong)


def test_a_ratio_has_the_limit_of_its_frequency():
    limits = {
        rate: ratios.to_peer(1.0, 2.0, rate).limit for rate in (1.0, 5.0, 50.0, 100.0, 200.0)
    }
    assert limits == {1.0: 0.35, 5.0: 0.35, 50.0: 0.35, 100.0: 0.25, 200.0: 0.25}
