import numpy as np
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image

import dyknow

WIDTH, HEIGHT = 160, 120


class Camera(dyknow.Nodelet):
    """A simulated camera: ten images a second of a ball, unless its device is unplugged."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.device = self.nh.get_param("~device")
        self.image = self.nh.Publisher("image", Image, queue_size=1)
        self.timer = self.nh.Timer(self.nh.Duration(0.1), self.on_timer)

    def on_timer(self, event):
        if self.nh.get_param_cached("/unplugged", "") == self.device:
            return
        column = int(10 * event.current_real.to_sec()) % (WIDTH - 20)
        pixels = np.full((HEIGHT, WIDTH), 40, np.uint8)
        pixels[50:70, column : column + 20] = 200
        image = Image(height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH)
        image.header.stamp = event.current_real
        image.header.frame_id = self.device
        image.data = pixels.tobytes()
        self.image.publish(image)


class Detector(dyknow.Nodelet):
    """Finds the middle of what is bright."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.ball = self.nh.Publisher("ball", PointStamped, queue_size=1)
        self.sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=1)

    def on_image(self, image):
        pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
        rows, columns = np.nonzero(pixels > 120)
        if columns.size:
            ball = PointStamped(header=image.header)
            ball.point.x, ball.point.y = columns.mean(), rows.mean()
            self.ball.publish(ball)
