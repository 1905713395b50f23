# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import random

import pytest

from dyknow_benchmark.summary import Summary, median, median_interval, quantile


def test_a_summary_of_no_values_is_all_zero():
    assert Summary.of([]) == Summary(0, 0.0, 0.0, 0.0, 0.0)


def test_a_summary_does_not_depend_on_the_order():
    values = [float(each) for each in range(1, 201)]
    shuffled = values[:]
    random.Random(1).shuffle(shuffled)
    assert Summary.of(shuffled) == Summary.of(values) == Summary(200, 100.5, 100.5, 198.0, 200.0)


def test_at_least_the_share_does_not_exceed_the_quantile():
    values = list(range(1000))
    for share in (0.0, 0.5, 0.9, 0.99, 1.0):
        assert sum(each <= quantile(values, share) for each in values) >= share * len(values)
    assert quantile([7.0], 0.99) == 7.0


def test_the_median_of_an_even_number_lies_between_the_two_in_the_middle():
    assert median([4.0, 1.0, 3.0, 2.0]) == 2.5
    assert median([9.0]) == 9.0
    with pytest.raises(ValueError, match="no values"):
        median([])


@pytest.mark.parametrize(
    ("count", "ranks"),
    [(1, (1, 1)), (5, (1, 5)), (6, (1, 6)), (20, (6, 15)), (100, (40, 61)), (5000, (2431, 2570))],
)
def test_the_interval_of_the_median_is_that_of_the_binomial_distribution(count, ranks):
    assert median_interval([float(each) for each in range(count, 0, -1)]) == ranks


def test_the_interval_holds_the_true_median_as_often_as_it_says():
    source = random.Random(2)
    held = 0
    for _ in range(1000):
        low, high = median_interval([source.expovariate(1.0) for _ in range(20)])
        held += low <= 0.6931 <= high
    assert held >= 940
