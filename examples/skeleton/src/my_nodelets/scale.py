"""The nodelet my_nodelets/Scale."""

from std_msgs.msg import Float64

import dyknow


class Scale(dyknow.Nodelet):
    """Multiplies numbers by ~factor (double, 1)."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.factor = self.nh.get_param("~factor", 1.0)
        self.pub = self.nh.Publisher("out", Float64, queue_size=10)
        self.sub = self.nh.Subscriber("in", Float64, self.on_number, queue_size=10)

    def on_number(self, number):
        self.pub.publish(number.data * self.factor)
