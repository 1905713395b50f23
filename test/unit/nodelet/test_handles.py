# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The plain NodeHandle: rospy's API in the name of one nodelet."""

from __future__ import annotations

import inspect
import sys
import threading
from types import SimpleNamespace

import pytest
from clocks import PATIENCE, eventually, in_thread, join, wait_for
from unit.nodelet.fakes import Idle, Message, numbers, pool_world

from dyknow.errors import BadQueueSize, DyKnowError, HandleClosed, InvalidName, NoMessageClass
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import Inbox, PlainNodeHandle

pool = pool_world(4)


class TestSignatures:
    @pytest.mark.parametrize(
        "name", ["Publisher", "Subscriber", "Service", "Timer", "wait_for_message"]
    )
    def test_are_those_of_rospy(self, world, name):
        """A call that works with it works here, positional arguments included."""
        ours, theirs = (
            [(each.name, each.default) for each in inspect.signature(call).parameters.values()]
            for call in (
                getattr(world.handle(), name),
                getattr(pytest.importorskip("rospy"), name),
            )
        )
        assert ours == theirs

    @pytest.mark.parametrize("given", [int, None, Message(1), "std_msgs/String"])
    def test_what_is_no_message_class_is_refused(self, world, given):
        nh = world.handle()
        for make in (nh.Publisher, nh.Subscriber, nh.wait_for_message):
            with pytest.raises(NoMessageClass, match="'t' expects a message class") as caught:
                make("t", given)
            assert isinstance(caught.value, ValueError)
        assert world.registrations == []

    @pytest.mark.parametrize("given", ["10", float("nan"), float("inf"), [1]])
    def test_a_queue_size_that_is_no_number_is_refused(self, world, given):
        nh = world.handle()
        for make in (nh.Publisher, nh.Subscriber):
            with pytest.raises(BadQueueSize, match="'t' expects a number or None as queue_size"):
                make("t", Message, queue_size=given)
        assert world.registrations == []

    def test_handles_have_the_members_of_rospys(self, world):
        nh = world.handle()
        for handle in (nh.Publisher("t", Message), nh.Subscriber("t", Message)):
            assert handle.name == handle.resolved_name == "/t"
            assert handle.data_class is Message
            assert (handle.type, handle.md5sum) == ("test/Message", "message")

    def test_connections_are_counted_as_in_roscpp(self, world):
        nh = world.handle()
        publisher = nh.Publisher("t", Message, queue_size=1)
        assert publisher.get_num_connections() == 0
        for _ in range(2):
            subscriber = nh.Subscriber("t", Message, print)
        assert (publisher.get_num_connections(), subscriber.get_num_connections()) == (1, 0)
        world.transport.listeners["/t"].extend([print, print])
        assert publisher.get_num_connections() == 3


class TestNames:
    def test_of_the_four_handles_of_a_nodelet(self, world):
        nodelet = Idle()
        nodelet.bind(world.context("/robot/nodelet"))
        for nh in (nodelet.node_handle, nodelet.mt_node_handle):
            assert nh.resolve_name("x") == "/robot/x"
            assert nh.resolve_name("~x") == "/robot/nodelet/x"
            assert nh.resolve_name("") == nh.get_namespace() == "/robot/"
        for nh in (nodelet.private_node_handle, nodelet.mt_private_node_handle):
            assert nh.resolve_name("x") == nh.resolve_name("~x") == "/robot/nodelet/x"
            assert nh.resolve_name("/x") == "/x"
            assert nh.resolve_name("~") == nh.resolve_name("") == "/robot/nodelet/", "as in rospy"
        assert nh.resolve_name("/") == world.handle("/nodelet").resolve_name("") == "/"
        nh = nodelet.node_handle
        assert nodelet.name == nh.get_name() == nh.get_caller_id() == "/robot/nodelet"
        assert nh.get_namespace() == "/robot/"
        assert world.handle("/nodelet").get_namespace() == "/"

    @pytest.mark.parametrize("name", ["", "~", "/", "a b", "1"])
    def test_that_name_no_topic_are_refused(self, world, name):
        nh = world.handle()
        for make in (nh.Publisher, nh.Subscriber):
            with pytest.raises(InvalidName) as caught:
                make(name, Message)
            assert isinstance(caught.value, ValueError)
        assert world.registrations == []

    def test_of_the_load_request_go_before_those_of_the_process(self, world):
        world.node.remappings.update({"/a": "/process", "/b": "/process_b", "/c": "/d"})
        nh = PlainNodeHandle(world.context("/n", remappings={"/a": "/c", "/n/x": "/y"}), "/")
        assert nh.resolve_name("a") == "/c", "remapped once, not on and on"
        assert nh.resolve_name("b") == "/process_b"
        assert nh.resolve_name("~x") == "/y"
        assert nh.resolve_name("x", "/ns/other") == "/ns/x", "as it is for another node"
        assert nh.resolve_name("~x", "/ns/other") == "/ns/other/x"
        assert nh.Publisher("a", Message).name == "/c"


def test_parameters_and_other_members_are_the_middlewares(world):
    nh = world.handle("/nodelet")
    nh.set_param("~rate", 5)
    assert world.node.parameters == {"/nodelet/rate": 5}
    assert nh.get_param("~rate") == 5
    assert nh.has_param("~rate") and not nh.has_param("rate")
    assert nh.get_param("~other", 7) == 7
    with pytest.raises(AttributeError, match="nonsense"):
        nh.nonsense  # noqa: B018
    assert not hasattr(nh, "__nonsense__")


def test_a_shutdown_hook_is_a_function(world):
    for hook in (None, 3):
        with pytest.raises(TypeError, match=f"on_shutdown expects a function, not {hook}"):
            world.handle().on_shutdown(h=hook)


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

    def test_a_subscriber_may_have_callbacks_later_and_a_failing_one_keeps_no_other(
        self, world, caplog
    ):
        got, nh = [], world.handle()
        subscriber = nh.Subscriber("t", Message)
        publisher = nh.Publisher("t", Message)
        publisher.publish(0)
        world.drain()
        assert subscriber.registerCallback(lambda m: got.append(m.number)) == 0
        assert subscriber.registerCallback(lambda m: 1 / 0) == 1
        subscriber.registerCallback(lambda m: sys.exit("on purpose"))
        subscriber.registerCallback(lambda m, *args: got.append(args), 1, 2)
        nh.Subscriber("t", Message, lambda m: sys.exit("alone"))
        publisher.publish(1)
        world.drain()
        assert got == [1, (1, 2)]
        assert nh.context.callback_errors == 3
        for text in ("/probe: the callback of 't' raised", "Traceback", "ZeroDivisionError"):
            assert text in caplog.text


class TestWaitForMessage:
    def test_raises_when_nothing_comes_in_time_or_the_nodelet_is_unloaded(self, pool):
        nh, raised = pool.handle("/waiting"), threading.Event()
        with pytest.raises(DyKnowError, match=r"'t' did not come within 0.01 s"):
            nh.wait_for_message("t", Message, timeout=0.01)
        assert pool.registrations == []

        def wait():
            with pytest.raises(DyKnowError, match="/waiting was unloaded"):
                nh.wait_for_message("t", Message)
            raised.set()

        thread = in_thread(wait)
        eventually(lambda: nh.context._closables)
        nh.context.close()
        join(thread)
        assert raised.is_set()
        for timeout in (None, 0.0):  # and so do waits that begin afterwards
            with pytest.raises(DyKnowError, match="'t': nodelet /waiting was unloaded"):
                nh.wait_for_message("t", Message, timeout)
        assert pool.registrations == []

    @pytest.mark.parametrize("timeout", [0, -0.1, SimpleNamespace(to_sec=lambda: 0.0)])
    def test_takes_durations_and_timeouts_that_are_over(self, world, timeout):
        nh = world.handle()
        with pytest.raises(DyKnowError, match="'t' did not come within 0 s"):
            nh.wait_for_message("t", Message, timeout)
        assert world.registrations == []

    @pytest.mark.parametrize("timeout", [0.0, 1e-6])
    def test_ends_in_time_however_short_that_is(self, pool, timeout):
        """Some of these waits had no end: of ``SimpleQueue``, where the time was over at once."""
        context = pool.handle().context

        def wait():
            for _ in range(3000):
                with pytest.raises(DyKnowError, match="'t' did not come"):
                    Inbox(context).get("'t'", timeout)

        join(in_thread(wait))

    @pytest.mark.parametrize("timeout", [float("inf"), 1e10])
    def test_takes_a_timeout_without_end(self, pool, timeout):
        pool.handle("/other").Publisher("/t", Message, latch=True).publish(42)
        nh = pool.handle()
        assert nh.wait_for_message("/t", Message, timeout).number == 42

    def test_works_in_a_callback_and_in_on_init(self, pool):
        nh, got, done = pool.handle(), [], threading.Event()
        pool.handle("/other").Publisher("/answer", Message, latch=True).publish(42)

        def ask(message):
            got.append(nh.wait_for_message("answer", Message, timeout=PATIENCE))
            done.set()

        nh.Subscriber("t", Message, ask)
        nh.Publisher("t", Message).publish()
        wait_for(done)
        starting = PlainNodeHandle(Context(pool.runtime, "/starting"), "/")
        got.append(starting.wait_for_message("answer", Message, timeout=PATIENCE))
        assert numbers(got) == [42, 42]


class TestLife:
    def test_a_handle_of_an_unloaded_nodelet_makes_nothing_more(self, world):
        nh, staying = world.handle("/gone"), world.handle("/staying")
        assert not nh.is_shutdown()
        nh.context.close()
        for make in (nh.Publisher, nh.Subscriber):
            with pytest.raises(HandleClosed, match="/gone"):
                make("t", Message)
        assert world.registrations == []
        assert nh.is_shutdown() and not staying.is_shutdown()
        called = []
        nh.on_shutdown(lambda: called.append("late"))
        assert called == ["late"]

    def test_a_handle_that_is_refused_or_made_amid_the_unload_leaves_nothing(self, world):
        nh, publisher = world.handle(), world.publisher("/alive")
        before = world.registrations
        for topic in ("/alive", "/dead"):
            world.transport.refused[topic] = RuntimeError("the master is gone")
            for make in (nh.Publisher, nh.Subscriber):
                with pytest.raises(RuntimeError, match="the master is gone"):
                    make(topic, Message)
        assert world.registrations == before
        publisher.publish(1)
        assert world.bus.datatype_of("/dead") == ""
        world.transport.on_register = lambda topic: join(in_thread(nh.context.close))
        with pytest.raises(HandleClosed):
            nh.Publisher("a", Message, queue_size=1)
        assert world.registrations == before

    def test_a_nodelet_has_no_handles_before_on_init(self):
        class Early(Idle):
            def __init__(self):
                self.nh = self.node_handle

        with pytest.raises(RuntimeError, match=r"no handles before on_init"):
            Early()


class TestConcurrentHandles:
    def test_a_blocked_callback_holds_up_no_other_and_an_unload_stops_all(self, pool):
        single = pool.handle("/n")
        nh = PlainNodeHandle(single.context, "/", concurrent=True)
        release, free, ticked, got = threading.Event(), threading.Event(), threading.Event(), []
        single.Subscriber("t", Message, lambda message: wait_for(release))
        nh.Subscriber("t", Message, lambda message: wait_for(release))
        nh.Subscriber("t", Message, lambda message: free.set())
        nh.Timer(1.0, lambda event: ticked.set(), oneshot=True)
        nh.Subscriber("u", Message, got.append)
        publisher, other = (pool.handle("/o").Publisher(topic, Message) for topic in ("/t", "/u"))
        publisher.publish()
        wait_for(free)
        pool.ticker.advance(1.0)
        wait_for(ticked)
        nh.context.close()
        other.publish()
        release.set()
        pool.drain()
        assert got == []

    def test_a_subscriber_that_is_unregistered_or_refused_takes_its_strand_with_it(
        self, pool, caplog
    ):
        caplog.set_level("INFO")
        nh = pool.handle(concurrent=True)
        before = len(nh.context._strands)
        publisher = nh.Publisher("t", Message)
        for _ in range(20):
            done, subscribers = threading.Event(), []

            def once(message, done=done, subscribers=subscribers):
                subscribers[0].unregister()
                done.set()

            subscribers.append(nh.Subscriber("t", Message, once))
            publisher.publish()
            wait_for(done)
        eventually(lambda: not any(each.busy for each in nh.context._strands))
        pool.transport.refused["/t"] = RuntimeError("no")
        with pytest.raises(RuntimeError):
            nh.Subscriber("t", Message, print)
        assert len(nh.context._strands) == before
        assert "unload" not in caplog.text, "nothing was unloaded"
