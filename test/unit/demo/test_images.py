# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Images as arrays."""

from __future__ import annotations

import io

import numpy as np
import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from dyknow_demo import images


@pytest.mark.parametrize(
    ("encoding", "shape"), [("bgr8", (4, 6, 3)), ("mono8", (4, 6)), ("yuv422", (4, 6, 2))]
)
def test_pixels_survive_the_way_to_another_process(encoding, shape):
    pixels = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    sent, wire = images.blank(Header(), shape[0], shape[1], encoding), io.BytesIO()
    images.array_of(sent)[...] = pixels
    sent.serialize(wire)
    assert np.array_equal(images.array_of(Image().deserialize(wire.getvalue())), pixels)


@pytest.mark.parametrize(("encoding", "channels"), [("bgr8", 3), ("mono8", 1)])
def test_padded_rows_are_cut_off_without_a_copy(encoding, channels):
    step = 6 * channels + 5
    image = Image(Header(), 4, 6, encoding, 0, step, bytearray(range(4 * step)))
    pixels = images.array_of(image)
    assert pixels.shape[:2] == (4, 6)
    assert pixels[2].ravel()[0] == 2 * step
    assert np.shares_memory(pixels, np.frombuffer(image.data, np.uint8))


def test_an_unknown_encoding_and_data_that_do_not_fill_the_image_are_refused():
    with pytest.raises(ValueError, match="encoding 'bayer_rggb8': expected one of 8UC1"):
        images.array_of(Image(encoding="bayer_rggb8"))
    with pytest.raises(ValueError, match="buffer"):
        images.array_of(Image(Header(), 4, 6, "bgr8", 0, 18, b"short"))
