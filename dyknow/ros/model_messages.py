# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The manager's model as messages, serialised once for each thing that changes.

A model may hold hundreds of nodelets and a hundred thousand transformations, and is requested
again and again while little of it changes. So the bytes of each nodelet and of each transformation
are kept until it changes, and a model is put together from them.
"""

from __future__ import annotations

import struct
from io import BytesIO
from typing import Any, Dict, Iterable, List, Tuple

import rospy
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.srv import GetModelResponse

from dyknow.locks import turn_lock
from dyknow.model.graph import Model, NodeletStatus
from dyknow.model.transformation import Transformation
from dyknow.ros.messages import nodelet_message, transformation_message

_HEAD = struct.Struct("<QQII")
_COUNT = struct.Struct("<I")


class ModelMessages:
    """Makes messages of models, from kept parts."""

    def __init__(self) -> None:
        """Make an empty cache."""
        self._turn = turn_lock("parts of model messages")
        self._nodelets: Dict[str, Tuple[NodeletStatus, bytes]] = {}
        self._transformations: Dict[str, Tuple[Transformation, bytes]] = {}
        self._library: Tuple[int, bytes] = (-1, b"")

    def topic(self, model: Model) -> ModelMessage:
        """Message for the topic: nodelets only."""
        return _ReadyModel(self._graph(model) + _COUNT.pack(0))

    def response(self, model: Model) -> GetModelResponse:
        """Answer of the service: nodelets and transformations."""
        return _ReadyResponse(self._graph(model) + self._library_of(model))

    def _graph(self, model: Model) -> bytes:
        now = rospy.Time.now()
        head = _HEAD.pack(model.revision, model.library_revision, now.secs, now.nsecs)
        with self._turn:
            known = self._nodelets
            kept = {
                each.name: known[each.name]
                if known.get(each.name, (None,))[0] is each
                else (each, _bytes(nodelet_message(each)))
                for each in model.nodelets
            }
            self._nodelets = kept
        return head + _sequence(part for _, part in kept.values())

    def _library_of(self, model: Model) -> bytes:
        with self._turn:
            revision, part = self._library
            if revision == model.library_revision:
                return part
            known = self._transformations
            kept = {
                each.label: known[each.label]
                if known.get(each.label, (None,))[0] is each
                else (each, _bytes(transformation_message(each)))
                for each in model.transformations
            }
            part = _sequence(part for _, part in kept.values())
            self._transformations = kept
            self._library = (model.library_revision, part)
            return part


class _Ready:
    """A message that is serialised already; its fields are not filled in."""

    def __init__(self, body: bytes) -> None:
        super().__init__()
        self._body = body

    def serialize(self, buff: Any) -> None:
        """Write it."""
        buff.write(self._body)


class _ReadyModel(_Ready, ModelMessage):
    pass


class _ReadyResponse(_Ready, GetModelResponse):
    pass


def _bytes(message: Any) -> bytes:
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def _sequence(parts: Iterable[bytes]) -> bytes:
    gathered: List[bytes] = list(parts)
    return _COUNT.pack(len(gathered)) + b"".join(gathered)
