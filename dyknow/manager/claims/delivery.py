"""Waits for the first message of a replacement: only then may it take the place of the old."""

from __future__ import annotations

from typing import Callable, List

from dyknow.errors import HostError
from dyknow.manager.host import Host
from dyknow.manager.model import Record

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
        while not self._has_sent(record, port):
            if delivery.clock() >= self._deadline:
                late = f"though it sent nothing within {delivery.patience:g} s"
                self.remarks.append(f"{record.name} took over {late}")
                return
            delivery.sleep(_STEP)

    def _has_sent(self, record: Record, port: str) -> bool:
        try:
            if record.rewired_by_reload:
                topic = record.topics.get(port, "")
                return self._delivery.host.heard((topic,)).get(topic, 0) > 0
            return self._delivery.host.sent(record.name).get(port, 0) > 0
        except HostError:
            return False
