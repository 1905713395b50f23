# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The changes that can be undone and redone."""

from __future__ import annotations

from typing import List, Optional, Tuple

from dyknow_rqt.graph.changes import Change, DoneChange

#: The most changes that can be undone.
DEPTH = 100


class UndoHistory:
    """Two stacks: changes to undo and changes to redo."""

    def __init__(self) -> None:
        self._done: List[DoneChange] = []
        self._undone: List[Change] = []

    def note(self, done: DoneChange) -> None:
        """Note a change; nothing can be redone after it."""
        self._done.append(done)
        del self._done[:-DEPTH]
        self._undone.clear()

    def note_undone(self) -> None:
        """Note that the last change was undone."""
        self._undone.append(self._done.pop().change)

    def note_redone(self, done: DoneChange) -> None:
        """Note that the last undone change was redone."""
        self._undone.pop()
        self._done.append(done)

    def drop(self) -> None:
        """Forget the last change, which cannot be undone, so that those before it can be."""
        self._done.pop()

    @property
    def last(self) -> Optional[DoneChange]:
        """The change that undo undoes, or None."""
        return self._done[-1] if self._done else None

    @property
    def next(self) -> Optional[Change]:
        """The change that redo makes, or None."""
        return self._undone[-1] if self._undone else None

    @property
    def texts(self) -> Tuple[str, str]:
        """The changes that undo and redo would make, in words; empty for none."""
        return (
            self.last.change.text if self.last is not None else "",
            self.next.text if self.next is not None else "",
        )
