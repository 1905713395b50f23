# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A nodelet that needs much memory, in a reference cycle through a library."""

from __future__ import annotations

import message_filters
from std_msgs.msg import Header

import dyknow


class Heavy(dyknow.Nodelet):
    """Relays, holds 20 MB, and has given its method to an object of a library that it keeps."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.block = b"x" * 20_000_000
        self.out = self.nh.Publisher("out", Header, queue_size=10)
        self.input = self.nh.Subscriber("in", Header, queue_size=10)
        self.cache = message_filters.Cache(self.input, 10)
        self.cache.registerCallback(self.on_message)

    def on_message(self, message):
        self.last = message
        self.out.publish(message)
