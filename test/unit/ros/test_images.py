# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Compressed images, against those of image_transport's own plug-in.

``compressed_images.json`` has images that ``compressed_image_transport`` 1.14 made, in ``republish
raw compressed``, of the pictures that ``picture`` makes here.
"""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest
from rospy.numpy_msg import numpy_msg
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header, String

from dyknow.errors import BadImage, BadParameter
from dyknow.ros.transport.images import codec

ROWS, COLUMNS = 8, 12
CHANNELS = {"rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4, "8UC": 3}
MADE = json.loads((Path(__file__).parent / "compressed_images.json").read_text())


def channels_of(encoding):
    return 1 if encoding.endswith("C1") else CHANNELS.get(re.sub(r"(8|16|3)$", "", encoding), 1)


def picture(encoding, big=0, padding=0):
    channels = channels_of(encoding)
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    values = np.stack([x * 9 + y * 5 + 40 * each for each in range(channels)], -1)
    is_wide = "16" in encoding
    kind = np.dtype(f"{'>' if big else '<'}u{1 + is_wide}")
    pixels = (values * 200 if is_wide else values).astype(kind)
    rows = [row.tobytes() + bytes(padding) for row in pixels]
    image = Image(Header(), ROWS, COLUMNS, encoding, big, len(rows[0]), b"".join(rows))
    image.header.frame_id = "camera"
    return image


def made(kind=Image, image_transport="compressed", **parameters):
    given = {key.replace("_in_", "/"): value for key, value in parameters.items()}
    given["image_transport"] = image_transport
    return codec(kind, given.get)


def values(image):
    return np.frombuffer(image.data, np.uint16 if "16" in image.encoding else np.uint8)


def is_like(image, original):
    """Whether it is the picture; alpha is lost, and JPEG loses a little."""
    channels = channels_of(image.encoding)
    found, wanted = (values(each).astype(int).reshape(-1, channels) for each in (image, original))
    colours = min(channels, 3)
    assert (image.encoding, image.width, image.height) == (original.encoding, COLUMNS, ROWS)
    assert image.step == original.step and image.header == original.header
    assert np.abs(found - wanted)[:, :colours].max() <= 3
    assert channels < 4 or set(found[:, 3]) == {np.iinfo(values(image).dtype).max}


@pytest.mark.parametrize("theirs", MADE, ids=[each["format"].strip() for each in MADE])
def test_theirs_are_decoded_and_ours_are_written_as_theirs(theirs):
    original, data = picture(theirs["encoding"]), base64.b64decode(theirs["data"])
    is_like(made().decode(CompressedImage(original.header, theirs["format"], data)), original)
    codec = made(compressed_in_format=theirs["format"].split()[1])
    ours = codec.encode(original)
    assert ours.format == theirs["format"]
    is_like(codec.decode(ours), original)


@pytest.mark.parametrize("encoding", ["mono16", "rgb16", "mono8", "bgra8"])
def test_padded_rows_and_big_endian_numbers(encoding):
    codec = made(compressed_in_format="png")
    image = codec.decode(codec.encode(picture(encoding, big=1, padding=4)))
    is_like(image, picture(encoding))


@pytest.mark.parametrize("format_", ["jpeg", "", "bgr8; jpeg compressed rgb8"])
def test_what_does_not_name_its_encoding_or_is_in_the_other_order(format_):
    original = picture("bgr8")
    image = made().decode(CompressedImage(Header(), format_, made().encode(original).data))
    found, wanted = (values(each).astype(int).reshape(-1, 3) for each in (image, original))
    order = -1 if "rgb8" in format_ else 1
    assert image.encoding == "bgr8"
    assert np.abs(found - wanted[:, ::order]).max() <= 3


def test_the_quality_is_a_parameter():
    fine, coarse = (made(compressed_in_jpeg_quality=q).encode(picture("rgb8")) for q in (100, 5))
    assert len(fine.data) > len(coarse.data)


def test_messages_with_arrays_of_numpy():
    kind = numpy_msg(Image)
    ours = made(kind)
    image = ours.decode(ours.encode(picture("mono8")))
    image.data = np.frombuffer(image.data, np.uint8)
    assert isinstance(image, kind)
    assert ours.encode(image).format == "mono8; jpeg compressed "


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (picture("mono16"), "mono16: expected 8 bits in JPEG; png has 16"),
        (Image(encoding="32FC1"), "encoding '32FC1': expected mono, rgb"),
        (Image(encoding="mono8"), r"0 × 0 mono8, step 0, with 0 bytes: expected a step"),
        (Image(Header(), 2, 2, "rgb8", 0, 5, bytes(10)), "expected a step of 6 bytes or more"),
        (Image(Header(), 2, 2, "rgb8", 0, 6, bytes(11)), "with 11 bytes: expected"),
    ],
)
def test_images_without_that_form(image, said):
    with pytest.raises(BadImage, match=said):
        made().encode(image)


@pytest.mark.parametrize(
    ("format_", "data", "said"),
    [
        ("rgb8; jpeg compressed bgr8", b"", "expected the data of a picture"),
        ("rgb8; jpeg compressed bgr8", b"no picture at all", "expected the data of a picture"),
        ("mono16; jpeg compressed ", None, "1 channels of 8 bits: expected one of mono16"),
        ("32FC1; compressedDepth png", None, "encoding '32FC1': expected"),
        ("8UC3; jpeg compressed ", None, "1 channels of 8 bits: expected one of 8UC3"),
    ],
)
def test_data_that_is_no_such_image(format_, data, said):
    if data is None:
        data = made().encode(picture("mono8")).data
    with pytest.raises(BadImage, match=said):
        made().decode(CompressedImage(Header(), format_, data))


def test_ports_of_other_types_and_raw_ones_have_none():
    asked = []
    assert codec(String, lambda key, default: asked.append(key)) is None
    assert asked == []
    assert made(image_transport="raw") is None


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"image_transport": "theora"}, "'image_transport' is 'theora': expected 'raw' or 'com"),
        ({"compressed_in_format": "gif"}, "'compressed/format' is 'gif': expected 'jpeg' or 'p"),
        ({"compressed_in_jpeg_quality": 101}, "is 101: expected a whole number from 1 to 100"),
        ({"compressed_in_png_level": 2.5}, "'compressed/png_level' is 2.5: expected a whole num"),
        ({"compressed_in_jpeg_optimize": 1}, "is 1: expected true or false"),
    ],
)
def test_wrong_parameters(parameters, said):
    with pytest.raises(BadParameter, match=said):
        made(**parameters)
