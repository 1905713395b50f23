# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The actions on nodelets that the manager refuses, so that the window does not offer them."""

from __future__ import annotations

from typing import List, Sequence, Tuple

from dyknow_rqt.graph.snapshot import Snapshot


def not_ours(names: Sequence[str], snapshot: Snapshot) -> str:
    """Why the manager does not end or restart some nodelets, in words; empty if it does."""
    found = (snapshot.nodelet(name) for name in names)
    whose = [(each.name, each.owner) for each in found if each is not None and each.owner]
    return "\n".join(f"{name} was loaded by {owner}: end it there" for name, owner in whose)


def not_destroyed(names: Sequence[str], snapshot: Snapshot) -> str:
    """Why some nodelets cannot be destroyed, in words; empty if all can."""
    found = (snapshot.nodelet(name) for name in names)
    is_held = any(each is not None and each.is_protected for each in found)
    return not_ours(names, snapshot) or ("Release them from protection first" if is_held else "")


def protection(names: Sequence[str], snapshot: Snapshot) -> Tuple[List[str], bool]:
    """Decide how a switch of the protection of nodelets works.

    Returns:
        The nodelets to protect, those that are not yet; or if all are, all of them, to release.
    """
    nodelets = (snapshot.nodelet(name) for name in names)
    free = [each.name for each in nodelets if each is not None and not each.is_protected]
    return (free, True) if free or not names else (list(names), False)
