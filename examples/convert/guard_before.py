#!/usr/bin/env python3
"""Limits the speed of a robot's base, and stops it when nobody commands it any more."""

import threading

import rospy
from geometry_msgs.msg import Twist
from std_srvs.srv import SetBool, SetBoolResponse


class VelocityGuard:
    def __init__(self):
        self.max_linear = rospy.get_param("~max_linear", 0.5)
        self.max_angular = rospy.get_param("~max_angular", 1.0)
        self.timeout = rospy.Duration(rospy.get_param("~timeout", 0.5))
        self.rate = rospy.Rate(rospy.get_param("~rate", 20))
        self.lock = threading.Lock()
        self.command = Twist()
        self.last_heard = rospy.Time(0)
        self.locked = False
        self.safe_pub = rospy.Publisher("safe_cmd_vel", Twist, queue_size=1)
        self.command_sub = rospy.Subscriber("cmd_vel", Twist, self.on_command, queue_size=1)
        self.lock_srv = rospy.Service("~lock", SetBool, self.on_lock)

    def on_command(self, command):
        command.linear.x = self.limited(command.linear.x, self.max_linear)
        command.angular.z = self.limited(command.angular.z, self.max_angular)
        with self.lock:
            self.command = command
            self.last_heard = rospy.Time.now()

    def on_lock(self, request):
        with self.lock:
            self.locked = request.data
        rospy.logwarn("the base is %s", "locked" if request.data else "free")
        return SetBoolResponse(success=True)

    def step(self):
        with self.lock:
            silent = rospy.Time.now() - self.last_heard > self.timeout
            command = Twist() if silent or self.locked else self.command
        if silent:
            rospy.logwarn_throttle(10.0, "nobody commands the base")
        self.safe_pub.publish(command)

    def run(self):
        while not rospy.is_shutdown():
            self.step()
            self.rate.sleep()

    @staticmethod
    def limited(speed, most):
        return max(-most, min(most, speed))


if __name__ == "__main__":
    rospy.init_node("velocity_guard")
    VelocityGuard().run()
