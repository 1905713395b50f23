"""Waits for the first message of a replacement: only then may it take the place of the old."""

from __future__ import annotations

import contextlib
from typing import Callable, List, Optional

from dyknow.manager.host import Count, Host
from dyknow.manager.record import Record

#: Seconds between two questions.
_STEP = 0.02


class Delivery:
    """Knows how to ask, and how long to wait."""

    def __init__(
        self,
        host: Host,
        patience: float,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        """Wait for nothing yet.

        Args:
            host: who is asked.
            patience: seconds that all replacements of one plan together may take to deliver.
            clock: seconds, steady.
            sleep: waits that long.
        """
        self.host = host
        self.patience = patience
        self.clock = clock
        self.sleep = sleep

    def begin(self) -> Handover:
        """Begin with a plan; its time runs from the first wait on."""
        return Handover(self)


class Handover:
    """The waits of one plan."""

    def __init__(self, delivery: Delivery) -> None:
        """Begin."""
        self._delivery = delivery
        self._deadline = 0.0
        #: What did not go as it should, in words.
        self.remarks: List[str] = []

    def wait(self, record: Record, port: str) -> None:
        """Wait until an out-port has sent something, or until there is no more time."""
        delivery = self._delivery
        if not self._deadline:
            self._deadline = delivery.clock() + delivery.patience
        with contextlib.ExitStack() as closing:
            has_sent = self._question(record, port, closing)
            while not has_sent():
                if delivery.clock() >= self._deadline:
                    late = f"though it sent nothing within {delivery.patience:g} s"
                    self.remarks.append(f"{record.name} took over {late}")
                    return
                delivery.sleep(_STEP)

    def _question(
        self, record: Record, port: str, closing: contextlib.ExitStack
    ) -> Callable[[], bool]:
        """Tell how to find out whether an out-port has sent something."""
        host = self._delivery.host
        begin = self._delivery.clock()  # an earlier answer is about an earlier nodelet of the name
        if record.rewired_by_reload:
            listening = host.listen(record.topics.get(port, ""))
            closing.callback(listening.close)
            return lambda: _shows_messages(listening.count(), begin)
        wanted = {record.manager: (record.name,)}
        return lambda: _shows_messages(
            (host.counts(wanted).get(record.name) or {}).get(port), begin
        )


def _shows_messages(count: Optional[Count], since: float) -> bool:
    return count is not None and count.asked >= since and count.messages > 0
