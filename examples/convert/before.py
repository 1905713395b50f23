#!/usr/bin/env python3
"""Finds a ball of a given colour in camera images."""

import rospy
from colour_filter import centre_of_colour
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, SetBoolResponse


class BallFinder:
    def __init__(self):
        self.hue = rospy.get_param("~hue", 25)
        self.tolerance = rospy.get_param("~tolerance", 8)
        self.min_pixels = rospy.get_param("~min_pixels", 20)
        self.patience = rospy.Duration(rospy.get_param("~patience", 0.5))
        self.enabled = True
        self.last_seen = rospy.Time(0)
        self.ball_pub = rospy.Publisher("ball", PointStamped, queue_size=10)
        self.visible_pub = rospy.Publisher("ball_visible", Bool, queue_size=1, latch=True)
        self.image_sub = rospy.Subscriber("image", Image, self.on_image, queue_size=10)
        self.enable_srv = rospy.Service("~enable", SetBool, self.on_enable)
        self.timer = rospy.Timer(rospy.Duration(0.1), self.on_timer)
        rospy.loginfo("looking for hue %d in %s", self.hue, self.image_sub.resolved_name)

    def on_image(self, image):
        if not self.enabled:
            return
        centre, pixels = centre_of_colour(image, self.hue, self.tolerance)
        if pixels < self.min_pixels:
            rospy.logwarn_throttle(10.0, "no ball in the image: %d pixels", pixels)
            return
        self.last_seen = rospy.Time.now()
        ball = PointStamped(header=image.header)
        ball.point.x, ball.point.y = centre
        self.ball_pub.publish(ball)

    def on_timer(self, event):
        visible = rospy.Time.now() - self.last_seen < self.patience
        self.visible_pub.publish(visible)

    def on_enable(self, request):
        self.enabled = request.data
        rospy.loginfo("%s %s", rospy.get_name(), "enabled" if self.enabled else "disabled")
        return SetBoolResponse(success=True)


if __name__ == "__main__":
    rospy.init_node("ball_finder")
    BallFinder()
    rospy.spin()
