"""What the ball finder does with an image; it knows nothing of nodes or nodelets."""

import cv2
import numpy as np


def centre_of_colour(image, hue, tolerance):
    """Where a colour is in an image.

    Args:
        image: sensor_msgs/Image, bgr8.
        hue: of the colour, 0 to 179 as in OpenCV.
        tolerance: how far a pixel's hue may be from that.

    Returns:
        The mean position (x, y) of the pixels of that colour, and their number.
    """
    pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
    hsv = cv2.cvtColor(pixels, cv2.COLOR_BGR2HSV)
    lowest, highest = (hue - tolerance, 150, 100), (hue + tolerance, 255, 255)
    ys, xs = np.nonzero(cv2.inRange(hsv, lowest, highest))
    if len(xs) == 0:
        return (0.0, 0.0), 0
    return (float(xs.mean()), float(ys.mean())), len(xs)
