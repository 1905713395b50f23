"""Limits the speed of a robot's base, and stops it when nobody commands it any more."""

import copy

from geometry_msgs.msg import Twist
from std_srvs.srv import SetBool, SetBoolResponse

import dyknow


class VelocityGuard(dyknow.Nodelet):
    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.max_linear = self.nh.get_param("~max_linear", 0.5)
        self.max_angular = self.nh.get_param("~max_angular", 1.0)
        self.timeout = self.nh.Duration(self.nh.get_param("~timeout", 0.5))
        self.command = Twist()
        self.last_heard = self.nh.Time(0)
        self.locked = False
        self.safe_pub = self.nh.Publisher("safe_cmd_vel", Twist, queue_size=1)
        self.command_sub = self.nh.Subscriber("cmd_vel", Twist, self.on_command, queue_size=1)
        self.lock_srv = self.nh.Service("~lock", SetBool, self.on_lock)
        period = self.nh.Duration(1.0 / self.nh.get_param("~rate", 20))
        self.timer = self.nh.Timer(period, self.step)

    def on_command(self, command):
        command = copy.deepcopy(command)
        command.linear.x = self.limited(command.linear.x, self.max_linear)
        command.angular.z = self.limited(command.angular.z, self.max_angular)
        self.command = command
        self.last_heard = self.nh.Time.now()

    def on_lock(self, request):
        self.locked = request.data
        self.nh.logwarn("the base is %s", "locked" if request.data else "free")
        return SetBoolResponse(success=True)

    def step(self, event):
        silent = self.nh.Time.now() - self.last_heard > self.timeout
        command = Twist() if silent or self.locked else self.command
        if silent:
            self.nh.logwarn_throttle(10.0, "nobody commands the base")
        self.safe_pub.publish(command)

    @staticmethod
    def limited(speed, most):
        return max(-most, min(most, speed))
