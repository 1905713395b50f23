"""What was changed from this window, for undo and redo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Tuple, Union

from dyknow_rqt.graph.changes import CannotUndo, Change

#: So many changes can be taken back.
DEPTH = 100


@dataclass(frozen=True)
class DoneChange:
    """A change that was made, and the way back or why there is none."""

    change: Change
    back: Union[Change, CannotUndo]


class UndoHistory:
    """Two stacks: what can be taken back, and what can be done again."""

    def __init__(self) -> None:
        self._done: List[DoneChange] = []
        self._undone: List[Change] = []

    def note(self, change: Change, back: Union[Change, CannotUndo]) -> None:
        """A change was made by hand: nothing can be done again after it."""
        self._done.append(DoneChange(change, back))
        del self._done[:-DEPTH]
        self._undone.clear()

    def note_undone(self) -> None:
        """The last step was taken back."""
        self._undone.append(self._done.pop().change)

    def note_redone(self, change: Change, back: Union[Change, CannotUndo]) -> None:
        """The last undone change was made again."""
        self._undone.pop()
        self._done.append(DoneChange(change, back))

    def drop(self) -> None:
        """Forget the last step: there is no way back, and those before it are to be reached."""
        self._done.pop()

    @property
    def last(self) -> Optional[DoneChange]:
        """What undo takes back."""
        return self._done[-1] if self._done else None

    @property
    def next(self) -> Optional[Change]:
        """What redo does."""
        return self._undone[-1] if self._undone else None

    @property
    def texts(self) -> Tuple[str, str]:
        """What undo and redo would do; empty for nothing."""
        return (
            self.last.change.text if self.last is not None else "",
            self.next.text if self.next is not None else "",
        )
