# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the tests of ports: a nodelet to declare them in, and a probe outside of it."""

from __future__ import annotations

from unit.nodelet.fakes import FakeClock, Message, World

import dyknow
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.proxy import NodeletProxy


class Bench:
    """A nodelet on a clock that the test sets, in a world of its own by default."""

    def __init__(self, world=None, **options):
        self.clock = FakeClock()
        self.world = world or World(clock=self.clock)
        self.context = self.world.context("/ns/nodelet", **options)
        self.plain = PlainNodeHandle(self.context, "/ns")
        self.nh = dyknow.NodeHandle(self.plain)
        self.proxy = NodeletProxy.of(self.context)
        self.probe = self.world.handle("/probe")

    def connect(self, **topics):
        self.proxy.set_config(list(topics.items()))

    def topics(self):
        return {port.name: port.topic for port in self.proxy.get_config()}

    def port(self, name):
        (found,) = [p for p in self.proxy.get_statistics().ports if p.port == name]
        return found

    def send(self, topic, *fields):
        """Publish messages of the probe, and run the callbacks that they cause."""
        publisher = self.probe.Publisher(topic, Message, queue_size=1)
        for field in fields:
            publisher.publish(field)
        self.world.drain()
