"""Finds a ball of a given colour in camera images."""

from colour_filter import centre_of_colour
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, SetBoolResponse

import dyknow


class BallFinder(dyknow.Nodelet):
    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.hue = self.nh.get_param("~hue", 25)
        self.tolerance = self.nh.get_param("~tolerance", 8)
        self.min_pixels = self.nh.get_param("~min_pixels", 20)
        self.patience = self.nh.Duration(self.nh.get_param("~patience", 0.5))
        self.enabled = True
        self.last_seen = self.nh.Time(0)
        self.ball_pub = self.nh.Publisher("ball", PointStamped, queue_size=10)
        self.visible_pub = self.nh.Publisher("ball_visible", Bool, queue_size=1, latch=True)
        self.image_sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=10)
        self.enable_srv = self.nh.Service("~enable", SetBool, self.on_enable)
        self.timer = self.nh.Timer(self.nh.Duration(0.1), self.on_timer)
        self.nh.loginfo("looking for hue %d in %s", self.hue, self.image_sub.resolved_name)

    def on_image(self, image):
        if not self.enabled:
            return
        centre, pixels = centre_of_colour(image, self.hue, self.tolerance)
        if pixels < self.min_pixels:
            self.nh.logwarn_throttle(10.0, "no ball in the image: %d pixels", pixels)
            return
        self.last_seen = self.nh.Time.now()
        ball = PointStamped(header=image.header)
        ball.point.x, ball.point.y = centre
        self.ball_pub.publish(ball)

    def on_timer(self, event):
        visible = self.nh.Time.now() - self.last_seen < self.patience
        self.visible_pub.publish(visible)

    def on_enable(self, request):
        self.enabled = request.data
        self.nh.loginfo("%s %s", self.nh.get_name(), "enabled" if self.enabled else "disabled")
        return SetBoolResponse(success=True)
