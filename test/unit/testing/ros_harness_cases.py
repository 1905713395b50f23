"""The harness with a ROS master; run by test_ros_harness.py in a process that becomes a node."""

from __future__ import annotations

import os

import pytest
import rosgraph
import rospy
from std_msgs.msg import Header, String

from dyknow.errors import DyKnowError, UnknownPort
from dyknow.testing import RosHarness, RosTestCase
from dyknow.testing.fixtures import ros_harness

__all__ = ["ros_harness"]

BOTH = {"in": "/in", "out": "/out"}


def test_messages_pass(ros_harness):
    name = ros_harness.load("dyknow/Relay", "/relay", BOTH)
    assert (name, ros_harness.topics(name)) == ("/relay", BOTH)
    got = ros_harness.listen("/out", Header)
    for number in range(3):
        ros_harness.publish("/in", Header(frame_id=str(number)))
    ros_harness.wait_until(lambda: [each.frame_id for each in got] == ["0", "1", "2"])


def test_parameters_are_set_and_deleted():
    with RosHarness() as harness:
        harness.load("dyknow/Relay", "/relay", BOTH, {"~datatype": "std_msgs/String"})
        got = harness.listen("/out", String)
        harness.publish("/in", String("text"))
        harness.wait_until(lambda: got == [String("text")])
    assert not rospy.has_param("/relay/datatype")


def test_ports_are_connected_elsewhere(ros_harness):
    name = ros_harness.load("dyknow/Relay", ports=BOTH)
    ros_harness.connect(name, {"in": "/other", "out": ""})
    assert ros_harness.topics(name) == {"in": "/other", "out": ""}
    with pytest.raises(DyKnowError, match="unknown port 'inn'"):
        ros_harness.connect(name, {"inn": "/other"})


def test_what_cannot_be_loaded_says_why(ros_harness):
    with pytest.raises(rospy.ServiceException, match="nowhere/Nothing"):
        ros_harness.load("nowhere/Nothing")
    with pytest.raises(UnknownPort):
        ros_harness.load("dyknow/Relay", ports={"inn": "/in"})


def test_what_does_not_come_true_tells_what_the_nodelet_manager_printed(ros_harness):
    ros_harness.load("dyknow/Sink", ports={"in": "/in"}, parameters={"period": 0.05})
    ros_harness.wait_until(lambda: "0 messages" in ros_harness.output)
    with pytest.raises(AssertionError, match=r"(?s)not within 0.1 s: a wonder.*0 messages"):
        ros_harness.wait_until(lambda: False, 0.1, "a wonder")


def test_a_nodelet_that_is_unloaded_is_gone(ros_harness):
    name = ros_harness.load("dyknow/Relay", ports=BOTH)
    ros_harness.unload(name)
    ros_harness.load("dyknow/Relay", ports=BOTH)


def test_nothing_is_left_of_a_harness():
    with RosHarness() as first, RosHarness() as second:
        first.load("dyknow/Relay", "/one")
        second.load("dyknow/Relay", "/two")
        assert first.manager != second.manager
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    nodes = {node for part in state for _, owners in part for node in owners}
    assert nodes == {rospy.get_name()}


def test_the_master_is_the_tests_own():
    with RosHarness():
        assert os.environ["ROS_MASTER_URI"] != "http://nobody.invalid:11311"


class UnittestsHaveIt(RosTestCase):
    def test_each_test_has_a_harness(self):
        self.assertEqual(self.harness.topics(self.harness.load("dyknow/Sink")), {"in": ""})
