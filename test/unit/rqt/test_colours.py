# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Colours that everybody can read and tell apart."""

from __future__ import annotations

import math
from itertools import combinations

import pytest
from python_qt_binding.QtGui import QPalette

from dyknow.formulas import Truth
from dyknow_rqt.canvas.appearance import colours_of, greys_of
from dyknow_rqt.screenshots import dark_palette

#: Matrices for linear red, green and blue (Machado, Oliveira and Fernandes 2009, severity 1).
SIGHTS = {
    "all cones": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "no long cones": (
        (0.152286, 1.052583, -0.204868),
        (0.114503, 0.786281, 0.099216),
        (-0.003882, -0.048116, 1.051998),
    ),
    "no medium cones": (
        (0.367322, 0.860646, -0.227968),
        (0.280085, 0.672501, 0.047413),
        (-0.011820, 0.042940, 0.968881),
    ),
    "no short cones": (
        (1.255528, -0.076749, -0.178779),
        (-0.078411, 0.930809, 0.147602),
        (0.004733, 0.691367, 0.303900),
    ),
}
#: Linear red, green and blue as X, Y and Z, and the white of daylight.
_XYZ = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))
_WHITE = (0.95047, 1.0, 1.08883)


def contrast(one, other):
    """The contrast of two colours as web pages are judged, 1 to 21."""
    lights = sorted(_times(_XYZ, _linear(colour))[1] for colour in (one, other))
    return (lights[1] + 0.05) / (lights[0] + 0.05)


def difference(one, other, sight):
    """The distance of two colours in CIE L*a*b*; 2 is just seen."""
    return math.dist(*(_lab(colour, SIGHTS[sight]) for colour in (one, other)))


def _linear(colour):
    return [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4
        for part in colour.getRgbF()[:3]
    ]


def _times(matrix, vector):
    return [sum(a * b for a, b in zip(row, vector)) for row in matrix]


def _lab(colour, sight):
    seen = [min(1.0, max(0.0, part)) for part in _times(sight, _linear(colour))]
    x, y, z = (
        t ** (1 / 3) if t > 0.008856 else 7.787 * t + 16 / 116
        for t in (part / white for part, white in zip(_times(_XYZ, seen), _WHITE))
    )
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


@pytest.fixture(params=[QPalette, dark_palette], ids=["light", "dark"])
def palette(qapp, request):
    return request.param()


@pytest.mark.parametrize("sight", SIGHTS)
def test_highlights_differ_for_everybody(palette, sight):
    colours = colours_of(palette)
    highlights = (colours.self_, colours.in_, colours.out, colours.both, colours.line)
    complaints = (colours.alarm, colours.warning, colours.line)
    verdicts = [colours.of_truth(truth) for truth in Truth]
    for told_apart in (highlights, complaints, verdicts):
        for one, other in combinations(told_apart, 2):
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
