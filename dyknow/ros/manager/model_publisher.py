# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The latched topic of the model: a message follows each change, and few follow many."""

from __future__ import annotations

from typing import Callable, Optional, Tuple

import rospy
from dyknow_msgs.msg import Model as ModelMessage

from dyknow.model.graph import Model
from dyknow.periodic import PeriodicWorker
from dyknow.ros.model_messages import ModelMessages

#: Least seconds between two messages.
PERIOD = 0.05


class ModelPublisher:
    """Publishes the model after its changes, from a thread of its own."""

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
            take: returns the model of this moment.
            messages: converts it.
            before: called before each message.
        """
        self._take = take
        self._messages = messages
        self._before = before
        self._shown: Optional[Tuple[int, int]] = None
        self._publisher = rospy.Publisher(topic, ModelMessage, latch=True, queue_size=1)
        self._worker = PeriodicWorker("publishing the model", self._publish, pause=PERIOD)
        self._worker.start()

    def note_change(self) -> None:
        """Say that the model changed; returns at once."""
        self._worker.wake()

    def close(self) -> None:
        """Withdraw the topic."""
        self._worker.close(1.0)
        self._publisher.unregister()

    def _publish(self) -> None:
        self._before()
        model = self._take()
        revisions = (model.revision, model.library_revision)
        if revisions != self._shown:
            self._publisher.publish(self._messages.topic(model))
            self._shown = revisions
