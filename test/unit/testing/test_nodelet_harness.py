# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The harness without a ROS master, used as authors of nodelets use it."""

from __future__ import annotations

import unittest

import numpy as np
import pytest
import rospy
from rospy.numpy_msg import numpy_msg
from std_msgs.msg import Int32, Int32MultiArray
from std_srvs.srv import SetBool, SetBoolRequest, Trigger, TriggerRequest, TriggerResponse

import dyknow
from dyknow.errors import InvalidConfiguration, LoadFailed, NameTaken, UnknownPort
from dyknow.testing import CallbackFailed, LogEntry, NodeletHarness, NodeletTestCase


class Multiplier(dyknow.Nodelet):
    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.factor = self.nh.get_param("~factor", 2)
        self.topics = []
        self.ended = False
        self.pub = self.nh.Publisher("out", Int32, queue_size=10)
        self.sub = self.nh.Subscriber("in", Int32, self.on_number, queue_size=10)
        self.nh.set_reconfigure_callback(lambda *maps: self.topics.append(maps))
        self.nh.Service("~reset", Trigger, self.on_reset)
        self.nh.Service("~fail", Trigger, lambda request: 1 / 0)

    def on_number(self, number):
        if number.data < 0:
            raise ValueError(f"{number.data} is negative")
        self.pub.publish(number.data * self.factor)

    def on_reset(self, request):
        self.factor = 1
        return TriggerResponse(success=True, message="reset")

    def on_shutdown(self):
        self.ended = True


class Ticking(dyknow.Nodelet):
    """Publishes the time at a rate."""

    def on_init(self):
        self.times = []
        self.nh = dyknow.NodeHandle(self.private_node_handle)
        self.pub = self.nh.Publisher("time", Int32, queue_size=1, latch=True)
        self.pub.publish(data=1)
        self.timer = self.nh.Timer(self.nh.Duration(0.1), self.on_timer)

    def on_timer(self, event):
        assert event.current_real == self.nh.Time.now()
        self.times.append(round(self.nh.get_time(), 6))


class Namesakes(dyknow.Nodelet):
    """Its ports have the names of a parameter and of a service."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.factor = self.nh.get_param("~factor")
        self.nh.Subscriber("factor", Int32, print)
        dyknow.NodeHandle(self.private_node_handle).Subscriber("reset", Int32, print)
        self.nh.Service("~reset", Trigger, lambda request: (True, ""))


class FailingAtTheEnd(dyknow.Nodelet):
    def on_init(self):
        pass

    def on_shutdown(self):
        raise ValueError("no end")


class EndsBadly(NodeletTestCase):
    __test__ = False  # but run by a test

    def test(self):
        self.harness.load(FailingAtTheEnd)


@pytest.fixture(name="harness")
def _harness():
    with NodeletHarness() as harness:
        yield harness


class TestMessages:
    def test_chains_are_drained_whole_and_only_by_drain(self, harness):
        for number in range(5):
            ports = {"in": f"/t{number}", "out": f"/t{number + 1}"}
            harness.load(Multiplier, f"/n{number}", ports)
        got = harness.listen("/t5")
        harness.publish("/t0", Int32(1))
        assert got == []
        harness.drain()
        assert got == [Int32(32)]

    def test_a_callback_that_raises_fails_the_test_with_its_traceback(self, harness):
        harness.load(Multiplier, ports={"in": "/numbers"})
        # The second one too, which the log leaves out.
        for text in (r"(?s)in on_number.*ValueError: -1 is negative", "1 callbacks raised"):
            harness.publish("/numbers", Int32(-1))
            with pytest.raises(CallbackFailed, match=text):
                harness.drain()
        harness.drain()

    def test_a_callback_that_raises_during_a_call_fails_the_test(self, harness):
        harness.load(Multiplier, ports={"in": "/numbers"})
        harness.publish("/numbers", Int32(-1))
        with pytest.raises(CallbackFailed, match="-1 is negative"):
            harness.call("/nodelet/reset", TriggerRequest())

    def test_an_error_of_a_handler_hides_none_of_a_callback(self, harness):
        harness.load(Multiplier, ports={"in": "/numbers"})
        harness.publish("/numbers", Int32(-1))
        with pytest.raises(CallbackFailed):
            harness.drain()
        harness.publish("/numbers", Int32(-1))
        with pytest.raises(ZeroDivisionError):
            harness.call("/nodelet/fail", TriggerRequest())
        with pytest.raises(CallbackFailed, match="1 callbacks raised, as before"):
            harness.drain()

    def test_an_error_at_the_end_fails_the_test_unless_another_did(self):
        for error, expected in ((None, CallbackFailed), (KeyError, KeyError)):
            with pytest.raises(expected), NodeletHarness() as harness:
                harness.load(FailingAtTheEnd)
                if error is not None:
                    raise error
        result = unittest.TestResult()
        EndsBadly("test")(result)
        assert "no end" in result.failures[0][1]

    def test_a_subscriber_of_any_type_gets_serialised_messages(self, harness):
        got, listened = [], harness.listen("/numbers")
        nodelet = harness.load(Multiplier)
        nodelet.nh.Subscriber("any", rospy.AnyMsg, got.append)
        harness.connect(nodelet, {"any": "/numbers"})
        harness.publish("/numbers", Int32(7))
        harness.drain()
        assert [(type(each), each._buff) for each in got] == [(rospy.AnyMsg, b"\x07\0\0\0")]
        assert got[0]._connection_header["type"] == "std_msgs/Int32"
        assert listened == [Int32(7)]


class TestPorts:
    def test_a_port_that_is_not_there(self, harness):
        with pytest.raises(UnknownPort, match="unknown port 'inn'; known ports: in, out"):
            harness.load(Multiplier, ports={"inn": "/numbers"})
        nodelet = harness.load(Multiplier)
        with pytest.raises(InvalidConfiguration, match="unknown port 'inn'"):
            harness.connect(nodelet, {"inn": "/numbers"})

    def test_a_parameter_and_a_service_may_have_the_name_of_a_port(self, harness):
        ports = {"factor": "/factors", "reset": "/resets"}
        nodelet = harness.load(Namesakes, ports=ports, parameters={"factor": 3})
        assert harness.topics(nodelet) == ports
        assert nodelet.factor == 3
        assert harness.call("/nodelet/reset", TriggerRequest()).success

    def test_relative_topics_are_those_of_the_nodelets_namespace(self, harness):
        nodelet = harness.load(Multiplier, "/ns/n", {"in": "numbers"})
        assert harness.topics(nodelet)["in"] == "/ns/numbers"

    def test_an_empty_topic_leaves_one_disconnected(self, harness):
        nodelet = harness.load(Multiplier, ports={"in": "", "out": "/out"})
        assert harness.topics(nodelet) == {"in": "", "out": "/out"}

    def test_connect_moves_them_and_tells_the_nodelet(self, harness):
        nodelet = harness.load(Multiplier, ports={"in": "/numbers"})
        harness.connect(nodelet, {"in": "/others", "out": "/doubled"})
        got = harness.listen("/doubled")
        harness.publish("/numbers", Int32(1))
        harness.publish("/others", Int32(2))
        harness.drain()
        assert got == [Int32(4)]
        assert nodelet.topics == [({"in": "/others"}, {"out": "/doubled"})]


class TestLife:
    def test_parameters(self, harness):
        assert harness.load(Multiplier, "/other", parameters={"factor": 3}).factor == 3
        assert harness.parameters == {"/other/factor": 3}
        nodelet = harness.load(Multiplier, parameters={"gains/p": 1, "gains/i": 2})
        assert nodelet.nh.get_param("~gains") == {"p": 1, "i": 2}

    def test_parameters_are_a_tree_as_at_the_master(self, harness):
        nh = harness.load(Multiplier, parameters={"gains": {"p": 1, "limits": {"low": 0}}}).nh
        assert nh.get_param("~gains/p") == 1 and nh.has_param("~gains/limits")
        nh.set_param("~gains/limits/high", 9)
        assert nh.get_param("~gains") == {"p": 1, "limits": {"low": 0, "high": 9}}
        nh.delete_param("~gains/limits")
        with pytest.raises(KeyError):
            nh.get_param("~gains/limits")
        assert harness.parameters == {"/nodelet/gains/p": 1}
        nh.set_param("~gains", {"d": 2})
        assert nh.get_param("/nodelet") == {"gains": {"d": 2}}
        nh.set_param("~gains", 5)
        assert nh.get_param("~gains") == 5 and not nh.has_param("~gains/d")
        nh.get_param("/")["nodelet"].clear()
        assert harness.parameters == {"/nodelet/gains": 5}

    def test_a_parameter_may_be_an_empty_dictionary(self, harness):
        nh = harness.load(Multiplier, parameters={"gains": {}, "factor": 2}).nh
        nh.set_param("~limits", {"low": {}})
        assert nh.get_param("~") == {"gains": {}, "factor": 2, "limits": {"low": {}}}
        nh.delete_param("~limits/low")
        assert nh.get_param("~limits") == {}

    def test_what_on_init_raises_fails_the_load(self, harness):
        class Broken(dyknow.Nodelet):
            def on_init(self):
                raise ValueError("no camera")

        with pytest.raises(LoadFailed, match="no camera"):
            harness.load(Broken)
        harness.load(Multiplier)
        with pytest.raises(NameTaken):
            harness.load(Multiplier)

    def test_unload(self, harness):
        nodelet = harness.load(Multiplier, ports={"in": "/numbers", "out": "/doubled"})
        harness.unload(nodelet)
        assert nodelet.ended
        with pytest.raises(rospy.ROSException):
            nodelet.pub.publish(1)
        harness.load(Multiplier)

    def test_the_log_and_the_members_that_need_ros(self, harness):
        nodelet = harness.load(Multiplier)
        nodelet.nh.logwarn("%s of %d", "one", 2)
        nodelet.nh.loginfo_throttle(5.0, "again")
        nodelet.nh.loginfo("%(count)d of 100 %%", {"count": 3})
        nodelet.nh.loginfo(msg="named")
        nodelet.nh.logerr_throttle(period=5.0, msg="named, too")
        texts = [("warn", "one of 2"), ("info", "again"), ("info", "3 of 100 %")]
        texts += [("info", "named"), ("err", "named, too")]
        assert harness.log == [LogEntry(*each) for each in texts]
        with pytest.raises(AttributeError, match=r"no 'sleep' without ROS; .* RosHarness"):
            nodelet.nh.sleep(1.0)


class TestServices:
    def test_a_service_answers(self, harness):
        nodelet = harness.load(Multiplier, "/twice")
        answer = harness.call("/twice/reset", TriggerRequest())
        assert answer == TriggerResponse(success=True, message="reset")
        assert nodelet.factor == 1

    def test_what_a_handler_raises_is_raised_once(self, harness):
        harness.load(Multiplier)
        with pytest.raises(ZeroDivisionError):
            harness.call("/nodelet/fail", TriggerRequest())
        harness.drain()

    def test_a_service_that_is_not_there_is_not_waited_for(self, harness):
        with pytest.raises(rospy.ServiceException, match="unavailable"):
            harness.call("/nobody", TriggerRequest())
        nodelet = harness.load(Multiplier)
        with pytest.raises(rospy.ROSException, match="'/nobody' is not offered"):
            nodelet.nh.wait_for_service("nobody")

    def test_nodelets_call_each_other(self, harness):
        class Caller(dyknow.Nodelet):
            def on_init(self):
                self.nh = dyknow.NodeHandle(self.node_handle)
                self.nh.wait_for_service("multiplier/reset")
                self.reset = self.nh.ServiceProxy("multiplier/reset", Trigger)
                self.nh.Service("~switch", SetBool, self.on_switch)

            def on_switch(self, request):
                return request.data, self.reset().message

        harness.load(Multiplier, "/multiplier")
        harness.load(Caller, "/caller")
        answer = harness.call("/caller/switch", SetBoolRequest(data=True))
        assert (answer.success, answer.message) == (True, "reset")

    def test_what_a_handler_raises_is_a_service_exception_to_a_nodelet(self, harness):
        fail = harness.load(Multiplier).nh.ServiceProxy("~fail", Trigger)
        with pytest.raises(rospy.ServiceException, match="division by zero"):
            fail()
        harness.drain()


class Counted(Int32MultiArray):
    """A class that an author has derived."""


LISTS, ARRAYS = Int32MultiArray, numpy_msg(Int32MultiArray)
ARRAY = ARRAYS(data=np.array([1, 2], np.int32))


@pytest.mark.parametrize("order", ["in out", "out in"])
@pytest.mark.parametrize(
    ("published", "message", "received", "arrives_as"),
    [
        pytest.param(LISTS, LISTS(data=[1, 2]), ARRAYS, ARRAYS, id="arrays are wanted"),
        pytest.param(ARRAYS, ARRAY, LISTS, LISTS, id="lists are wanted"),
        pytest.param(LISTS, ARRAY, LISTS, LISTS, id="lists are declared"),
        pytest.param(LISTS, Counted(data=[1, 2]), LISTS, Counted, id="derived"),
        pytest.param(ARRAYS, ARRAY, ARRAYS, ARRAYS, id="one class"),
    ],
)
def test_messages_of_one_type_may_have_two_classes(
    harness, order, published, message, received, arrives_as
):
    """As rospy.numpy_msg makes them; what has the class that is wanted passes by reference."""

    class Sender(dyknow.Nodelet):
        def on_init(self):
            self.nh = dyknow.NodeHandle(self.node_handle)
            self.pub = self.nh.Publisher("out", published, queue_size=1)

    class Receiver(dyknow.Nodelet):
        def on_init(self):
            self.got = []
            self.nh = dyknow.NodeHandle(self.node_handle)
            self.nh.Subscriber("in", received, self.got.append)

    for port in order.split():
        if port == "out":
            sender = harness.load(Sender, "/sender", {"out": "/numbers"})
        else:
            receiver = harness.load(Receiver, "/receiver", {"in": "/numbers"})
    anything = harness.listen("/numbers")
    sender.pub.publish(message)
    harness.drain()
    (found,) = receiver.got
    assert (type(found), list(found.data)) == (arrives_as, [1, 2])
    assert (found is message) is (type(message) is arrives_as)
    assert isinstance(anything[0].data, np.ndarray) is (published is ARRAYS)


class TestTime:
    def test_timers_run_when_their_time_has_come(self, harness):
        nodelet = harness.load(Ticking)
        harness.drain()
        assert (nodelet.times, harness.time) == ([], 0.0)
        harness.advance(1.0)
        assert nodelet.times == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
        harness.advance(0.15)
        assert nodelet.times[10:] == [1.1]
        harness.advance(3.85)
        harness.advance(-4.0)
        nodelet.times.clear()
        harness.advance(0.25)
        assert nodelet.times == [1.1, 1.2], "after time was set back to 1.0"

    def test_timers_of_a_callback(self, harness):
        fired = []

        class Later(dyknow.Nodelet):
            def on_init(self):
                self.nh = dyknow.NodeHandle(self.node_handle)
                self.nh.Timer(self.nh.Duration(1.0), self.on_first, oneshot=True)

            def on_first(self, event):
                self.nh.Timer(self.nh.Duration(2.0), self.on_second, oneshot=True)

            def on_second(self, event):
                fired.append(self.nh.get_time())

        harness.load(Later)
        harness.advance(10.0)
        assert fired == [3.0]

    def test_a_timer_that_is_due_soon_after_another_runs_as_well(self, harness):
        fired = []

        class Two(dyknow.Nodelet):
            def on_init(self):
                self.nh = dyknow.NodeHandle(self.node_handle)
                for period in (0.1, 0.101):
                    self.nh.Timer(self.nh.Duration(period), lambda event: fired.append(event))

        harness.load(Two)
        harness.advance(0.101)
        assert len(fired) == 2

    def test_timers_miss_no_call_because_of_others(self, harness):
        fired = []
        nh = harness.load(Multiplier).nh
        for period in (0.02, 0.05, 0.101):
            nh.Timer(nh.Duration(period), lambda event, period=period: fired.append(period))
        harness.advance(1.0)
        assert [fired.count(period) for period in (0.02, 0.05, 0.101)] == [50, 20, 9]

    def test_a_latched_message_of_on_init_reaches_who_listens_later(self, harness):
        harness.load(Ticking, ports={"time": "/time"})
        got = harness.listen("/time")
        harness.drain()
        assert got == [Int32(1)]


class UnittestsHaveIt(NodeletTestCase):
    def test_each_test_has_a_harness(self):
        nodelet = self.harness.load(Multiplier)
        self.assertEqual(self.harness.topics(nodelet), {"out": "", "in": ""})
