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

from dyknow.locks import state_lock

#: Held to enable the collector, and while it must not be enabled.
enabling = state_lock("collector of garbage")


@contextlib.contextmanager
def without_collection() -> Iterator[None]:
    """Collect no garbage meanwhile, in all threads.

    Of sections that overlap the first that ends enables the collector: it has its turn however
    many threads are in one. Objects without cycles are freed at once, as ever.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        with enabling:
            gc.enable()
