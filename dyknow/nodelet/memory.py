# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The heap of the C library, for processes from which large nodelets come and go.

By default each thread may get a heap of its own, up to eight for each core. What is free at its
end stays with the process, some 40 MB once a block of 20 MB was freed, and nothing but
the next free in the same heap returns it. With one heap all of it can be returned at any time.
Threads hardly contend for it, since most of them wait for the interpreter's lock anyway.
"""

from __future__ import annotations

import contextlib
import ctypes

_M_ARENA_MAX = -8


def use_one_heap() -> None:
    """Have all threads share one heap; call it before threads start. Needs the GNU library."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def return_free_memory() -> None:
    """Return what is free to the system; other threads run meanwhile. Needs the GNU library."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
