# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets of the measurements: parts of chains, on ports and on plain topics, and others."""

from __future__ import annotations

import threading
import uuid
from typing import Any

from std_msgs.msg import Empty, Header, UInt64

import dyknow
from dyknow_benchmark.parts import (
    Hop,
    MessageSource,
    SwitchedIn,
    SwitchedOut,
    listen_collect,
    payload_of,
)


class ChainSource(dyknow.Nodelet):
    """Publishes stamped messages on the port ``out`` as ordered.

    Parameters: ``~control`` (namespace of the control topics), ``~payload`` (time, or a size).
    """

    def on_init(self) -> None:
        """Set up the port and listen for orders."""
        handle = self._handle()
        payload = payload_of(handle.get_param("~payload", "time"))
        publisher = handle.Publisher("out", payload.datatype, queue_size=10)
        self._source = MessageSource(publisher.publish, payload)
        self._source.listen(self.node_handle, handle.get_param("~control"))

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
        publisher = handle.Publisher("out", payload.datatype, queue_size=10)
        number, record = handle.get_param("~hop", 0), handle.get_param("~record", False)
        hop = Hop(number, record, publisher.publish, payload)
        hop.listen(self.node_handle, handle.get_param("~control", ""))
        handle.Subscriber("in", payload.datatype, hop.receive, queue_size=10)

    def _handle(self) -> Any:
        return dyknow.NodeHandle(self.node_handle)


class PlainChainSource(ChainSource):
    """``ChainSource`` without the proxy: ``out`` is a topic."""

    def _handle(self) -> Any:
        return self.node_handle


class PlainChainHop(ChainHop):
    """``ChainHop`` without the proxy: ``in`` and ``out`` are topics."""

    def _handle(self) -> Any:
        return self.node_handle


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


class SwitchSource(dyknow.Nodelet):
    """Publishes numbers on the ports ``even``, ``odd`` (2n, 2n + 1) and ``out`` (n).

    Parameters: ``~rate`` (Hz).
    """

    def on_init(self) -> None:
        """Set up the ports and begin."""
        handle = dyknow.NodeHandle(self.node_handle)
        self._even, self._odd, self._out = (
            handle.Publisher(port, UInt64, queue_size=10) for port in ("even", "odd", "out")
        )
        self._period = 1.0 / handle.get_param("~rate", 1000.0)
        self._stopped = threading.Event()
        threading.Thread(target=self._run, name="switch source", daemon=True).start()

    def on_shutdown(self) -> None:
        """Stop."""
        self._stopped.set()

    def _run(self) -> None:
        number = 0
        while not self._stopped.wait(self._period):
            self._even.publish(UInt64(2 * number))
            self._odd.publish(UInt64(2 * number + 1))
            self._out.publish(UInt64(number))
            number += 1


class SwitchSink(dyknow.Nodelet):
    """Checks the messages at ``in`` (to be switched) and at ``left`` and ``right`` (to stay).

    Parameters: ``~control`` (namespace of the control topics). It reports ``in``
    as hop 0, and the other two as hop 1.
    """

    def on_init(self) -> None:
        """Set up the ports."""
        handle = dyknow.NodeHandle(self.node_handle)
        switched_in, switched_out = SwitchedIn(), SwitchedOut()
        control = handle.get_param("~control")
        listen_collect(self.node_handle, control, 0, switched_in.collect)
        listen_collect(self.node_handle, control, 1, switched_out.collect)
        handle.Subscriber("in", UInt64, lambda m: switched_in.receive(m.data), queue_size=1000)
        for side in ("left", "right"):
            handle.Subscriber(
                side,
                UInt64,
                lambda m, side: switched_out.receive(side, m.data),
                callback_args=side,
                queue_size=1000,
            )


class SignedRelay(dyknow.Nodelet):
    """Forwards headers, with a name of this life as the frame, until ``~fall_silent`` is heard."""

    def on_init(self) -> None:
        """Set up the ports."""
        handle: Any = dyknow.NodeHandle(self.node_handle)
        life = str(uuid.uuid4())
        silent = threading.Event()
        publisher = handle.Publisher("out", Header, queue_size=10)

        def forward(message: Header) -> None:
            if not silent.is_set():
                publisher.publish(Header(stamp=message.stamp, frame_id=life))

        handle.Subscriber("in", Header, forward, queue_size=10)
        self.private_node_handle.Subscriber("fall_silent", Empty, lambda message: silent.set())
