# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Chains without nodelets, each run as ``python3 -m dyknow_benchmark.process``.

``function`` calls one hop from the other, ``rospy`` connects all hops of one process by rospy's
topics, ``ring`` closes such a chain, ``source`` and ``hop`` are single
nodes of a chain of processes.
"""

from __future__ import annotations

import argparse
from typing import Sequence

import rospy

from dyknow_benchmark import control_topics
from dyknow_benchmark.parts import Hop, MessageSource, Publish, Ring, payload_of


def main() -> None:
    """Set up what the command line says and stay until the node is ended."""
    parser = argparse.ArgumentParser(description="One process of a chain that is measured.")
    parser.add_argument("part", choices=["function", "rospy", "ring", "source", "hop"])
    parser.add_argument("--control", required=True, help="namespace of the control topics")
    parser.add_argument("--payload", default="time", help="time or WIDTHxHEIGHT")
    parser.add_argument("--length", type=int, default=1, help="hops of a whole chain")
    parser.add_argument("--record", type=int, nargs="*", default=[], help="hops that report")
    parser.add_argument("--hop", type=int, default=1, help="number of a single hop, from 1")
    arguments = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node(f"benchmark_{arguments.part}", anonymous=True)
    chain = Chain(arguments.control, arguments.payload, arguments.record)
    if arguments.part == "function":
        chain.add_calls(arguments.length)
    elif arguments.part == "rospy":
        chain.add_topics(range(1, arguments.length + 1))
        chain.add_source()
    elif arguments.part == "ring":
        chain.add_topics(range(1, arguments.length + 1))
        chain.add_ring(arguments.length)
    elif arguments.part == "hop":
        chain.add_topics([arguments.hop])
    else:
        chain.add_source()
    rospy.spin()


class Chain:
    """The parts of a chain that are in this process."""

    def __init__(self, control: str, payload: str, record: Sequence[int]) -> None:
        """Prepare a chain.

        Args:
            control: namespace of the control topics; the chain's own topics are there too.
            payload: ``time`` or a size of images.
            record: hops that report how long messages took.
        """
        self._control = control
        self._payload = payload_of(payload)
        self._record = frozenset(record)

    def add_calls(self, length: int) -> None:
        """Add a whole chain in which each hop calls the next."""
        publish: Publish = _drop
        for number in range(length, 0, -1):
            publish = self._hop(number, publish).receive
        control_topics.listen_send(rospy, self._control, MessageSource(publish, self._payload))

    def add_topics(self, numbers: Sequence[int]) -> None:
        """Add hops, the last first, so that each finds its listener."""
        for number in sorted(numbers, reverse=True):
            self._subscribe(number - 1, self._hop(number, self._publisher(number)).receive)

    def add_source(self) -> None:
        """Add the source."""
        source = MessageSource(self._publisher(0), self._payload)
        control_topics.listen_send(rospy, self._control, source)

    def add_ring(self, length: int) -> None:
        """Connect the end of a chain of that length to its beginning."""
        ring = Ring(self._publisher(0), self._payload)
        control_topics.listen_send(rospy, self._control, ring)
        control_topics.listen_collect(rospy, self._control, 0, ring)
        self._subscribe(length, ring.receive)

    def _publisher(self, number: int) -> Publish:
        topic = f"{self._control}/hop_{number}"
        publisher = rospy.Publisher(topic, self._payload.datatype, queue_size=10, tcp_nodelay=True)
        publish: Publish = publisher.publish
        return publish

    def _subscribe(self, number: int, receive: Publish) -> None:
        topic = f"{self._control}/hop_{number}"
        rospy.Subscriber(topic, self._payload.datatype, receive, queue_size=10, tcp_nodelay=True)

    def _hop(self, number: int, publish: Publish) -> Hop:
        hop = Hop(number, number in self._record, publish, self._payload)
        if number in self._record:
            control_topics.listen_collect(rospy, self._control, number, hop)
        return hop


def _drop(message: object) -> None:
    """Drop what the last hop forwards."""


if __name__ == "__main__":
    main()
