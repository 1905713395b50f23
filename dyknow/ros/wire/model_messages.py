# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The manager's model as messages, serialised once for each thing that changes.

A model may hold hundreds of nodelets and a hundred thousand transformations, and is requested
again and again while little of it changes. So the bytes of each part are kept until it changes.
"""

from __future__ import annotations

import struct
from io import BytesIO
from typing import Any, Callable, Generic, Iterable, TypeVar

import rospy
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.srv import GetModelResponse

from dyknow.locks import turn_lock
from dyknow.model.graph import Model, NodeletStatus
from dyknow.model.transformation import Transformation
from dyknow.ros.wire.messages import nodelet_message, transformation_message

T = TypeVar("T")

_HEAD = struct.Struct("<QQII")
_COUNT = struct.Struct("<I")


class _Parts(Generic[T]):
    """Serialised values, kept while they are the same objects."""

    def __init__(self, name: Callable[[T], str], convert: Callable[[T], Any]) -> None:
        self._name = name
        self._convert = convert
        self._kept: dict[str, tuple[T, bytes]] = {}

    def serialise(self, values: Iterable[T]) -> bytes:
        kept: dict[str, tuple[T, bytes]] = {}
        for each in values:
            part = self._kept.get(self._name(each))
            if part is None or part[0] is not each:
                buffer = BytesIO()
                self._convert(each).serialize(buffer)
                part = each, buffer.getvalue()
            kept[self._name(each)] = part
        self._kept = kept
        return _COUNT.pack(len(kept)) + b"".join(part for _, part in kept.values())


class ModelMessages:
    """Makes messages of models, from kept parts."""

    def __init__(self) -> None:
        self._turn = turn_lock("parts of model messages")
        self._nodelets = _Parts[NodeletStatus](lambda each: each.name, nodelet_message)
        self._transformations = _Parts[Transformation](
            lambda each: each.label, transformation_message
        )
        self._library: tuple[int, bytes] = (-1, b"")

    def topic(self, model: Model) -> ModelMessage:
        """Make the message of the topic: nodelets only."""
        return _ReadyModel(self._graph(model) + _COUNT.pack(0))

    def response(self, model: Model) -> GetModelResponse:
        """Make the answer of the service: nodelets and transformations."""
        with self._turn:
            if self._library[0] != model.library_revision:
                part = self._transformations.serialise(model.transformations)
                self._library = (model.library_revision, part)
            library = self._library[1]
        return _ReadyResponse(self._graph(model) + library)

    def _graph(self, model: Model) -> bytes:
        now = rospy.Time.now()
        head = _HEAD.pack(model.revision, model.library_revision, now.secs, now.nsecs)
        with self._turn:
            return head + self._nodelets.serialise(model.nodelets)


class _Ready:
    """A message that is serialised already; its fields are not filled in."""

    def __init__(self, body: bytes) -> None:
        super().__init__()
        self._body = body

    def serialize(self, buff: Any) -> None:
        buff.write(self._body)


class _ReadyModel(_Ready, ModelMessage):
    pass


class _ReadyResponse(_Ready, GetModelResponse):
    pass
