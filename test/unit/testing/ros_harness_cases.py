# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The harness with a ROS master; run by test_harness.py in a process that becomes a node."""

from __future__ import annotations

import os
import time

import pytest
import rosgraph
import rospy
from rospy.impl import tcpros_pubsub
from std_msgs.msg import Header, String

from dyknow.errors import DyKnowError, UnknownPort
from dyknow.testing import RosHarness, RosTestCase

BOTH = {"in": "/in", "out": "/out"}


@pytest.fixture(scope="module", name="harness")
def _harness():
    with RosHarness() as harness:
        yield harness


def test_messages_pass(harness):
    name = harness.load("dyknow/Relay", "/relay", BOTH)
    assert (name, harness.topics(name)) == ("/relay", BOTH)
    got = harness.listen("/out", Header)
    for number in range(3):
        harness.publish("/in", Header(frame_id=str(number)))
    harness.wait_until(lambda: [each.frame_id for each in got] == ["0", "1", "2"])


def test_messages_pass_when_connecting_takes_time(harness, monkeypatch):
    """rospy counts the connection of a subscriber before a thread makes it."""

    def connect_late(*args):
        time.sleep(0.5)
        connect(*args)

    connect = tcpros_pubsub.robust_connect_subscriber
    monkeypatch.setattr(tcpros_pubsub, "robust_connect_subscriber", connect_late)
    harness.load("dyknow/Relay", "/late", ports={"in": "/early", "out": "/late_out"})
    inputs, outputs = harness.listen("/early", Header), harness.listen("/late_out", Header)
    harness.publish("/early", Header(frame_id="first"))
    harness.wait_until(lambda: len(inputs) == len(outputs) == 1, 5.0)


def test_ports_are_connected_elsewhere(harness):
    name = harness.load("dyknow/Relay", "/moved", ports=BOTH)
    harness.connect(name, {"in": "/other", "out": ""})
    assert harness.topics(name) == {"in": "/other", "out": ""}
    with pytest.raises(DyKnowError, match="unknown port 'inn'"):
        harness.connect(name, {"inn": "/other"})


def test_relative_topics_are_those_of_the_nodelets_namespace(harness):
    name = harness.load("dyknow/Relay", "/robot/relay", ports={"in": "numbers", "out": ""})
    assert harness.topics(name) == {"in": "/robot/numbers", "out": ""}


def test_what_cannot_be_loaded_says_why(harness):
    with pytest.raises(rospy.ServiceException, match="nowhere/Nothing"):
        harness.load("nowhere/Nothing")
    with pytest.raises(UnknownPort):
        harness.load("dyknow/Relay", "/misnamed", ports={"inn": "/in"})
    name = harness.load("dyknow/Relay", "/misnamed", ports={"in": "", "out": "/out"})
    assert harness.topics(name) == {"in": "", "out": "/out"}


def test_what_does_not_come_true_tells_what_the_nodelet_manager_printed(harness):
    harness.load("dyknow/Sink", "/sink", ports={"in": "/in"}, parameters={"period": 0.05})
    harness.wait_until(lambda: "0 messages" in harness.output)
    with pytest.raises(AssertionError, match=r"(?s)not within 0.1 s: a wonder.*0 messages"):
        harness.wait_until(lambda: False, 0.1, "a wonder")


def test_a_nodelet_that_is_unloaded_is_gone(harness):
    for _ in range(2):
        name = harness.load("dyknow/Relay", "/brief", ports=BOTH)
        harness.unload(name)


def test_parameters_are_set_and_nothing_is_left_of_a_harness():
    with RosHarness() as first, RosHarness() as second:
        ports = {"in": "/text", "out": "/texts"}
        first.load("dyknow/Relay", "/one", ports, {"~datatype": "std_msgs/String"})
        got = first.listen("/texts", String)
        second.load("dyknow/Relay", "/two")
        first.publish("/text", String("hello"))
        first.wait_until(lambda: got == [String("hello")])
        assert {first.manager, second.manager} <= _nodes()
    assert not {"/one", "/two", first.manager, second.manager} & _nodes()
    assert not rospy.has_param("/one/datatype")


def test_what_crashed_holds_up_no_later_test():
    with RosHarness() as crashed:
        crashed.load("dyknow/Relay", "/one", BOTH)
        crashed._process.kill()
        with pytest.raises(AssertionError):
            crashed.wait_until(lambda: False)
    assert not {"/one", crashed.manager} & _nodes()


def _nodes():
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    return {node for part in state for _, owners in part for node in owners}


def test_the_master_is_the_tests_own(harness):
    assert os.environ["ROS_MASTER_URI"] != "http://nobody.invalid:11311"


class UnittestsHaveIt(RosTestCase):
    def test_each_test_has_a_harness(self):
        self.assertEqual(self.harness.topics(self.harness.load("dyknow/Sink")), {"in": ""})
