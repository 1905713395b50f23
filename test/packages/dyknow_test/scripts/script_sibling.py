# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A module beside scripts; its annotations are texts, which Python looks up in its module."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Word:
    text: str
    number: int

    def __str__(self) -> str:
        return f"{self.text} {self.number}"
