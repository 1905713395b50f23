#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A stream's client as a separate process: prints each state, and whether messages arrive.

It ends on request. Arguments: the tag, and optionally the lease in seconds.
"""

from __future__ import annotations

import sys
import time

import rospy
from std_msgs.msg import Header

import dyknow
from dyknow.ros.acquiring import LEASE

#: Seconds without a message after which the stream is reported as still.
PATIENCE = 1.0

rospy.init_node("stream_client", anonymous=True)
lease = float(sys.argv[2]) if len(sys.argv) > 2 else LEASE
with dyknow.acquire(sys.argv[1], Header, lease=lease) as stream:
    arrived = [0.0]
    rospy.Subscriber(
        stream.topic, Header, lambda message: arrived.__setitem__(0, time.monotonic())
    )
    said = None
    while not rospy.is_shutdown():
        flows = time.monotonic() - arrived[0] < PATIENCE
        news = f"{stream.state.name} {stream.topic} {'flows' if flows else 'still'}"
        if news != said:
            print(news, stream.detail, flush=True)
            said = news
        time.sleep(0.05)
