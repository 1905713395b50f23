# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""From planes to a place on the floor: each step alone."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from dyknow.proxy.proxy import NodeletProxy
from dyknow.testing import NodeletHarness
from dyknow_demo import images
from dyknow_demo.images import pyramid
from dyknow_demo.soccer.finder import ORANGE, YELLOW, Find, find_balls
from dyknow_demo.soccer.geometry import BOTTOM_CAMERA, apply, floor_from_camera, inverse
from dyknow_demo.soccer.nodelets import ImageSubsampler
from dyknow_demo.soccer.rendering import draw_ball, pack, yuv_from_bgr
from dyknow_demo.soccer.sighting import Geometry, History, best_sighting, sight

GRASS, ORANGE_BGR, YELLOW_BGR = (60, 120, 50), (20, 105, 245), (40, 210, 230)
CIRCLE = np.linspace(0, 2 * math.pi, 60, endpoint=False)


def planes_of(bgr, factors=(2, 4)):
    packed = np.empty((*bgr.shape[:2], 2), np.uint8)
    pack(yuv_from_bgr(bgr), packed)
    return pyramid(packed, factors)


def grass(height=480, width=640):
    return np.full((height, width, 3), GRASS, np.uint8)


# Finder


@pytest.mark.parametrize(
    ("centre", "radius", "is_whole"),
    [*(((300, 200), radius, True) for radius in (4, 9, 25, 80)), ((636, 240), 40, False)],
)
def test_a_disc_is_found_where_it_is_also_half_out_of_the_image(centre, radius, is_whole):
    image = grass()
    cv2.circle(image, centre, radius, ORANGE_BGR, -1)
    (find,) = find_balls(planes_of(image), ORANGE)
    assert find.centre == pytest.approx(centre, abs=1.0 if is_whole else 2.0)
    assert find.radius == pytest.approx(radius, abs=2.0)
    assert find.score > 0.8 or not is_whole


def test_what_is_not_round_or_not_of_the_colour_is_none():
    image = grass()
    cv2.rectangle(image, (50, 50), (250, 90), ORANGE_BGR, -1)
    cv2.circle(image, (400, 300), 30, (240, 240, 240), -1)
    cv2.circle(image, (500, 100), 30, YELLOW_BGR, -1)
    assert find_balls(planes_of(image), ORANGE) == []
    (yellow,) = find_balls(planes_of(image), YELLOW)
    assert yellow.centre == pytest.approx((500, 100), abs=1.0)


def test_nothing_but_noise():
    image = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)
    find_balls(planes_of(image), ORANGE)
    assert find_balls(planes_of(grass()), ORANGE) == []
    everywhere = np.full((480, 640, 3), ORANGE_BGR, np.uint8)
    assert find_balls(planes_of(everywhere), ORANGE) == []


# Sightings


def geometry(pitch=0.6, height=0.45, radius=0.0325, factor=2, camera=BOTTOM_CAMERA):
    return Geometry(camera, floor_from_camera(height, pitch), radius, factor)


def find_at(position, known):
    """The outline of a ball on the floor, without an image."""
    centre = apply(inverse(known.owner_from_camera), np.asarray(position))
    distance = np.linalg.norm(centre)
    axis = centre / distance
    side = np.cross(axis, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    angle = math.asin(known.ball_radius / distance)
    half_pixel = 0.5 * known.factor / known.camera.fx  # outlines run through pixels' centres
    rim = np.outer(np.cos(CIRCLE), side) + np.outer(np.sin(CIRCLE), up)
    rays = axis + math.tan(angle - half_pixel) * rim
    outline = known.camera.project(rays)
    return Find((0.0, 0.0), 0.0, (0.0, 0.0, 0.0, 0.0), outline, 1.0)


@pytest.mark.parametrize("position", [(0.3, 0.0), (0.8, 0.2), (1.5, -0.6), (2.5, 0.5)])
def test_a_ball_on_the_floor_is_located(position):
    known = geometry()
    sighting = sight(find_at((*position, known.ball_radius), known), known)
    assert sighting.position == pytest.approx([*position, known.ball_radius], abs=1e-6)
    assert np.all(np.linalg.eigvalsh(sighting.covariance) > -1e-12)


def test_the_uncertainty_is_the_geometrys():
    known = geometry()
    position = np.array([1.2, 0.0, known.ball_radius])
    covariance = sight(find_at(position, known), known).covariance
    error = math.hypot(math.radians(0.3), 0.25 * 2 / BOTTOM_CAMERA.fx)
    height = 0.45 - known.ball_radius
    along = (1.2**2 + height**2) / height * error
    across = math.hypot(1.2, height) * error
    assert math.sqrt(covariance[0, 0]) == pytest.approx(along, rel=1e-3)
    assert math.sqrt(covariance[1, 1]) == pytest.approx(across, rel=1e-3)
    assert covariance[2] == pytest.approx([0, 0, 0], abs=1e-12)


def test_what_cannot_be_a_ball_on_the_floor_is_passed_over():
    known = geometry()
    ball = (1.0, 0.0, known.ball_radius)
    doubled = find_at(ball, geometry(radius=2 * known.ball_radius))
    above = find_at((3.0, 0.0, 1.2), known)
    assert sight(doubled, known) is None
    assert sight(above, known) is None
    good = find_at(ball, known)
    best = best_sighting([above, doubled, good], known)
    assert best.position == pytest.approx(ball)
    assert best_sighting([], known) is None


@pytest.mark.parametrize("x", [0.35, 0.7, 1.4])
def test_a_drawn_ball_is_located_to_a_fraction_of_a_pixel(x):
    known = geometry()
    position = np.array([x, 0.1, known.ball_radius])
    picture = yuv_from_bgr(grass())
    to_camera = inverse(known.owner_from_camera)
    orange = tuple(yuv_from_bgr(np.array([[ORANGE_BGR]], np.uint8))[0, 0].tolist())
    radius = known.ball_radius
    draw_ball(picture, BOTTOM_CAMERA, apply(to_camera, position), radius, orange, to_camera[:3, 2])
    packed = np.empty((480, 640, 2), np.uint8)
    pack(picture, packed)
    found = best_sighting(find_balls(pyramid(packed, (2, 4)), ORANGE), known)
    height = 0.45 - radius
    half_a_pixel = (x**2 + height**2) / height / BOTTOM_CAMERA.fx  # of the planes
    assert np.hypot(*(found.position - position)[:2]) < half_a_pixel


# Signals


def test_history_interpolates_and_reaches_a_little_beyond():
    history = History([False, True])
    assert history.at(0.0) is None
    history.add(1.0, (2.0, 3.1))
    assert history.at(1.05) == (2.0, 3.1)
    history.add(1.2, (4.0, -3.1))  # the short way round, past pi
    middle = history.at(1.1)
    assert middle is not None
    assert middle[0] == pytest.approx(3.0)
    assert abs(middle[1]) == pytest.approx(math.pi)
    later, earlier = history.at(1.25), history.at(0.95)
    assert later is not None and earlier is not None
    assert (later[0], earlier[0]) == pytest.approx((4.5, 1.5))
    assert history.at(1.5) is None
    assert history.at(0.8) is None


def test_time_that_jumps_back_starts_anew():
    history = History([False])
    history.add(10.0, (1.0,))
    history.add(2.0, (5.0,))
    assert history.at(10.0) is None
    assert history.at(2.0) == (5.0,)


PORTS = ("bgr", "hsv", "yuv_half", "yuv_quarter", "yuv_eighth")


def test_it_makes_what_is_listened_to():
    with NodeletHarness() as harness:
        ports = {"yuv": "/image", **{port: f"/{port}" for port in PORTS}}
        subsampler = harness.load(ImageSubsampler, ports=ports)
        made = {port: harness.listen(f"/{port}") for port in ("bgr", "hsv", "yuv_quarter")}
        image = images.blank(None, 480, 640, "yuv422")
        images.array_of(image)[...] = 128
        harness.publish("/image", image)
        harness.drain()
        assert [(m.encoding, m.width, m.height) for m in made["bgr"]] == [("bgr8", 640, 480)]
        assert [(m.encoding, m.width, m.height) for m in made["hsv"]] == [("8UC3", 640, 480)]
        (quarter,) = made["yuv_quarter"]
        assert (quarter.encoding, images.planes_of(quarter).shape) == ("mono8", (3, 120, 160))
        statistics = NodeletProxy.of(subsampler.context).get_statistics()
        sent = {each.port: (each.messages, each.dropped) for each in statistics.ports}
        assert (sent["yuv_half"], sent["yuv_eighth"]) == ((0, 0), (0, 0))
