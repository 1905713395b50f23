# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sections in which Python does not collect garbage.

Its collector of reference cycles looks at the new objects again and again, and at all objects
whenever a quarter of them is new. With 50,000 transformations each of these looks stops all
threads for 0.2 s, and together they take a fifth of the time of a plan.
"""

from __future__ import annotations

import contextlib
import gc
from typing import Iterator


@contextlib.contextmanager
def without_collection() -> Iterator[None]:
    """Collect no garbage meanwhile, in all threads, as there is no threshold for it.

    Of sections that overlap the first that ends gives it back: the collector has its turn however
    many threads are in one. Objects without cycles are freed at once, as ever.
    """
    thresholds = gc.get_threshold()
    if not thresholds[0]:
        yield
        return
    gc.set_threshold(0)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)
