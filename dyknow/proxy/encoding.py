# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The sending end of an out-port that has a companion: plain and encoded messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable

from dyknow.nodelet.context import Context
from dyknow.nodelet.endpoints import NOTHING, Publication
from dyknow.nodelet.middleware import Codec


@dataclass(frozen=True)
class _EncodedPeer:
    """A subscriber of encoded messages, among the peers of both publications."""

    peer: Any


class EncodingPublication:
    """Stands for two publications where a handle expects one; ``port`` is the companion.

    The publishing thread encodes a message, once, and only while the encoded form has a
    subscriber or is latched. A message that cannot be encoded is counted and logged as an
    error of the nodelet; plainly it was sent.
    """

    def __init__(self, context: Context, port: Any, plain: Publication, codec: Codec) -> None:
        self._context = context
        self._what = f"'{port.name}'"
        self._plain = plain
        self._encoded: Publication = port.publication
        self._codec = codec
        self.datatype = plain.datatype
        self.refusal = plain.refusal

    @property
    def topic(self) -> str:
        """The topic of the plain messages."""
        return self._plain.topic

    def publish(self, message: Any = NOTHING, /, *fields: Any, **named: Any) -> None:
        """Publish a message in both forms; like ``Publication.publish``."""
        if message.__class__ is not self.datatype or fields or named:
            message = self._plain.built(message, fields, named)
        self._plain.publish(message)
        if self._encoded.heard:
            self._send_encoded(message, self._encoded.publish)

    def publish_to(self, topic: str, peer: Any, message: Any) -> None:
        """Send a message to one of the ``peers`` of a topic, in the form that it subscribes to."""
        if not isinstance(peer, _EncodedPeer):
            self._plain.publish_to(topic, peer, message)
        elif topic == self._plain.topic:
            encoded = self._encoded
            self._send_encoded(
                message, lambda form: encoded.publish_to(encoded.topic, peer.peer, form)
            )

    def peers(self) -> tuple[str, tuple[Any, ...]]:
        """The topic, and the subscribers of both forms."""
        topic, plain = self._plain.peers()
        encoded = self._encoded.peers()[1]
        return topic, (*plain, *map(_EncodedPeer, encoded))

    def watch(self, changed: Callable[[], None]) -> None:
        """Call ``changed`` whenever ``peers`` may have changed."""
        for each in (self._plain, self._encoded):
            each.watch(changed)

    def unwatch(self, changed: Callable[[], None]) -> None:
        for each in (self._plain, self._encoded):
            each.unwatch(changed)

    def _send_encoded(self, message: Any, send: Callable[[Any], None]) -> None:
        try:
            form = self._codec.encode(message)
        except Exception as error:  # the boundary: a callback never ends by an image of another
            self._encoded.drop()
            self._context.failed(self._what, error)
            return
        send(form)
