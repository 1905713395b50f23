# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Models serialised from cached parts equal their messages."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from typing import Any

import rospy
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.srv import GetModelResponse

from dyknow.manager.record import Record
from dyknow.model.graph import Model, PortState, State
from dyknow.model.transformation import Parameter, Port, Transformation
from dyknow.ros.messages import model_from, nodelet_message, transformation_message
from dyknow.ros.model_messages import ModelMessages

RELAY = Transformation(
    "relay",
    "dyknow/Relay",
    parameters=(Parameter("rate", "double", "0.5"),),
    ports=(Port("in", "in", "std_msgs/Header", ("A(b)",)), Port("out", "out")),
)
NODELET = Record(
    "/relay",
    RELAY,
    "/manager",
    is_protected=True,
    state=State.LOST,
    detail="gone",
    ports=(PortState("in", "in", "std_msgs/Header", "/t", ("A(b)",)), PortState("out", "out")),
)
OTHER = Record("/theirs", None, "/manager", state=State.RUNNING)


def sent(message: Any) -> Any:
    """Serialise and deserialise a message."""
    rospy.rostime.set_rostime_initialized(True)
    buffer = BytesIO()
    message.serialize(buffer)
    kind = GetModelResponse if isinstance(message, GetModelResponse) else ModelMessage
    return kind().deserialize(buffer.getvalue())


def test_topic_and_response() -> None:
    rospy.rostime.set_rostime_initialized(True)
    messages = ModelMessages()
    model = Model(7, 3, (NODELET.status, OTHER.status), (RELAY,))
    on_topic = sent(messages.topic(model))
    assert (on_topic.revision, on_topic.library_revision) == (7, 3)
    assert on_topic.nodelets == [nodelet_message(NODELET.status), nodelet_message(OTHER.status)]
    assert on_topic.transformations == []
    answer = sent(messages.response(model)).model
    assert answer.nodelets == on_topic.nodelets
    assert answer.transformations == [transformation_message(RELAY)]
    assert model_from(answer) == model


def test_what_changes_is_made_anew() -> None:
    rospy.rostime.set_rostime_initialized(True)
    messages = ModelMessages()
    messages.response(Model(1, 1, (NODELET.status, OTHER.status), (RELAY,)))
    released = replace(NODELET, is_protected=False)
    cheap = RELAY._replace(cost=0)
    answer = sent(messages.response(Model(2, 2, (released.status,), (cheap,)))).model
    assert [each.is_protected for each in answer.nodelets] == [False]
    assert [each.cost for each in answer.transformations] == [0]
