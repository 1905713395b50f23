# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets whose ports are switched while messages flow."""

from __future__ import annotations

import threading

from std_msgs.msg import UInt64

import dyknow
from dyknow_benchmark import control_topics
from dyknow_benchmark.sequences import SwitchedIn, SwitchedOut


class SwitchSource(dyknow.Nodelet):
    """Publishes numbers on the ports ``even``, ``odd`` (2n, 2n + 1) and ``out`` (n).

    Parameters: ``~rate`` (Hz).
    """

    def on_init(self) -> None:
        """Set up the ports and begin."""
        handle = dyknow.NodeHandle(self.node_handle)
        self._even = handle.Publisher("even", UInt64, queue_size=10)
        self._odd = handle.Publisher("odd", UInt64, queue_size=10)
        self._out = handle.Publisher("out", UInt64, queue_size=10)
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
    """Checks what comes at ``in`` (to be switched) and at ``left`` and ``right`` (to stay).

    Parameters: ``~control`` (namespace of the control topics). It reports as hop 0 what came at
    ``in``, as hop 1 what came at the other two.
    """

    def on_init(self) -> None:
        """Set up the ports."""
        handle = dyknow.NodeHandle(self.node_handle)
        switched_in, switched_out = SwitchedIn(), SwitchedOut()
        control = handle.get_param("~control")
        control_topics.listen_collect(self.node_handle, control, 0, switched_in)
        control_topics.listen_collect(self.node_handle, control, 1, switched_out)
        handle.Subscriber("in", UInt64, lambda m: switched_in.receive(m.data), queue_size=1000)
        for side in ("left", "right"):
            handle.Subscriber(
                side,
                UInt64,
                lambda m, side: switched_out.receive(side, m.data),
                callback_args=side,
                queue_size=1000,
            )
