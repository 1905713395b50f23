# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Types of command line options that several measurements use."""

from __future__ import annotations

import argparse

from dyknow_benchmark.parts import payload_of


def positive(text: str) -> int:
    """Read an integer from 1 on."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a number from 1 on, not {text}")
    return value


def rate(text: str) -> float:
    """Read a frequency in Hz."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number above 0, not {text}")
    return value


def size(text: str) -> str:
    """Read the size of an image, such as 640x480."""
    if text == "time":
        raise argparse.ArgumentTypeError("expected a size such as 640x480, not time")
    return payload(text)


def payload(text: str) -> str:
    """Read what a chain carries: ``time``, or a size of images."""
    try:
        payload_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text
