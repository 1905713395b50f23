#!/bin/sh
# Neither rospy nor roscpp.
echo hello
