# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The plain NodeHandle: rospy's API in the name of one nodelet."""

from __future__ import annotations

import inspect
import threading

import pytest
from unit.nodelet.fakes import (
    Idle,
    Message,
    in_thread,
    join,
    numbers,
    pool_world,
    wait_for,
    wait_until,
)

from dyknow.errors import DyKnowError, HandleClosed, InvalidName, NoMessageClass
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle

pool = pool_world(2)


#: Signatures of rospy: a call that works with it works here, positional arguments included.
SIGNATURES = {
    "Publisher": "name, data_class, subscriber_listener=None, tcp_nodelay=False, latch=False, "
    "headers=None, queue_size=None",
    "Subscriber": "name, data_class, callback=None, callback_args=None, queue_size=None, "
    "buff_size=65536, tcp_nodelay=False",
    "Service": "name, service_class, handler, buff_size=65536, error_handler=None",
    "Timer": "period, callback, oneshot=False, reset=False",
    "wait_for_message": "topic, topic_type, timeout=None",
}


def signature(function):
    parameters = inspect.signature(function).parameters.values()
    return ", ".join(
        each.name if each.default is each.empty else f"{each.name}={each.default!r}"
        for each in parameters
        if each.name != "self"
    )


class TestSignatures:
    @pytest.mark.parametrize("name", SIGNATURES)
    def test_are_those_of_rospy(self, name):
        assert signature(getattr(PlainNodeHandle, name)) == SIGNATURES[name]
        theirs = getattr(pytest.importorskip("rospy"), name)
        theirs = getattr(theirs, "__init__", theirs) if isinstance(theirs, type) else theirs
        names = [each.partition("=")[0] for each in SIGNATURES[name].split(", ")]
        known = [each.partition("=")[0] for each in signature(theirs).split(", ")]
        assert known[: len(names)] == names

    @pytest.mark.parametrize("given", [int, None, Message(1), "std_msgs/String"])
    def test_what_is_no_message_class_is_refused(self, world, given):
        nh = world.handle()
        for make in (nh.Publisher, nh.Subscriber, nh.wait_for_message):
            with pytest.raises(NoMessageClass, match="'t' expects a message class") as caught:
                make("t", given)
            assert isinstance(caught.value, ValueError)
        assert world.registrations == []

    def test_handles_tell_what_rospy_s_do(self, world):
        nh = world.handle()
        for handle in (nh.Publisher("t", Message), nh.Subscriber("t", Message)):
            assert handle.name == handle.resolved_name == "/t"
            assert handle.data_class is Message
            assert (handle.type, handle.md5sum) == ("test/Message", "message")
            handle.unregister()


class TestNames:
    def test_of_the_four_handles_of_a_nodelet(self, world):
        context = world.context("/robot/nodelet")
        nodelet = Idle()
        nodelet.bind(context)
        for nh in (nodelet.node_handle, nodelet.mt_node_handle):
            assert nh.resolve_name("x") == "/robot/x"
            assert nh.resolve_name("~x") == "/robot/nodelet/x"
        for nh in (nodelet.private_node_handle, nodelet.mt_private_node_handle):
            assert nh.resolve_name("x") == "/robot/nodelet/x"
            assert nh.resolve_name("~x") == "/robot/nodelet/x"
            assert nh.resolve_name("/x") == "/x"
        assert nodelet.name == nodelet.node_handle.get_name() == "/robot/nodelet"
        assert nodelet.node_handle.get_caller_id() == "/robot/nodelet"
        assert nodelet.node_handle.get_namespace() == "/robot/"

    def test_namespace_in_the_root_is_one_slash(self, world):
        assert world.handle("/nodelet").get_namespace() == "/"

    @pytest.mark.parametrize(
        ("name", "resolved"),
        [
            ("~", "/ns/nodelet"),
            ("~/rate", "/ns/nodelet/rate"),
            ("", "/ns"),
            ("/", "/"),
            ("rate/", "/ns/rate"),
        ],
    )
    def test_that_rospy_takes_for_parameters_are_taken(self, world, name, resolved):
        nh = PlainNodeHandle(world.context("/ns/nodelet"), "/ns")
        assert nh.resolve_name(name) == resolved

    @pytest.mark.parametrize("name", ["", "~", "/", "a b", "1"])
    @pytest.mark.parametrize("make", ["Publisher", "Subscriber"])
    def test_that_name_no_topic_are_refused(self, world, name, make):
        nh = world.handle()
        with pytest.raises(InvalidName):
            getattr(nh, make)(name, Message)
        assert world.registrations == []
        assert nh.context._endpoints == []

    def test_of_the_load_request_go_before_those_of_the_process(self, world):
        world.node.remappings.update({"/a": "/process", "/b": "/process_b", "/c": "/d"})
        nh = PlainNodeHandle(world.context("/n", remappings={"/a": "/c", "/n/x": "/y"}), "/")
        assert nh.resolve_name("a") == "/c", "remapped once, not on and on"
        assert nh.resolve_name("b") == "/process_b"
        assert nh.resolve_name("~x") == "/y"
        assert nh.Publisher("a", Message).name == "/c"

    def test_of_another_node_resolve_for_it(self, world):
        nh = PlainNodeHandle(world.context("/n"), "/")
        assert nh.resolve_name("x", "/ns/other") == "/ns/x"
        assert nh.resolve_name("~x", "/ns/other") == "/ns/other/x"


class TestParameters:
    def test_private_ones_are_the_nodelets(self, world):
        nh = world.handle("/nodelet")
        nh.set_param("~rate", 5)
        assert world.node.parameters == {"/nodelet/rate": 5}
        assert nh.get_param("~rate") == 5
        assert nh.has_param("~rate") and not nh.has_param("rate")
        assert nh.get_param("~other", 7) == 7

    def test_what_ros_has_not_a_handle_has_not(self, world):
        with pytest.raises(AttributeError, match="nonsense"):
            world.handle().nonsense  # noqa: B018
        assert not hasattr(world.handle(), "__nonsense__")


class TestCallbacks:
    def test_callback_args_follow_the_message(self, world):
        got = []
        nh = world.handle()
        nh.Subscriber("t", Message, lambda *args: got.append(args), "more")
        nh.Subscriber("t", Message, lambda *args: got.append(args), callback_args=(1, 2))
        nh.Subscriber("t", Message, lambda *args: got.append(args), callback_args=0)
        message = Message()
        nh.Publisher("t", Message).publish(message)
        world.drain()
        assert got == [(message, "more"), (message, (1, 2)), (message, 0)]

    def test_register_callback_adds_to_those_that_are_there(self, world):
        got = []
        nh = world.handle()
        subscriber = nh.Subscriber("t", Message, lambda m: got.append("first"))
        assert subscriber.registerCallback(lambda m: got.append("second")) == 1
        subscriber.registerCallback(lambda m, *args: got.append(args), 1, 2)
        nh.Publisher("t", Message).publish()
        world.drain()
        assert got == ["first", "second", (1, 2)]

    def test_a_subscriber_may_have_callbacks_later_or_never(self, world):
        got = []
        nh = world.handle()
        subscriber = nh.Subscriber("t", Message)
        publisher = nh.Publisher("t", Message)
        publisher.publish(0)
        world.drain()
        assert subscriber.registerCallback(got.append) == 0
        publisher.publish(1)
        world.drain()
        assert numbers(got) == [1]

    def test_one_that_fails_does_not_keep_the_others_from_the_message(self, world, caplog):
        got = []
        nh = world.handle()
        subscriber = nh.Subscriber("t", Message, lambda m: 1 / 0)
        subscriber.registerCallback(lambda m: {"present": 1}["missing"])
        subscriber.registerCallback(got.append)
        nh.Publisher("t", Message).publish()
        world.drain()
        assert len(got) == 1
        assert nh.context.callback_errors == 2
        assert "ZeroDivisionError" in caplog.text and "KeyError" in caplog.text


class TestWaitForMessage:
    def test_returns_the_first_message_and_leaves_nothing(self, pool):
        nh, got = pool.handle(), []
        thread = in_thread(lambda: got.append(nh.wait_for_message("t", Message)))
        wait_until(lambda: pool.transport.subscribers)
        publisher = pool.handle("/other").Publisher("/t", Message)
        publisher.publish(7)
        join(thread)
        assert numbers(got) == [7]
        assert pool.registrations == [("publisher", "/t")]

    def test_raises_when_nothing_comes_in_time(self, pool):
        nh = pool.handle()
        with pytest.raises(DyKnowError, match=r"'t' did not come within 0.01 s"):
            nh.wait_for_message("t", Message, timeout=0.01)
        assert pool.registrations == []

    def test_raises_when_the_nodelet_is_unloaded(self, pool):
        nh, raised = pool.handle("/waiting"), []

        def wait():
            with pytest.raises(DyKnowError, match="/waiting was unloaded") as caught:
                nh.wait_for_message("t", Message)
            raised.append(caught.value)

        thread = in_thread(wait)
        wait_until(lambda: pool.transport.subscribers)
        wait_until(lambda: nh.context._closables)
        nh.context.close()
        join(thread)
        assert len(raised) == 1
        assert pool.registrations == []

    def test_works_inside_a_callback_of_the_same_nodelet(self, pool):
        nh, got, done = pool.handle(), [], threading.Event()
        publisher = pool.handle("/other").Publisher("/answer", Message, latch=True)
        publisher.publish(42)

        def ask(message):
            got.append(nh.wait_for_message("answer", Message, timeout=10.0))
            done.set()

        nh.Subscriber("t", Message, ask)
        nh.Publisher("t", Message).publish()
        wait_for(done)
        assert numbers(got) == [42]

    def test_works_in_on_init_before_any_callback_runs(self, pool):
        pool.handle("/other").Publisher("/info", Message, latch=True).publish(42)
        context = Context(pool.runtime, "/starting")
        message = PlainNodeHandle(context, "/").wait_for_message("info", Message, timeout=10.0)
        assert message.number == 42


class TestLife:
    def test_a_handle_of_an_unloaded_nodelet_makes_nothing_more(self, world):
        nh = world.handle("/gone")
        nh.context.close()
        for make in (nh.Publisher, nh.Subscriber):
            with pytest.raises(HandleClosed, match="/gone"):
                make("t", Message)
        assert world.registrations == []
        assert nh.is_shutdown()

    def test_is_shutdown_is_of_the_one_nodelet(self, world):
        going, staying = world.handle("/going"), world.handle("/staying")
        assert not going.is_shutdown()
        going.context.close()
        assert going.is_shutdown()
        assert not staying.is_shutdown()

    def test_a_nodelet_has_no_handles_before_on_init(self):
        class Early(Idle):
            def __init__(self):
                self.nh = self.node_handle

        with pytest.raises(RuntimeError, match=r"no handles before on_init"):
            Early()
