# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Images in the form of image_transport's plug-in ``compressed``: JPEG or PNG.

The names of parameters, their defaults, and the texts in ``CompressedImage.format`` are those of
``compressed_image_transport`` for Noetic, so that its publishers and subscribers understand ours:
``rgb8; jpeg compressed bgr8`` is an image that was ``rgb8``, and whose pixels are ``bgr8`` in the
JPEG file. OpenCV and numpy are imported when the first port needs them, not before.
"""

from __future__ import annotations

import re
import sys
from typing import Any, Mapping, Tuple

from dyknow.errors import BadImage, BadParameter
from dyknow.nodelet.middleware import Codec, Parameter

IMAGE = "sensor_msgs/Image"
RAW, COMPRESSED = "raw", "compressed"
FORMATS = ("jpeg", "png")
#: Whole numbers among the parameters below ``compressed/``: default, least, most.
_NUMBERS: Mapping[str, Tuple[int, int, int]] = {
    "jpeg_quality": (80, 1, 100),
    "jpeg_restart_interval": (0, 0, 65535),
    "png_level": (9, 1, 9),
}
_SWITCHES = ("jpeg_progressive", "jpeg_optimize")

#: Encodings of pixels that both formats can hold: the channels, and the bits of each.
_COLOUR = re.compile(r"(rgb|bgr|rgba|bgra)(8|16)\Z")
_PLAIN = re.compile(r"(?:mono|bayer_[rgb]{4})(8|16)\Z|(8|16)UC([13])\Z")
_HOLDABLE = "mono, rgb, bgr, rgba, bgra or bayer with 8 or 16, or 8UC1, 8UC3, 16UC1, 16UC3"
#: Colours of a picture, as OpenCV reads it, by the number of its channels.
_COLOURS = {1: "mono", 3: "bgr", 4: "bgra"}


def codec(datatype: Any, parameter: Parameter) -> Codec | None:
    """Return the codec of a port's images, as its parameters say.

    Args:
        datatype: class of the port's messages; None is returned unless it is that of images.
        parameter: returns a parameter of the port.

    Raises:
        BadParameter: ``image_transport`` or a parameter below ``compressed`` has no such value.
    """
    if datatype._type != IMAGE:
        return None
    transport = parameter("image_transport", RAW)
    if transport == RAW:
        return None
    if transport != COMPRESSED:
        raise BadParameter("image_transport", transport, f"'{RAW}' or '{COMPRESSED}'")
    images = _Images(datatype, parameter)
    return Codec(COMPRESSED, images.compressed_class, images.encode, images.decode)


class _Images:
    """Encodes as the parameters of one port say, and decodes any picture."""

    def __init__(self, datatype: Any, parameter: Parameter) -> None:
        try:
            import cv2
            import numpy as np
            from sensor_msgs.msg import CompressedImage
        except ImportError as error:
            needed = f"'{RAW}', as OpenCV, numpy and sensor_msgs are not all here ({error})"
            raise BadParameter("image_transport", COMPRESSED, needed) from error
        self.compressed_class = CompressedImage
        self._datatype = datatype
        self._cv2, self._np = cv2, np
        prefix = f"{COMPRESSED}/"
        self._format = parameter(prefix + "format", FORMATS[0])
        if self._format not in FORMATS:
            raise BadParameter(prefix + "format", self._format, " or ".join(map(repr, FORMATS)))
        given = {}
        for name, (default, least, most) in _NUMBERS.items():
            given[name] = value = parameter(prefix + name, default)
            if type(value) is not int or not least <= value <= most:
                expected = f"a whole number from {least} to {most}"
                raise BadParameter(prefix + name, value, expected)
        for name in _SWITCHES:
            given[name] = value = parameter(prefix + name, False)
            if type(value) is not bool:
                raise BadParameter(prefix + name, value, "true or false")
        if self._format == "jpeg":
            self._suffix = ".jpg"
            self._options = [
                *(cv2.IMWRITE_JPEG_QUALITY, given["jpeg_quality"]),
                *(cv2.IMWRITE_JPEG_PROGRESSIVE, int(given["jpeg_progressive"])),
                *(cv2.IMWRITE_JPEG_OPTIMIZE, int(given["jpeg_optimize"])),
                *(cv2.IMWRITE_JPEG_RST_INTERVAL, given["jpeg_restart_interval"]),
            ]
        else:
            self._suffix = ".png"
            self._options = [cv2.IMWRITE_PNG_COMPRESSION, given["png_level"]]

    def encode(self, image: Any) -> Any:
        """Compress a ``sensor_msgs/Image`` to a ``sensor_msgs/CompressedImage``.

        Raises:
            BadImage: neither the encoding nor the sizes are those of an image that has this form.
        """
        colours, channels, bits = _layout(image.encoding)
        if self._format == "jpeg" and bits != 8:
            raise BadImage(f"an image of {image.encoding}", "8 bits in JPEG; png has 16")
        pixels = self._pixels(image, channels, bits)
        stored = ""
        if colours:
            stored = f"bgr{bits}"
            pixels = self._recoloured(pixels, colours, "bgr")
        is_written, data = self._cv2.imencode(self._suffix, pixels, self._options)
        if not is_written:
            what = f"an image of {image.encoding}"
            raise BadImage(what, f"one that OpenCV writes as {self._format}")
        form = f"{image.encoding}; {self._format} compressed {stored}"
        return self.compressed_class(image.header, form, data.tobytes())

    def decode(self, compressed: Any) -> Any:
        """Return the image that a ``sensor_msgs/CompressedImage`` holds, in its first encoding.

        One that does not say which encoding it had becomes ``mono8``, ``bgr8``, ``bgra8``, or the
        same with 16 bits.

        Raises:
            BadImage: the data is no picture, or one of another kind than ``format`` says.
        """
        what = f"a compressed image of format '{compressed.format}'"
        data = self._np.frombuffer(compressed.data, self._np.uint8)
        try:
            pixels = self._cv2.imdecode(data, self._cv2.IMREAD_UNCHANGED) if data.size else None
        except self._cv2.error:
            pixels = None
        if pixels is None:
            raise BadImage(what, "the data of a picture that OpenCV reads, such as JPEG or PNG")
        bits = 8 * pixels.itemsize
        found = 1 if pixels.ndim == 2 else pixels.shape[2]
        encoding, is_named, stored = compressed.format.partition(";")
        present = _COLOURS[found]
        if not is_named:
            encoding = f"{present}{bits}"
        colours, channels, wanted = _layout(encoding)
        if wanted != bits or (not colours and channels != found):
            raise BadImage(f"{what} with {found} channels of {bits} bits", f"one of {encoding}")
        if colours:
            if found == 3 and "compressed rgb" in stored:
                present = "rgb"
            pixels = self._recoloured(pixels, present, colours)
        return self._message(compressed, encoding, pixels)

    def _message(self, compressed: Any, encoding: str, pixels: Any) -> Any:
        from sensor_msgs.msg import Image

        from dyknow.ros.transport.conversions import copy_of

        height, width = pixels.shape[:2]
        image = Image(
            compressed.header,
            height,
            width,
            encoding,
            int(sys.byteorder == "big"),
            pixels.nbytes // height,
            pixels.tobytes(),
        )
        header = getattr(compressed, "_connection_header", None)
        if header is not None:
            image._connection_header = header
        return image if self._datatype is Image else copy_of(image, self._datatype)

    def _pixels(self, image: Any, channels: int, bits: int) -> Any:
        """View an image as an array of rows, columns and channels."""
        np = self._np
        kind = np.dtype(f"{'>' if image.is_bigendian else '<'}u{bits // 8}")
        row = image.width * channels * kind.itemsize
        data = np.frombuffer(image.data, np.uint8)
        if not row <= image.step or not data.size or data.size != image.height * image.step:
            size = f"{image.width} × {image.height} {image.encoding}"
            raise BadImage(
                f"an image of {size}, step {image.step}, with {data.size} bytes",
                f"a step of {row} bytes or more, and as many bytes as rows of it",
            )
        rows = np.ascontiguousarray(data.reshape(image.height, image.step)[:, :row]).view(kind)
        pixels = rows.reshape(image.height, image.width, channels)
        return pixels.astype(kind.newbyteorder("="), copy=False)

    def _recoloured(self, pixels: Any, present: str, wanted: str) -> Any:
        if present == wanted:
            return pixels
        if present == "mono":
            present = "gray"
        code = getattr(self._cv2, f"COLOR_{present.upper()}2{wanted.upper()}")
        return self._cv2.cvtColor(pixels, code)


def _layout(encoding: str) -> tuple[str, int, int]:
    """Return the colours of an encoding (empty: none), its channels, and the bits of each."""
    colour, plain = _COLOUR.match(encoding), _PLAIN.match(encoding)
    if colour is not None:
        return colour.group(1), len(colour.group(1)), int(colour.group(2))
    if plain is not None:
        return "", int(plain.group(3) or 1), int(plain.group(1) or plain.group(2))
    raise BadImage(f"an image of encoding '{encoding}'", _HOLDABLE)
