# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Colours that everybody can read and tell apart."""

from __future__ import annotations

from itertools import combinations

import pytest
from python_qt_binding.QtGui import QPalette
from unit.rqt.seeing import SIGHTS, contrast, difference

from dyknow.formulas import Truth
from dyknow_rqt.canvas.appearance import colours_of, greys_of
from dyknow_rqt.screenshots import dark_palette


@pytest.fixture(params=[QPalette, dark_palette], ids=["light", "dark"])
def palette(qapp, request):
    return request.param()


@pytest.mark.parametrize("sight", SIGHTS)
def test_highlights_differ_for_everybody(palette, sight):
    colours = colours_of(palette)
    told_apart = [colours.self_, colours.in_, colours.out, colours.both, colours.line]
    for one, other in combinations(told_apart, 2):
        assert difference(one, other, sight) > 18, (one.name(), other.name())
    complaints = [colours.alarm, colours.warning, colours.line]
    for one, other in combinations(complaints, 2):
        assert difference(one, other, sight) > 18, (one.name(), other.name())
    verdicts = [colours.of_truth(truth) for truth in Truth]
    for one, other in combinations(verdicts, 2):
        assert difference(one, other, sight) > 18, (one.name(), other.name())


def test_texts_stand_out_from_the_paper(palette):
    colours, greys = colours_of(palette), greys_of(palette)
    texts = ("text", "muted", "alarm", "self_", "in_", "out", "both", "true", "false")
    for drawn in (colours, greys):
        for name in texts:
            assert contrast(getattr(drawn, name), drawn.paper) >= 4.5, name
        assert contrast(drawn.warning, drawn.paper) >= 3.0, "of lines"
        assert contrast(drawn.text, drawn.nodelet) >= 4.5
        assert contrast(drawn.text, drawn.topic) >= 4.5
