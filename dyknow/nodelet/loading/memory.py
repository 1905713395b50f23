# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Memory of nodelets that come and go: frees an object that only itself holds, returns the heap.

The functions for the heap of the C library do nothing where that is not the GNU library.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import sys
import traceback
import types
import weakref
from typing import Any

_M_ARENA_MAX = -8
_MOST = 20_000  # objects that are examined to free one; with more it is left to Python
#: Types that are not looked into: they refer to shared objects, or to running code.
_OPAQUE: tuple[type[Any], ...] = (
    type,
    types.ModuleType,
    types.CodeType,
    types.FrameType,
    types.TracebackType,
    types.GeneratorType,
    types.CoroutineType,
)


def use_one_heap() -> None:
    """Have all threads share one heap of the C library; call it before threads start.

    Else each thread may get a heap of its own, whose free memory stays with the process. With one
    heap all of it can be returned at any time, and threads hardly contend for it, since most wait
    for the interpreter's lock anyway.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def return_free_memory() -> None:
    """Return free memory to the system; other threads run meanwhile."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def break_cycles(
    reference: weakref.ReferenceType[Any], opaque: tuple[type[Any], ...] = ()
) -> bool:
    """Empty an object if only reference cycles through itself hold it; returns whether it is gone.

    A nodelet that passed one of its methods to an object of a library that it keeps is part of a
    reference cycle. Python frees it with its next full collection. That comes after a number of
    new objects, whatever their size, so a few nodelets with large buffers fill the memory first;
    and a collection on request would stop every other nodelet for some 0.1 s. So one object is
    examined as the collector examines all: does every reference to it come from an object that it
    reaches itself? An object with a finalizer is left to Python, which calls that first.

    ``opaque`` are further types that are not looked into: they do not refer to the object.
    """
    found = [reference()]
    if found[0] is None:
        return True
    if not hasattr(type(found[0]), "__del__") and _is_garbage(found, (*_OPAQUE, *opaque)):
        vars(found[0]).clear()
    found.clear()
    return reference() is None


def clear_frames(error: BaseException) -> None:
    """Empty the frames that an exception came through, and those of its causes.

    An exception that is kept would keep all their variables; its traceback stays readable.
    """
    waiting: list[BaseException | None] = [error]
    seen: set[int] = set()
    while waiting:
        each = waiting.pop()
        if each is not None and id(each) not in seen:
            seen.add(id(each))
            traceback.clear_frames(each.__traceback__)
            waiting += [each.__cause__, each.__context__]


def _is_garbage(found: list[Any], opaque: tuple[type[Any], ...]) -> bool:
    """Whether only its own referents, which are added, hold the one object in ``found``."""
    places = {id(found[0]): 0}
    edges: list[list[int]] = []
    held: dict[int, int] = {}
    for each in found:  # which grows
        inner: list[int] = []
        for other in _referents(each, opaque):
            if not gc.is_tracked(other):
                continue
            place = places.setdefault(id(other), len(found))
            if place == len(found):
                if place >= _MOST:
                    return False
                found.append(other)
            inner.append(place)
            held[place] = held.get(place, 0) + 1
        edges.append(inner)
    each = other = None
    found.append(object())  # refers to nothing, and nothing here to it
    own = sys.getrefcount(found[-1])
    found.pop()
    waiting = [
        place
        for place in range(len(found))
        if sys.getrefcount(found[place]) - held.get(place, 0) > own
    ]
    alive = set(waiting)
    while waiting:
        for place in edges[waiting.pop()]:
            if place not in alive:
                alive.add(place)
                waiting.append(place)
    return 0 not in alive


def _referents(each: Any, opaque: tuple[type[Any], ...]) -> list[Any]:
    if isinstance(each, types.FunctionType):
        return [part for part in (each.__closure__, each.__defaults__) if part is not None]
    return [] if isinstance(each, opaque) else gc.get_referents(each)
