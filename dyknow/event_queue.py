"""Tells news in their order, one after the other, outside the locks under which they arise."""

from __future__ import annotations

from collections import deque
from typing import Callable, Deque, Generic, TypeVar

from dyknow.locks import state_lock

News = TypeVar("News")


class EventQueue(Generic[News]):
    """A row of news; who adds to it while another thread tells leaves the telling to it."""

    def __init__(self, listener: Callable[[News], None]) -> None:
        """Have nothing to tell yet."""
        self.listener = listener
        self._state_lock = state_lock("event queue")
        self._row: Deque[News] = deque()
        self._telling = False

    def add(self, news: News) -> None:
        """Put something at the end of the row; called under the lock that orders it."""
        with self._state_lock:
            self._row.append(news)

    def tell(self) -> None:
        """Tell what is in the row, unless somebody is about to; called under no lock."""
        while True:
            with self._state_lock:
                if self._telling or not self._row:
                    return
                news = self._row.popleft()
                self._telling = True
            try:
                self.listener(news)
            finally:
                with self._state_lock:
                    self._telling = False
