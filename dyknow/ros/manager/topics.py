# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The topics of the DyKnow manager: ``~model`` and ``~stream_events``."""

from __future__ import annotations

from typing import Callable

import rospy
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.msg import StreamEvent

from dyknow.locks import turn_lock
from dyknow.manager.claim import ClaimEvent
from dyknow.manager.claims.answers import StreamAnswers
from dyknow.model.graph import Model
from dyknow.ros.wire.messages import event_message
from dyknow.ros.wire.model_messages import ModelMessages

#: Events that may wait for a slow subscriber.
_QUEUE_SIZE = 1000


class ModelTopic:
    """The latched topic of the model; one message may show several changes."""

    def __init__(
        self, take: Callable[[], Model], messages: ModelMessages, before: Callable[[], None]
    ) -> None:
        """Advertise the topic.

        Args:
            take: returns the model of this moment.
            messages: converts it.
            before: called before each message.
        """
        self._take = take
        self._messages = messages
        self._before = before
        self._shown: tuple[int, int] | None = None
        self._publisher = rospy.Publisher("~model", ModelMessage, latch=True, queue_size=1)
        self._turn = turn_lock("model on its topic")
        self.close = self._publisher.unregister

    def publish(self) -> None:
        """Publish the present model, unless it was published."""
        with self._turn:
            self._before()
            model = self._take()
            revisions = (model.revision, model.library_revision)
            if revisions != self._shown:
                self._publisher.publish(self._messages.topic(model))
                self._shown = revisions


class EventTopic:
    """The topic of the events of claims, which are logged as well.

    It is withdrawn with the node, once the last event is sent.
    """

    def __init__(self, answers: StreamAnswers, known: set[str]) -> None:
        """Advertise the topic; the claims ``known`` are not new to clients."""
        self._answers = answers
        self._known = known
        self._publisher = rospy.Publisher("~stream_events", StreamEvent, queue_size=_QUEUE_SIZE)

    def publish(self, event: ClaimEvent) -> None:
        """Publish an event."""
        claim = event.after
        is_new = claim.claim_id not in self._known
        self._known.add(claim.claim_id)
        if claim.state.ended:
            self._known.discard(claim.claim_id)
        tag, state = claim.request.tag, claim.state.name
        rospy.loginfo("stream %s, %s: %s: %s", claim.claim_id, tag, state, event.reason)
        self._publisher.publish(event_message(self._answers.event(event, is_new)))
