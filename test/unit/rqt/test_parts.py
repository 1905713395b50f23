# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parts of a drawing: laid out one by one, packed to the shape of the view, and left there."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as some
from unit.rqt.test_graph import drawn, nodelet, sizes_of

from dyknow_rqt.graph.figure import Options, figure_of
from dyknow_rqt.graph.geometry import Size, around
from dyknow_rqt.graph.parts import MOST, divide, pack
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph.stabilise import moved


def chains(count, length=5, space="/chain{}/", joined=False):
    """Chains of nodelets, each in a namespace; joined: each feeds the next."""
    found = []
    for number in range(count):
        here = space.format(number)
        first = f"{space.format(number - 1)}t{length}" if joined and number else f"{here}t0"
        for place in range(length):
            source = f"{here}t{place}" if place else first
            found.append(nodelet(f"{here}n{place}", f">in={source}", f"out>={here}t{place + 1}"))
    return found


def figure_of_all(nodelets, **options):
    return figure_of(Snapshot(tuple(nodelets)), Options(**options))


def bounds(drawing):
    sizes = drawing.sizes
    areas = [around(centre, sizes[key]) for key, centre in drawing.layout.centres.items()]
    areas += drawing.layout.boxes.values()
    lefts, tops, rights, bottoms = zip(*areas)
    return max(rights) - min(lefts), max(bottoms) - min(tops)


def check_boxes(drawing):
    """Boxes hold their vertices, and nothing that belongs elsewhere."""
    boxes = drawing.layout.boxes
    for vertex in drawing.figure.vertices:
        area = around(drawing.layout.centres[vertex.key], drawing.sizes[vertex.key])
        for group, box in boxes.items():
            assert box.meets(area) is (vertex.group[: len(group)] == group), (vertex.key, group)
    for one, area in boxes.items():
        for other, another in boxes.items():
            nested = one[: len(other)] == other or other[: len(one)] == one
            assert nested or not area.meets(another), (one, other)


@pytest.mark.parametrize("is_downwards", [False, True])
@pytest.mark.parametrize("are_laid_out", [True, False])
@pytest.mark.parametrize("joined", [True, False])
def test_boxes_are_around_their_own_and_the_page_has_the_shape_of_the_view(
    is_downwards, are_laid_out, joined
):
    nodelets = chains(40, joined=joined) + chains(6, space="/deep/{}/")
    nodelets += [*chains(3, space="/{}_"), nodelet("/other/idle", "out>")]
    figure = figure_of_all(nodelets, is_downwards=is_downwards)
    shape = 0.6 if is_downwards else 1.6
    drawing = drawn(figure, shape=shape, are_laid_out=are_laid_out)
    check_boxes(drawing)
    width, height = bounds(drawing)
    assert shape / 1.5 < width / height < 1.5 * shape
    assert set(drawing.layout.curves) == set(figure.edges)


def test_parts_stand_in_reading_order():
    drawing = drawn(figure_of_all(chains(12)))
    boxes = drawing.layout.boxes
    ordered = sorted(boxes, key=lambda group: (round(boxes[group].top / 20), boxes[group].left))
    assert [group[0] for group in ordered] == [f"/chain{number}" for number in range(12)]


def test_a_part_that_is_large_is_divided_into_its_boxes():
    figure = figure_of_all(chains(40, joined=True))
    assert len(figure.vertices) > MOST
    parts = divide(figure)
    assert [len(part.figure.vertices) for part in parts] == [11] + [10] * 39
    (one,) = divide(figure_of_all(chains(4, joined=True)))
    assert not one.parts
    (whole,) = divide(figure_of_all(chains(40, space="/all/{}/", joined=True)))
    assert len(whole.parts) == 40 and len(list(whole.leaves())) == 40
    (giant,) = divide(figure_of_all(chains(40, space="/{}_", joined=True)))
    assert list(giant.leaves()) == [giant]
    assert sum(len(each.figure.vertices) for each in divide(giant.figure, 1)) == 401


@pytest.mark.parametrize("joined", [True, False])
def test_a_connection_between_two_groups_leaves_everything_where_it_is(joined):
    nodelets = chains(40, joined=joined)
    before = drawn(figure_of_all(nodelets))
    for number in (7, 9):  # backwards, and to a group that is far
        place = [each.name for each in nodelets].index(f"/chain{number}/n0")
        port = replace(nodelets[place].ports[0], topic="/chain20/t5")
        nodelets[place] = replace(nodelets[place], ports=(port, *nodelets[place].ports[1:]))
        after = drawn(figure_of_all(nodelets), before)
        changed = [
            key for key in moved(before.layout, after.layout) if f"/chain{number}/" not in key
        ]
        assert not changed
        assert ("t_/chain20/t5", f"n_/chain{number}/n0") in {
            (e[0], e[2]) for e in after.figure.edges
        }
        check_boxes(after)
        before = after


def test_what_comes_goes_or_grows_moves_nothing_else():
    nodelets = chains(20)
    before = drawn(figure_of_all(nodelets))
    for change in (
        [*nodelets, nodelet("/chain3/more", ">in=/chain3/t2", "out>=/chain3/x")],
        nodelets + chains(1, 9, space="/another{}/"),
        [each for each in nodelets if "/chain4/" not in each.name],
        [*nodelets, nodelet("/alone", "out>")],
    ):
        after = drawn(figure_of_all(change), before)
        assert not [key for key in moved(before.layout, after.layout) if "/chain3/" not in key]
        check_boxes(after)


def test_what_comes_is_drawn_with_all_arrows_before_it_is_laid_out():
    nodelets = chains(12, joined=True)
    before = drawn(figure_of_all(nodelets))
    more = [*nodelets, nodelet("/chain3/more", ">in=/chain3/t2", "out>=/chain3/x")]
    figure = figure_of_all(more)
    after = drawn(figure, before, are_laid_out=False)
    assert set(after.layout.curves) == set(figure.edges)
    check_boxes(after)


_SIZES = some.builds(Size, some.floats(10, 500), some.floats(10, 200))


@given(some.lists(_SIZES, min_size=1, max_size=40), some.floats(0.3, 3.0))
def test_packed_rectangles_do_not_meet_and_follow_each_other(sizes, shape):
    areas = [around(*each) for each in zip(pack(sizes, shape), [Size(0.0, 0.0)] * len(sizes))]
    areas = [a._replace(right=a.left + w, bottom=a.top + h) for a, (w, h) in zip(areas, sizes)]
    for before, after in zip(areas, areas[1:]):
        assert after.left > before.right or (after.top > before.top and after.left == 0.0)
    for number, area in enumerate(areas):
        assert not any(area.meets(other) for other in areas[:number])


def test_a_figure_of_nothing_is_drawn():
    assert drawn(figure_of_all([])).layout.centres == {}
    assert sizes_of(figure_of_all([])) == {}
