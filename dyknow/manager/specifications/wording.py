"""How messages quote what they found: long texts and long lists are cut to what can be read."""

from __future__ import annotations

from typing import Collection, Iterable

from dyknow.similar import did_you_mean

_TEXT = 60
_NAMES = 20
_FEW = 100


def shorten(text: str) -> str:
    """Cut a text to what a message can carry."""
    return text if len(text) <= _TEXT else text[:_TEXT] + "…"


def listed(names: Iterable[str]) -> str:
    """Sort names and write them in a row; `none` if there is none."""
    known = sorted(names)
    more = f" and {len(known) - _NAMES} more" if len(known) > _NAMES else ""
    return (", ".join(shorten(name) for name in known[:_NAMES]) or "none") + more


def meant(name: str, known: Collection[str]) -> str:
    """Suggest what may have been meant; not among so many that a program has written them."""
    return did_you_mean(name, known) if len(known) <= _FEW else ""
