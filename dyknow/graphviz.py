# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Graphviz: its language DOT, and drawing with its program `dot`."""

from __future__ import annotations

import subprocess

from dyknow.errors import DyKnowError


class CannotDraw(DyKnowError):
    """Graphviz is not installed, or failed."""


def quote(*lines: str) -> str:
    """Write a text as a quoted string of DOT; a label may have several lines."""
    text = "\n".join(lines)
    for character, escaped in (("\\", "\\\\"), ('"', '\\"'), ("\n", "\\n")):
        text = text.replace(character, escaped)
    return f'"{text}"'


def render(dot: str, form: str, timeout: float) -> bytes:
    """Draw a graph as `svg` or `png`; 200 nodelets need 15 s. Raises CannotDraw, with a reason."""
    try:
        done = subprocess.run(
            ["dot", f"-T{form}"],
            input=dot.encode("utf-8"),
            capture_output=True,
            timeout=timeout,
            check=False,
        )
    except FileNotFoundError as error:
        raise CannotDraw("graphviz's program 'dot' is not installed; install graphviz") from error
    except subprocess.TimeoutExpired as error:
        raise CannotDraw(f"graphviz needs more than {timeout:g} s") from error
    if done.returncode:
        words = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise CannotDraw(f"graphviz failed: {words[0] if words else done.returncode}")
    return done.stdout
