from my_nodelets.scale import Scale
from std_msgs.msg import Float64

PORTS = {"in": "/numbers", "out": "/scaled"}


def test_it_multiplies(nodelet_harness):
    """In this process, without a ROS master: quick, and the same every time."""
    nodelet_harness.load(Scale, ports=PORTS, parameters={"factor": 3.0})
    scaled = nodelet_harness.listen("/scaled")
    for number in (1.0, 2.0):
        nodelet_harness.publish("/numbers", Float64(number))
    nodelet_harness.drain()
    assert scaled == [Float64(3.0), Float64(6.0)]


def test_it_is_declared_and_works_in_a_nodelet_manager(ros_harness):
    """In a process of its own, with a ROS master of the tests."""
    ros_harness.load("my_nodelets/Scale", ports=PORTS, parameters={"factor": 3.0})
    scaled = ros_harness.listen("/scaled", Float64)
    ros_harness.publish("/numbers", Float64(2.0))
    ros_harness.wait_until(lambda: scaled == [Float64(6.0)])
