# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The subsampler makes the images that have subscribers, and no others."""

from __future__ import annotations

from dyknow.proxy.proxy import NodeletProxy
from dyknow.testing import NodeletHarness
from dyknow_demo import images
from dyknow_demo.images import planes_of
from dyknow_demo.soccer.nodelets import ImageSubsampler

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
        assert (quarter.encoding, planes_of(quarter).shape) == ("mono8", (3, 120, 160))
        statistics = NodeletProxy.of(subsampler.context).get_statistics()
        sent = {each.port: (each.messages, each.dropped) for each in statistics.ports}
        assert (sent["yuv_half"], sent["yuv_eighth"]) == ((0, 0), (0, 0))
