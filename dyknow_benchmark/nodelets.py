# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets of the measurements: parts of chains, on ports and on plain topics, and others."""

from __future__ import annotations

import threading
import uuid
from functools import partial
from typing import Any

from std_msgs.msg import Empty, Header, UInt64

import dyknow
from dyknow_benchmark.parts import Part, SwitchedIn, SwitchedOut, offer_report


class ChainSource(dyknow.Nodelet):
    """Publishes stamped messages on ``out``.

    The parameters are those of ``parts``, and ``~plain`` (false): topics instead of ports.
    """

    def on_init(self) -> None:
        self._source = _part(self).source()

    def on_shutdown(self) -> None:
        self._source.stop()


class ChainHop(dyknow.Nodelet):
    """Forwards stamped messages from ``in`` to ``out``, with parameters as ``ChainSource``."""

    def on_init(self) -> None:
        _part(self).hop()


def _part(nodelet: dyknow.Nodelet) -> Part:
    handle = nodelet.node_handle
    is_plain = handle.get_param("~plain", False)
    return Part(handle if is_plain else dyknow.NodeHandle(handle), handle)


class Burner(dyknow.Nodelet):
    """Computes, in Python, in a callback that ends when the nodelet does."""

    def on_init(self) -> None:
        self._stopped = False
        handle: Any = dyknow.NodeHandle(self.node_handle)
        self._timer = handle.Timer(handle.Duration(0.01), self._burn, oneshot=True)

    def on_shutdown(self) -> None:
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
        handle = dyknow.NodeHandle(self.node_handle)
        self._even, self._odd, self._out = (
            handle.Publisher(port, UInt64, queue_size=10) for port in ("even", "odd", "out")
        )
        self._period = 1.0 / handle.get_param("~rate", 1000.0)
        self._stopped = threading.Event()
        threading.Thread(target=self._run, name="switch source", daemon=True).start()

    def on_shutdown(self) -> None:
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

    Services: ``~report_in`` and, for the other two, ``~report_out``.
    """

    def on_init(self) -> None:
        handle = dyknow.NodeHandle(self.node_handle)
        in_, out = SwitchedIn(), SwitchedOut()
        for port, watch in (("in", in_), ("out", out)):
            offer_report(handle, f"~report_{port}", watch.collect)
        handle.Subscriber("in", UInt64, lambda m: in_.receive(m.data), queue_size=1000)
        for side in ("left", "right"):
            receive = partial(self._receive, out, side)
            handle.Subscriber(side, UInt64, receive, queue_size=1000)

    @staticmethod
    def _receive(watch: SwitchedOut, side: str, message: UInt64) -> None:
        watch.receive(side, message.data)


class SignedRelay(dyknow.Nodelet):
    """Forwards headers, with a name of this life as the frame, until ``~fall_silent`` is heard."""

    def on_init(self) -> None:
        handle: Any = dyknow.NodeHandle(self.node_handle)
        life = str(uuid.uuid4())
        silent = threading.Event()
        publisher = handle.Publisher("out", Header, queue_size=10)

        def forward(message: Header) -> None:
            if not silent.is_set():
                publisher.publish(Header(stamp=message.stamp, frame_id=life))

        handle.Subscriber("in", Header, forward, queue_size=10)
        self.private_node_handle.Subscriber("fall_silent", Empty, lambda message: silent.set())
