#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""An outside node: `peer.py COMMAND ARGUMENT...`, with the functions below as commands.

rospy calls a listener on a thread for each connection, so each line is printed in a single write.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any, Callable

import rospy
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.transport import OUTBOUND
from sensor_msgs.msg import Image
from std_msgs.msg import Header

import dyknow

#: Seconds without a message after which a stream is reported as still.
PATIENCE = 1.0
_printing = threading.Lock()


def say(*words: object) -> None:
    line = " ".join(map(str, words))
    with _printing:
        print(line)


def talk(rate: str, *topics: str) -> None:
    """Publish headers, numbered, each number on every topic, the topics in turn."""
    # Without a queue: publishing sends at once, so the topics keep in step.
    publishers = [rospy.Publisher(topic, Header, queue_size=None) for topic in topics]
    number = 0
    due = time.monotonic()
    while not rospy.is_shutdown():
        for topic, publisher in zip(topics, publishers):
            publisher.publish(Header(seq=number, frame_id=topic))
        number += 1
        due += 1.0 / float(rate)
        time.sleep(max(0.0, due - time.monotonic()))


def hesitate(seconds: str, rate: str, *topics: str) -> None:
    """Talk, but pause between the greeting of a subscriber and sending to it."""
    greet = TCPROSTransport.write_header

    def greet_and_pause(transport: TCPROSTransport) -> None:
        greet(transport)
        if transport.direction == OUTBOUND:
            time.sleep(float(seconds))

    TCPROSTransport.write_header = greet_and_pause
    talk(rate, *topics)


def hear(topics: Any, kind: Any, note: Callable[[Any, str], object], **options: Any) -> None:
    """Note the messages of topics until the end."""
    for topic in topics:
        rospy.Subscriber(topic, kind, note, topic, **options)
    rospy.spin()


def listen(*topics: str) -> None:
    """Print "TOPIC NUMBER" for each header."""
    hear(topics, Header, lambda header, topic: say(topic, header.seq))


def doze(seconds: str, *topics: str) -> None:
    """Sleep after each header; lost connections are not noticed meanwhile."""

    def note(header: Header, topic: str) -> None:
        say(topic, header.seq)
        time.sleep(float(seconds))

    hear(topics, Header, note, queue_size=1)


def watch(*topics: str) -> None:
    """Print the height and the number of bytes of each image."""

    def note(image: Image, topic: str) -> None:
        say(topic, image.height, len(image.data))

    hear(topics, Image, note, buff_size=1 << 24)


def claim(tag: str, lease: str = "") -> None:
    """Hold a stream, and print its state, and whether messages come, whenever that changes."""
    options = {"lease": float(lease)} if lease else {}
    with dyknow.acquire(tag, Header, **options) as stream:
        arrived = [0.0]
        rospy.Subscriber(
            stream.topic, Header, lambda message: arrived.__setitem__(0, time.monotonic())
        )
        said = None
        while not rospy.is_shutdown():
            flows = time.monotonic() - arrived[0] < PATIENCE
            news = f"{stream.state.name} {stream.topic} {'flows' if flows else 'still'}"
            if news != said:
                say(news, stream.detail)
                said = news
            time.sleep(0.05)


def bond(topic: str, *bond_ids: str) -> None:
    """Be the other end of bonds, made with python3-bondpy; SIGINT breaks them from this side."""
    from bondpy.bondpy import Bond  # other commands need not wait for it

    def part() -> None:
        for each in bonds:
            each.break_bond()
        for each in bonds:  # rospy may drop queued messages when it ends
            each.wait_until_broken(rospy.Duration(5))

    bonds = [
        Bond(topic, each, lambda b=each: say("broken", b), lambda b=each: say("formed", b))
        for each in bond_ids
    ]
    rospy.on_shutdown(part)
    for each in bonds:
        each.start()
    rospy.spin()


COMMANDS = {each.__name__: each for each in (bond, claim, doze, hesitate, listen, talk, watch)}

if __name__ == "__main__":
    sys.stdout.reconfigure(line_buffering=True)
    rospy.init_node("peer", anonymous=True)
    command, *arguments = rospy.myargv()[1:]
    COMMANDS[command](*arguments)
