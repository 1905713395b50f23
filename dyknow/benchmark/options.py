"""Types of command line options that several measurements use."""

from __future__ import annotations

import argparse


def positive(text: str) -> int:
    """Read an integer from 1 on."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a number from 1 on, not {text}")
    return value
