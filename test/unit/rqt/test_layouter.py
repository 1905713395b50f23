# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""graphviz may take its time, fail, or not be there: there is a drawing all the same."""

from __future__ import annotations

import stat

import pytest
from unit.rqt.hands import until
from unit.rqt.test_graph import chains, check_boxes, figure_of_all, nodelet, sizes_of

from dyknow_rqt.graph.geometry import Drawing
from dyknow_rqt.graph.layout import DrawingOrder
from dyknow_rqt.graph.stabilise import MOST_MOVED, backwards, moved
from dyknow_rqt.graph_panel.layouter import Layouter


class Watched:
    """A layouter and the drawings and complaints that come from it."""

    def __init__(self, program="dot", **options):
        self.layouter = Layouter(str(program), **options)
        self.drawings, self.complaints = [], []
        self.layouter.ready.connect(self.drawings.append)
        self.layouter.failed.connect(self.complaints.append)

    def lay_out(self, nodelets, **options):
        figure = figure_of_all(nodelets)
        self.layouter.lay_out(DrawingOrder(figure, sizes_of(figure), **options))
        return figure


@pytest.fixture
def script(tmp_path):
    """A program in place of graphviz: a function that writes it."""

    def write(text):
        path = tmp_path / "layout"
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(path.stat().st_mode | stat.S_IEXEC)
        return path

    return write


@pytest.mark.parametrize("program", ["no_such_program", "true", "false"])
def test_without_graphviz_there_is_still_a_drawing(qtbot, program):
    watched = Watched(program)
    figure = watched.lay_out(chains(4))
    until(qtbot, lambda: watched.drawings and watched.complaints)
    (complaint,) = watched.complaints
    assert f"'{program}' can" in complaint
    assert len(watched.drawings) <= 2, "more than before and after a slow failure"
    for drawing in watched.drawings:
        assert set(drawing.layout.centres) == {vertex.key for vertex in figure.vertices}
        check_boxes(drawing)
    longer = watched.lay_out(chains(5))
    until(qtbot, lambda: watched.drawings[-1].figure.edges == longer.edges)
    watched.layouter.close()


def test_graphviz_is_asked_again_after_a_shell_that_could_not_be_started(qtbot, monkeypatch):
    watched = Watched()
    process = watched.layouter._process
    begin, begun = process.start, []

    def start(shell, words):
        begun.append(shell)
        begin(shell if begun[1:] else "/no/such/shell", words)

    monkeypatch.setattr(process, "start", start)
    watched.lay_out(chains(4))
    until(qtbot, lambda: watched.complaints and watched.layouter.is_idle)
    watched.lay_out(chains(5))
    until(qtbot, lambda: watched.layouter.is_idle)
    assert len(begun) == 2 and len(watched.complaints) == 1
    watched.layouter.close()


def test_what_takes_long_is_spread_first_and_swapped_in(qtbot, script, tmp_path):
    done = tmp_path / "done"
    watched = Watched(script(f"while [ ! -e {done} ]; do sleep 0.01; done; exec dot $@"))
    watched.lay_out(chains(4))
    until(qtbot, lambda: watched.drawings)
    check_boxes(watched.drawings[0])
    done.touch()
    until(qtbot, lambda: len(watched.drawings) == 2)
    last = watched.drawings[-1]
    curves = [last.layout.curves[edge] for edge in last.figure.edges]
    assert all(curve[0].x < curve[-1].x for curve in curves)
    assert last.is_anew is False and not watched.complaints
    watched.layouter.close()


def test_what_is_not_drawn_any_more_is_not_waited_for(qtbot, script):
    watched = Watched(script('grep -q "/slow" && exec sleep 1000; exec false'))
    watched.lay_out(chains(1, space="/slow{}/"))
    until(qtbot, lambda: watched.layouter._running)
    figure = watched.lay_out(chains(1, space="/quick{}/"))
    until(qtbot, lambda: watched.drawings and watched.drawings[-1].figure.edges == figure.edges)
    watched.layouter.close()


def test_only_parts_that_have_changed_go_to_graphviz(qtbot, script, tmp_path):
    log = tmp_path / "log"
    watched = Watched(script(f"tee -a {log} | exec dot $@"))
    watched.lay_out(chains(3))
    until(qtbot, lambda: watched.layouter.is_idle)
    log.write_text("")
    watched.lay_out(chains(4))
    until(qtbot, lambda: watched.layouter.is_idle)
    assert "/chain3/n0" in log.read_text() and "/chain2/n0" not in log.read_text()
    log.unlink()
    watched.lay_out(chains(2), anew=True)
    until(qtbot, lambda: watched.layouter.is_idle)
    assert watched.drawings[-1].is_anew and not log.exists()
    watched.layouter.close()


def test_a_new_layout_is_not_lost_to_a_figure_that_comes_meanwhile(qtbot):
    watched = Watched()
    watched.lay_out(chains(3), anew=True)
    for is_anew in (True, False):
        watched.lay_out(chains(4))
        until(qtbot, lambda: watched.layouter.is_idle)
        assert watched.drawings[-1].is_anew is is_anew
    watched.layouter.close()


def test_a_part_beyond_its_budget_is_spread(qtbot, script):
    watched = Watched(script("while true; do true; done"), budget=1)
    watched.lay_out(chains(2))
    until(qtbot, lambda: watched.complaints)
    until(qtbot, lambda: not watched.layouter._running and watched.drawings)
    check_boxes(watched.drawings[-1])
    watched.layouter.close()


PARTS = {
    "c": nodelet("/camera", "info>=/info", "image>=/image"),
    "s": nodelet("/subsampler", ">yuv=/image", "half>=/half", "quarter>=/quarter"),
    "b": nodelet("/body", "pose>=/pose", "joints>=/joints"),
    "d": nodelet("/detector", ">a=/info", ">b=/joints", ">c=/half", ">d=/quarter", "ball>=/ball"),
    "l": nodelet("/localization", ">ball=/ball", ">pose=/pose", "position>=/position"),
}


@pytest.mark.parametrize("are_together", [True, False])
@pytest.mark.parametrize("order", ["csbdl", "bcsdl", "ldscb", "dlbsc"])
def test_what_comes_together_leads_from_left_to_right_and_else_little_moves(
    qtbot, order, are_together
):
    watched, present, before = Watched(), [], Drawing()
    layouter = watched.layouter
    layouter._together.setInterval(1_000_000)  # however long it takes
    for each in order:
        present.append(PARTS[each])
        watched.lay_out(present)
        until(qtbot, lambda: layouter.is_idle)
        drawing = watched.drawings[-1]
        if not are_together:
            layouter._together.timeout.emit()
            assert len(moved(before.layout, drawing.layout)) <= MOST_MOVED
        before = drawing
    if are_together:
        assert backwards(drawing.layout.centres, drawing.figure, drawing.sizes) == 0
    layouter.close()
