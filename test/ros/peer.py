#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""An outside node: `peer.py talk RATE TOPIC...`, `listen TOPIC...`, `doze SECONDS TOPIC...`.

A talker publishes headers, numbered, each number on every topic, the topics in turn. A hesitant
one does the same, but pauses between its greeting of a subscriber and sending to it. A listener
prints "TOPIC NUMBER" for each header, and the number of bytes for each image; a dozer sleeps after
each header, and does not notice lost connections meanwhile. rospy calls it on a thread for each
connection, so each line is printed in a single write.
"""

from __future__ import annotations

import sys
import threading
import time

import rospy
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.transport import OUTBOUND
from sensor_msgs.msg import Image
from std_msgs.msg import Header

_printing = threading.Lock()


def say(*words: object) -> None:
    line = " ".join(map(str, words))
    with _printing:
        print(line)


def talk(rate: str, *topics: str) -> None:
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
    greet = TCPROSTransport.write_header

    def greet_and_pause(transport: TCPROSTransport) -> None:
        greet(transport)
        if transport.direction == OUTBOUND:
            time.sleep(float(seconds))

    TCPROSTransport.write_header = greet_and_pause
    talk(rate, *topics)


def listen(*topics: str) -> None:
    def note(message: Header, topic: str) -> None:
        say(topic, message.seq)

    for topic in topics:
        rospy.Subscriber(topic, Header, note, topic)
    rospy.spin()


def doze(seconds: str, *topics: str) -> None:
    def note(message: Header, topic: str) -> None:
        say(topic, message.seq)
        time.sleep(float(seconds))

    for topic in topics:
        rospy.Subscriber(topic, Header, note, topic, queue_size=1)
    rospy.spin()


def watch(*topics: str) -> None:
    def note(message: Image, topic: str) -> None:
        say(topic, message.height, len(message.data))

    for topic in topics:
        rospy.Subscriber(topic, Image, note, topic, buff_size=1 << 24)
    rospy.spin()


if __name__ == "__main__":
    sys.stdout.reconfigure(line_buffering=True)
    rospy.init_node("peer", anonymous=True)
    command, *arguments = rospy.myargv()[1:]
    {"doze": doze, "hesitate": hesitate, "listen": listen, "talk": talk, "watch": watch}[command](
        *arguments
    )
