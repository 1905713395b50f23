# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about topics that come and go: a talker, and outside listeners."""

from __future__ import annotations

import itertools
import unittest

from graph import PEER, Manager, call, nodes_on
from processes import Running, eventually


class ReadvertisedCase(unittest.TestCase):
    """Each test has a talker on /t in its own nodelet manager."""

    def setUp(self):
        self.manager = Manager("/manager")
        self.addCleanup(self.manager.__exit__)
        self.numbers = itertools.count(1)
        self.load()

    def load(self):
        self.manager.load("Talker", "/talker", {"/out": "/t"})

    def dozer(self, seconds):
        """A peer that sleeps for a time (s) after each message."""
        peer = Running(*PEER, "doze", str(seconds), "/t")
        self.addCleanup(peer.__exit__)
        return peer

    def are_there(self, count):
        """Wait for a number of peers."""
        eventually(lambda: len(nodes_on("/t")[1]) == count, 20.0, "they are there")

    def publish(self):
        number = next(self.numbers)
        call("/talker", "publish", number, 1)
        return number

    def is_heard_by(self, *peers):
        """Publish until each peer has heard something new."""
        first = self.publish()

        def heard(peer):
            lines = [line.split() for line in peer.output.splitlines() if line.startswith("/t ")]
            return any(int(number) >= first for _, number in lines[-1:])

        def all_heard():
            self.publish()
            return all(map(heard, peers))

        eventually(
            all_heard, 8.0, f"{first} is heard", lambda: [peer.output[-60:] for peer in peers]
        )
