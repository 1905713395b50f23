# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The part of a stream that fails in the measurement of failover."""

from __future__ import annotations

import uuid
from typing import Any

from std_msgs.msg import Empty, Header

import dyknow


class SignedRelay(dyknow.Nodelet):
    """Forwards headers, with a name of this life as the frame, until ``~fall_silent`` is heard."""

    def on_init(self) -> None:
        """Set up the ports."""
        handle: Any = dyknow.NodeHandle(self.node_handle)
        life = str(uuid.uuid4())
        silent = [False]
        publisher = handle.Publisher("out", Header, queue_size=10)

        def forward(message: Header) -> None:
            if not silent[0]:
                publisher.publish(Header(stamp=message.stamp, frame_id=life))

        def fall_silent(message: Empty) -> None:
            silent[0] = True

        handle.Subscriber("in", Header, forward, queue_size=10)
        self.private_node_handle.Subscriber("fall_silent", Empty, fall_silent)
