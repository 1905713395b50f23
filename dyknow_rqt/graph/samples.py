# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages reduced to a form that a person can read: a bounded text, numbers, a small image."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any, Iterator, Mapping, NamedTuple, Sequence

import numpy

#: The most lines of a text, elements of an array and characters of a word.
MOST_LINES, _MOST_ELEMENTS, _MOST_LETTERS = 60, 12, 120
#: Numbers that are offered for a curve.
_MOST_NUMBERS = 60
#: The largest small image, in pixels.
WIDEST, HIGHEST = 240, 160
#: Bytes of a pixel, and where its red, green and blue are.
_COLOURS = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)),
    "8UC4": (4, (2, 1, 0)),
    "yuv422": (2, (1, 1, 1)),
    "yuv422_yuy2": (2, (0, 0, 0)),
}
#: Encodings of other pixels, with their bits and kind of number: mono8, bayer_rggb16, 32FC1.
_GREYS = re.compile(r"(?:mono|bayer_[a-z]{4})?(8|16|32|64)(?:([USF])C\d*)?\Z")
_KINDS = {None: "u", "U": "u", "S": "i", "F": "f"}


class SmallImage(NamedTuple):
    """An image of at most ``WIDEST`` times ``HIGHEST`` pixels, with its full size and encoding.

    The data are red, green and blue of each pixel, from the top left; or if the width is 0 a
    compressed image, such as a JPEG.
    """

    width: int
    height: int
    data: bytes
    note: str


@dataclass(frozen=True)
class Sample:
    """One message, for people: as ``rostopic echo`` writes it, long parts cut.

    Numbers are by the paths of the fields; the size is in bytes.
    """

    text: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    image: SmallImage | None = None
    size: int = 0


def sample_of(message: Any, size: int) -> Sample:
    """Reduce a message of ROS; it has ``size`` bytes."""
    lines: list[str] = []
    for line in _lines(message, ""):
        if len(lines) == MOST_LINES:
            lines.append("…")
            break
        lines.append(line)
    numbers: dict[str, float] = {}
    for path, number in _numbers(message, ""):
        if len(numbers) == _MOST_NUMBERS:
            break
        numbers[path] = number
    return Sample("\n".join(lines), numbers, _image(message), size)


def _fields(value: Any) -> Sequence[str]:
    return getattr(value, "__slots__", ())


def _is_time(value: Any) -> bool:
    return hasattr(value, "to_sec")


def _lines(value: Any, indent: str) -> Iterator[str]:
    """Write the fields of a message, one a line, those of its parts indented."""
    for name in _fields(value):
        part = getattr(value, name)
        if isinstance(part, (list, tuple)) and part and _fields(part[0]) and not _is_time(part[0]):
            yield f"{indent}{name}: {len(part)} of them"
            for each in part[:_MOST_ELEMENTS]:
                first, *rest = _lines(each, "")
                yield f"{indent}- {first}"
                yield from (f"{indent}  {line}" for line in rest)
        elif _fields(part) and not _is_time(part):
            yield f"{indent}{name}:"
            yield from _lines(part, indent + "  ")
        else:
            yield f"{indent}{name}: {_word(part)}"


def _word(value: Any) -> str:
    if _is_time(value):
        return f"{value.to_sec():.6f}"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (bytes, bytearray)):
        more = f", … ({len(value)} bytes)" if len(value) > _MOST_ELEMENTS else ""
        return f"[{', '.join(str(byte) for byte in value[:_MOST_ELEMENTS])}{more}]"
    if isinstance(value, str):
        return value if len(value) <= _MOST_LETTERS else value[:_MOST_LETTERS] + "…"
    if hasattr(value, "__len__"):
        more = f", … ({len(value)})" if len(value) > _MOST_ELEMENTS else ""
        return f"[{', '.join(_word(each) for each in value[:_MOST_ELEMENTS])}{more}]"
    return str(value)


def _numbers(value: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, (bool, int, float, numpy.number)):
        if math.isfinite(value):
            yield path, float(value)
    elif _is_time(value):
        yield path, value.to_sec()
    elif isinstance(value, (list, tuple, numpy.ndarray)):
        for number, each in enumerate(value[:_MOST_ELEMENTS]):
            yield from _numbers(each, f"{path}[{number}]")
    else:
        for name in _fields(value):
            if name != "header":
                yield from _numbers(getattr(value, name), f"{path}.{name}" if path else name)


def _image(message: Any) -> SmallImage | None:
    kind = getattr(message, "_type", "")
    if kind == "sensor_msgs/CompressedImage":
        return SmallImage(0, 0, bytes(message.data), message.format)
    if kind != "sensor_msgs/Image" or not (message.width and message.height):
        return None
    note = f"{message.width} × {message.height} {message.encoding}"
    pixels = _pixels(message)
    if pixels is None:
        return SmallImage(0, 0, b"", f"{note} cannot be shown")
    height, width = pixels.shape[:2]
    return SmallImage(width, height, pixels.tobytes(), note)


def _pixels(message: Any) -> Any | None:
    """Every n-th pixel of an image as red, green and blue; None if it cannot be read."""
    step = max(-(-message.width // WIDEST), -(-message.height // HIGHEST), 1)
    encoding = message.encoding
    size, places = _COLOURS.get(encoding, (0, (0, 0, 0)))
    greys = _GREYS.match(encoding)
    try:
        rows = numpy.frombuffer(message.data, numpy.uint8).reshape(message.height, message.step)
        if size:
            rows = rows[:, : message.width * size].reshape(message.height, message.width, size)
            return rows[::step, ::step][:, :, places]
        if greys is None:
            return None
        bytes_each, order = int(greys[1]) // 8, ">" if message.is_bigendian else "<"
        kind = numpy.dtype(f"{order}{_KINDS[greys[2]]}{bytes_each}")
        channels = message.step // message.width // bytes_each
        rows = rows[:, : message.width * channels * bytes_each]
        grey = numpy.ascontiguousarray(rows).view(kind)[::step, :: step * channels]
        if kind != numpy.uint8:
            grey = _stretched(grey)
        return numpy.repeat(grey[:, :, None], 3, axis=2)
    except (TypeError, ValueError, ZeroDivisionError):
        return None


def _stretched(values: Any) -> Any:
    """Spread values over 256 greys, NaN and infinities black."""
    values = values.astype(float)
    known = values[numpy.isfinite(values)]
    low, high = (known.min(), known.max()) if known.size else (0.0, 1.0)
    grey = (values - low) / ((high - low) or 1.0) * 255
    return numpy.nan_to_num(grey, nan=0.0, posinf=0.0, neginf=0.0).astype(numpy.uint8)
