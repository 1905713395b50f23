#!/usr/bin/env python3
"""Tells in which direction of the camera a ball is, from its place in the image."""

import message_filters
import rospy
from geometry_msgs.msg import PointStamped, Vector3Stamped
from sensor_msgs.msg import CameraInfo


class BallBearing:
    def __init__(self):
        self.distortion_warned = False
        self.count = 0
        self.started = rospy.get_time()
        self.bearing_pub = rospy.Publisher("bearing", Vector3Stamped, queue_size=10)
        ball_sub = message_filters.Subscriber("ball", PointStamped, queue_size=10)
        info_sub = message_filters.Subscriber("camera_info", CameraInfo, queue_size=10)
        self.pairs = message_filters.TimeSynchronizer([ball_sub, info_sub], 10)
        self.pairs.registerCallback(self.on_pair)
        rospy.on_shutdown(self.report)
        rospy.loginfo("%s is ready", rospy.get_name())

    def on_pair(self, ball, info):
        if any(info.D) and not self.distortion_warned:
            rospy.logwarn("the image of %s is distorted", info.header.frame_id)
            self.distortion_warned = True
        focal_x, centre_x, focal_y, centre_y = info.K[0], info.K[2], info.K[4], info.K[5]
        if not focal_x or not focal_y:
            rospy.logerr_throttle(10.0, "the camera %s is not calibrated", info.header.frame_id)
            return
        bearing = Vector3Stamped(header=ball.header)
        bearing.vector.x = (ball.point.x - centre_x) / focal_x
        bearing.vector.y = (ball.point.y - centre_y) / focal_y
        bearing.vector.z = 1.0
        self.bearing_pub.publish(bearing)
        self.count += 1

    def report(self):
        rospy.loginfo("%d bearings in %.1f s", self.count, rospy.get_time() - self.started)


if __name__ == "__main__":
    rospy.init_node("ball_bearing")
    BallBearing()
    rospy.spin()
