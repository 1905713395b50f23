"""The latched topic of the model: each change is followed by a message, a storm by few."""

from __future__ import annotations

import threading
import time
from typing import Callable

import rospy
from dyknow_msgs.msg import Model as ModelMessage

from dyknow.manager.model import Model
from dyknow.ros.model_messages import ModelMessages

#: Least seconds from one message to the next.
PERIOD = 0.05


class ModelPublisher:
    """Publishes the model after it changed, from a thread of its own."""

    def __init__(
        self,
        topic: str,
        take: Callable[[], Model],
        messages: ModelMessages,
        before: Callable[[], None] = lambda: None,
    ) -> None:
        """Advertise the topic.

        Args:
            topic: its name.
            take: gives the model of this moment.
            messages: makes the messages.
            before: called ahead of each message.
        """
        self._take = take
        self._messages = messages
        self._before = before
        self._changed = threading.Event()
        self._closed = False
        self._publisher = rospy.Publisher(topic, ModelMessage, latch=True, queue_size=1)
        self._thread = threading.Thread(target=self._run, name="model", daemon=True)
        self._thread.start()

    def note_change(self) -> None:
        """Say that the model changed; returns at once."""
        self._changed.set()

    def close(self) -> None:
        """Publish no more."""
        self._closed = True
        self._changed.set()
        self._thread.join(1.0)
        self._publisher.unregister()

    def _run(self) -> None:
        last = None
        while True:
            self._changed.wait()
            self._changed.clear()
            if self._closed:
                return
            self._before()
            model = self._take()
            shown = (model.revision, model.library_revision)
            if shown != last:
                last = shown
                self._publisher.publish(self._messages.topic(model))
            time.sleep(PERIOD)
