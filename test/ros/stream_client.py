#!/usr/bin/env python3
"""A client of a stream as a process of its own: says each state, until it is told to end."""

from __future__ import annotations

import sys

import rospy

import dyknow

rospy.init_node("stream_client", anonymous=True)
with dyknow.acquire(sys.argv[1]) as stream:
    state = None
    while not rospy.is_shutdown():
        if stream.state is not state:
            state = stream.state
            print(state.name, stream.topic, stream.detail, flush=True)
        rospy.sleep(0.05)
