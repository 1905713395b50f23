# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Test cases whose sub-tests say why they failed.

rosunit counts a failed sub-test, but loses its text; printed output is kept.
"""

from __future__ import annotations

import contextlib
import traceback
import unittest
from typing import Any, Iterator


class TellingCase(unittest.TestCase):
    """Prints the traceback of a sub-test that fails."""

    @contextlib.contextmanager
    def subTest(self, *args: Any, **kwds: Any) -> Iterator[None]:  # noqa: N802
        with super().subTest(*args, **kwds):
            try:
                yield
            except Exception:
                print(f"{self.id()} {args or ''} {kwds or ''}\n{traceback.format_exc()}")
                raise
