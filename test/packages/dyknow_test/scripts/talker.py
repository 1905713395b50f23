#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Written as many are: it knows nothing of DyKnow."""

import argparse
import contextlib
import sys

import rospy
from script_sibling import Word
from std_msgs.msg import String

publisher = rospy.Publisher("words", String, queue_size=1000)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--word", default="hello")
    options = parser.parse_args(rospy.myargv(sys.argv)[1:])
    rospy.init_node("talker", anonymous=True)
    rospy.on_shutdown(lambda: publisher.publish("good-bye"))
    rate = rospy.Rate(rospy.get_param("~rate", 50))
    number = 0
    while not rospy.is_shutdown():
        publisher.publish(str(Word(rospy.get_param("~word", options.word), number)))
        number += 1
        rate.sleep()


if __name__ == "__main__":
    with contextlib.suppress(rospy.ROSInterruptException):
        main()
