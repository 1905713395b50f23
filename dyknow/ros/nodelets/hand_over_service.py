# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The service by which a DyKnow manager moves a nodelet from or to this process.

It is not registered with the master, as ``~poll``: managers look up another service.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any, Callable, Iterable

import rospy
from dyknow_msgs import msg
from dyknow_msgs.srv import HandOver, HandOverRequest, HandOverResponse
from rospy.impl.registration import get_service_manager
from rospy.impl.tcpros_service import ServiceImpl

from dyknow.errors import DyKnowError
from dyknow.model.transformation import IN, OUT
from dyknow.nodelet.context import Context
from dyknow.nodelet.hand_over import HandedTopic, HandOvers
from dyknow.nodelet.loader import Loader
from dyknow.nodelet.middleware import DIGEST_SIZE, Closable
from dyknow.nodelet.texts import sendable
from dyknow.ros.nodelets.process_guards import ProcessGuards, caller_of
from dyknow.ros.wire.message_classes import message_class

SERVICE = "hand_over"


class HandOverService(Closable):
    """Offers ``~hand_over`` until it is closed; the node must be initialised."""

    def __init__(
        self, loader: Loader, guards: ProcessGuards, unload: Callable[[Context], object]
    ) -> None:
        self._guards = guards
        self._hand_overs = HandOvers(loader, _message_class, unload)
        self._service = ServiceImpl("~" + SERVICE, HandOver, self._answer)
        get_service_manager().map[self._service.resolved_name] = self._service

    def close(self) -> None:
        get_service_manager().map.pop(self._service.resolved_name, None)
        self._hand_overs.close()

    def _answer(self, request: Any) -> HandOverResponse:
        name = request.nodelet
        try:
            texts = [name, *(each.topic for each in request.topics)]
            self._guards.current().check_sizes(texts, len(request.topics))
            self._guards.check_caller(caller_of(request), f"moving '{name}'")
            self._guards.check_protection(caller_of(request), name)
            return HandOverResponse(self._step(name, request.step, request.topics))
        except DyKnowError as error:
            raise rospy.ServiceException(sendable(error)) from error

    def _step(self, name: str, step: int, topics: Any) -> list[msg.HandedTopic]:
        moves, ends = self._hand_overs, list(map(topic_from, topics))
        if step == HandOverRequest.NOTE:
            return list(map(topic_message, moves.note(name)))
        if step == HandOverRequest.GIVE:
            return list(map(topic_message, moves.give(name, ends)))
        if step == HandOverRequest.PARK:
            return list(map(topic_message, moves.park(name, ends)))
        if step == HandOverRequest.TAKE:
            moves.take(name, ends)
        else:
            moves.end(name)
        return []


def topic_message(topic: HandedTopic) -> msg.HandedTopic:
    direction = msg.Port.IN if topic.direction == IN else msg.Port.OUT
    digests = b"".join(digest for _, digest in topic.given)
    times = [moment for moment, _ in topic.given]
    sizes = list(map(len, topic.waiting))
    waiting = b"".join(topic.waiting)
    fields = (digests, times, waiting, sizes, topic.latch, topic.options, topic.flows)
    return msg.HandedTopic(topic.topic, topic.datatype, direction, *fields)


def topic_from(message: Any) -> HandedTopic:
    digests = _parts(message.given, [DIGEST_SIZE] * len(message.arrived))
    direction = IN if message.direction == msg.Port.IN else OUT
    given = tuple(zip(message.arrived, digests))
    waiting = tuple(_parts(message.waiting, message.sizes))
    fields = (given, waiting, message.latch, message.options, message.flows)
    return HandedTopic(message.topic, message.datatype, direction, *fields)


def _parts(content: bytes, sizes: Iterable[int]) -> list[bytes]:
    stream = BytesIO(content)
    return [stream.read(size) for size in sizes]


def _message_class(datatype: str) -> Any:
    return None if datatype == "*" else message_class(datatype)
