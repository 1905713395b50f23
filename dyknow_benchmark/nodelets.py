# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The parts of a chain as nodelets, on ports and on plain topics."""

from __future__ import annotations

from typing import Any

import dyknow
from dyknow_benchmark import control_topics
from dyknow_benchmark.parts import Hop, MessageSource, Ring, payload_of


class ChainSource(dyknow.Nodelet):
    """Publishes stamped messages on the port ``out`` when it is told to.

    Parameters: ``~control`` (namespace of the control topics), ``~payload`` (time, or a size).
    """

    def on_init(self) -> None:
        """Set up the port and listen for orders."""
        handle = self._handle()
        payload = payload_of(handle.get_param("~payload", "time"))
        publisher = handle.Publisher("out", payload.datatype, queue_size=10)
        self._source = MessageSource(publisher.publish, payload)
        control_topics.listen_send(self.node_handle, handle.get_param("~control"), self._source)

    def on_shutdown(self) -> None:
        """Stop sending."""
        self._source.stop()

    def _handle(self) -> Any:
        return dyknow.NodeHandle(self.node_handle)


class ChainHop(dyknow.Nodelet):
    """Forwards stamped messages from the port ``in`` to the port ``out``.

    Parameters: ``~control`` (namespace of the control topics), ``~payload`` (time, or a size),
    ``~hop`` (its number, from 1), ``~record`` (whether to report how long messages took).
    """

    def on_init(self) -> None:
        """Set up the ports."""
        handle = self._handle()
        payload = payload_of(handle.get_param("~payload", "time"))
        record = handle.get_param("~record", False)
        publisher = handle.Publisher("out", payload.datatype, queue_size=10)
        number = handle.get_param("~hop", 0)
        hop = Hop(number, record, publisher.publish, payload)
        if record:
            control_topics.listen_collect(
                self.node_handle, handle.get_param("~control"), number, hop
            )
        handle.Subscriber("in", payload.datatype, hop.receive, queue_size=10)

    def _handle(self) -> Any:
        return dyknow.NodeHandle(self.node_handle)


class ChainRing(dyknow.Nodelet):
    """Publishes on the port ``out`` what arrives on the port ``in``, and starts it.

    Parameters: ``~control`` (namespace of the control topics).
    """

    def on_init(self) -> None:
        """Set up the ports and listen for orders."""
        handle = dyknow.NodeHandle(self.node_handle)
        payload = payload_of("time")
        publisher = handle.Publisher("out", payload.datatype, queue_size=10)
        ring = Ring(publisher.publish, payload)
        control = handle.get_param("~control")
        control_topics.listen_send(self.node_handle, control, ring)
        control_topics.listen_collect(self.node_handle, control, 0, ring)
        handle.Subscriber("in", payload.datatype, ring.receive, queue_size=10)


class Burner(dyknow.Nodelet):
    """Computes, in Python, in a callback that ends when the nodelet does."""

    def on_init(self) -> None:
        """Begin."""
        self._stopped = False
        handle: Any = dyknow.NodeHandle(self.node_handle)
        self._timer = handle.Timer(handle.Duration(0.01), self._burn, oneshot=True)

    def on_shutdown(self) -> None:
        """End."""
        self._stopped = True

    def _burn(self, event: object) -> None:
        count = 0
        while not self._stopped:
            count += 1


class PlainChainSource(ChainSource):
    """``ChainSource`` without the proxy: ``out`` is a topic."""

    def _handle(self) -> Any:
        return self.node_handle


class PlainChainHop(ChainHop):
    """``ChainHop`` without the proxy: ``in`` and ``out`` are topics."""

    def _handle(self) -> Any:
        return self.node_handle
