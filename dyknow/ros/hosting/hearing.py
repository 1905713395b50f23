"""Counts messages on topics whose publishers cannot be asked, by listening to them."""

from __future__ import annotations

import threading
from typing import Any, Dict, Iterable

import rospy


class Hearing:
    """Subscribers of any type that do nothing but count."""

    def __init__(self) -> None:
        """Listen to nothing yet."""
        self._lock = threading.Lock()
        self._ears: Dict[str, _Ear] = {}

    def counts(self, topics: Iterable[str]) -> Dict[str, int]:
        """Count the messages of these topics since they were named first; forget the others."""
        wanted = set(topics)
        with self._lock:
            dropped = [self._ears.pop(topic) for topic in sorted(set(self._ears) - wanted)]
            for topic in sorted(wanted - set(self._ears)):
                self._ears[topic] = _Ear(topic)
            counts = {topic: ear.count for topic, ear in self._ears.items()}
        for ear in dropped:
            ear.close()
        return counts

    def close(self) -> None:
        """Listen to nothing any more."""
        self.counts(())


class _Ear:
    def __init__(self, topic: str) -> None:
        self.count = 0
        self._subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._hear, queue_size=1)

    def _hear(self, message: Any) -> None:
        self.count += 1

    def close(self) -> None:
        self._subscriber.unregister()
