# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Texts of nodelets that leave the process, where they may be of any kind and length."""

from __future__ import annotations

LONGEST = 4096  # characters of the text of an error


def encodable(text: str) -> str:
    """Return a text with ``?`` for what UTF-8 does not have: half of a surrogate pair."""
    return text.encode(errors="replace").decode()


def sendable(text: object) -> str:
    """Return a text, or that of an error, so that messages and answers of services can have it.

    Of a long one it is the beginning.
    """
    words = str(text)
    return encodable(words if len(words) <= LONGEST else f"{words[: LONGEST - 1]}…")
