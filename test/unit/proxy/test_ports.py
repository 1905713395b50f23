# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports: declared once, shared by handles, remembered by the nodelet."""

from __future__ import annotations

import gc
import inspect
import threading

import pytest
from unit.nodelet.fakes import (
    Idle,
    Message,
    OtherMessage,
    World,
    in_thread,
    join,
    numbers,
    pool_world,
    wait_until,
)

import dyknow
from dyknow.errors import HandleClosed, InvalidName, NoMessageClass, PortConflict, TypeMismatch
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.proxy import NodeletProxy


class Bench:
    """A nodelet to declare ports in, and a probe outside of it."""

    def __init__(self, world=None, **options):
        self.world = world or World()
        self.context = self.world.context("/ns/nodelet", **options)
        self.plain = PlainNodeHandle(self.context, "/ns")
        self.nh = dyknow.NodeHandle(self.plain)
        self.proxy = NodeletProxy.of(self.context)
        self.probe = self.world.handle("/probe")

    def topics(self):
        return {port.name: port.topic for port in self.proxy.get_config()}


pool = pool_world(2)


@pytest.fixture(name="bench")
def _bench():
    return Bench()


class TestDeclaration:
    def test_a_port_starts_disconnected(self, bench):
        bench.nh.Publisher("out", Message)
        subscriber = bench.nh.Subscriber("in", Message, print)
        assert bench.topics() == {"out": "", "in": ""}
        assert subscriber.name == subscriber.resolved_name == ""
        assert bench.world.registrations == []
        assert bench.world.bus._topics == {}

    def test_a_remapping_of_the_load_request_connects_it(self):
        bench = Bench(remappings={"/ns/out": "/result", "/ns/nodelet/in": "/source"})
        got = []
        bench.probe.Subscriber("/result", Message, got.append)
        publisher = bench.nh.Publisher("out", Message)
        bench.nh.Subscriber("~in", Message, publisher.publish)
        assert bench.topics() == {"out": "/result", "~in": "/source"}
        bench.probe.Publisher("/source", Message).publish(5)
        bench.world.drain()
        assert numbers(got) == [5]

    def test_a_remapping_of_the_process_does_not(self, bench):
        bench.world.node.remappings["/ns/out"] = "/result"
        bench.nh.Publisher("out", Message)
        assert bench.topics() == {"out": ""}

    def test_names_resolve_in_the_handle_that_is_wrapped(self):
        bench = Bench(remappings={"/ns/nodelet/image": "/mine", "/ns/image": "/not_mine"})
        private = dyknow.NodeHandle(PlainNodeHandle(bench.context, "/ns/nodelet"))
        private.Subscriber("image", Message, print)
        assert bench.topics() == {"image": "/mine"}

    @pytest.mark.parametrize("name", ["", "a b", "1", "a//b"])
    def test_a_bad_name_is_refused(self, bench, name):
        for make in (bench.nh.Publisher, bench.nh.Subscriber):
            with pytest.raises(InvalidName, match="port name"):
                make(name, Message)
        assert bench.topics() == {}

    @pytest.mark.parametrize("given", [int, None, Message(1), "std_msgs/String"])
    def test_what_is_no_message_class_is_refused(self, bench, given):
        for make in (bench.nh.Publisher, bench.nh.Subscriber, bench.nh.wait_for_message):
            with pytest.raises(NoMessageClass, match="'image' expects a message class"):
                make("image", given)
        assert bench.topics() == {}

    def test_a_failed_declaration_leaves_no_port(self):
        bench = Bench(remappings={"/ns/out": "/t", "/ns/in": "/t"})
        bench.probe.Publisher("/t", OtherMessage)
        for make in (bench.nh.Publisher, bench.nh.Subscriber):
            name = "out" if make == bench.nh.Publisher else "in"
            with pytest.raises(TypeMismatch):
                make(name, Message)
        assert bench.topics() == {}
        assert bench.world.registrations == [("publisher", "/t")]
        bench.nh.Subscriber("in", OtherMessage, print)
        assert bench.topics() == {"in": "/t"}

    def test_a_failed_further_handle_leaves_the_port_as_it_was(self):
        bench = Bench(remappings={"/ns/in": "/t"})
        got = []
        bench.nh.Subscriber("in", Message, got.append)
        bench.world.transport.refused["/t"] = RuntimeError("no")
        concurrent = dyknow.NodeHandle(PlainNodeHandle(bench.context, "/ns", concurrent=True))
        strands = len(bench.context._strands)
        with pytest.raises(RuntimeError):
            concurrent.Subscriber("in", Message, got.append)
        assert len(bench.context._strands) == strands
        bench.world.transport.send("/t", Message(1))
        bench.world.drain()
        assert numbers(got) == [1]
        assert bench.topics() == {"in": "/t"}

    def test_signatures_are_those_of_the_plain_handle(self):
        for method in ("Publisher", "Subscriber", "wait_for_message"):
            ours = inspect.signature(getattr(dyknow.NodeHandle, method)).parameters.values()
            plain = inspect.signature(getattr(PlainNodeHandle, method)).parameters.values()
            # The first argument too: rospy.Publisher(name="image", ...) is converted as it stands.
            assert [p.default for p in ours] == [p.default for p in plain]
            assert [p.name for p in ours] == [p.name for p in plain]

    def test_only_handles_of_nodelets_can_be_wrapped(self):
        with pytest.raises(TypeError, match="such as self.node_handle, not str"):
            dyknow.NodeHandle("/ns")  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="not NodeHandle"):
            dyknow.NodeHandle(Bench().nh)

    def test_everything_else_is_the_plain_handles(self, bench):
        bench.nh.set_param("~rate", 5)
        assert bench.nh.get_param("~rate") == 5
        assert bench.nh.get_name() == "/ns/nodelet"
        assert bench.nh.resolve_name("x") == "/ns/x"
        with pytest.raises(AttributeError):
            bench.nh.nonsense  # noqa: B018


OUT, IN = "Publisher", "Subscriber"


class TestConflicts:
    @pytest.mark.parametrize(
        ("first", "second", "message"),
        [
            ((OUT, Message), (IN, Message), "out-port of type test/Message.*in-port of type"),
            ((IN, Message), (OUT, Message), "in-port of type test/Message.*out-port of type"),
            ((OUT, Message), (OUT, OtherMessage), "out-port of type test/OtherMessage"),
            ((IN, Message), (IN, OtherMessage), "in-port of type test/OtherMessage"),
            ((OUT, Message, None, False, True), (OUT, Message), "not latched"),
        ],
    )
    def test_of_direction_type_and_latch(self, bench, first, second, message):
        kind, *args = first
        getattr(bench.nh, kind)("x", *args)
        kind, *args = second
        with pytest.raises(PortConflict, match=f"'x' exists as .*{message}"):
            getattr(bench.nh, kind)("x", *args)

    def test_leave_what_is_there_alone(self, bench):
        publisher = bench.nh.Publisher("x", Message)
        with pytest.raises(PortConflict):
            bench.nh.Subscriber("x", Message, print)
        bench.proxy.set_config([("x", "/t")])
        got = []
        bench.probe.Subscriber("/t", Message, got.append)
        publisher.publish(1)
        bench.world.drain()
        assert numbers(got) == [1]

    def test_between_nodelets_there_are_none(self, bench):
        other = dyknow.NodeHandle(bench.world.handle("/other"))
        bench.nh.Publisher("x", Message)
        other.Subscriber("x", OtherMessage, print)


class TestSharing:
    def test_all_handles_of_a_nodelet_share_one_proxy(self, bench):
        nodelet = Idle()
        nodelet.bind(bench.context)
        for plain in (nodelet.node_handle, nodelet.mt_private_node_handle):
            dyknow.NodeHandle(plain).Publisher("out", Message)
        assert NodeletProxy.of(bench.context) is bench.proxy
        assert len(bench.proxy.get_config()) == 1

    def test_publishers_of_one_port_publish_where_it_is_connected(self, bench):
        got = []
        bench.probe.Subscriber("/t", Message, got.append)
        handles = [bench.nh.Publisher("out", Message) for _ in range(2)]
        bench.proxy.set_config([("out", "/t")])
        for number, handle in enumerate(handles):
            handle.publish(number)
        bench.world.drain()
        assert numbers(got) == [0, 1]
        assert bench.world.registrations.count(("publisher", "/t")) == 1

    def test_subscribers_of_one_port_each_get_every_message(self, bench):
        got = [[], []]
        for each in got:
            bench.nh.Subscriber("in", Message, each.append)
        bench.proxy.set_config([("in", "/t")])
        bench.probe.Publisher("/t", Message).publish(1)
        bench.world.drain()
        assert [numbers(each) for each in got] == [[1], [1]]

    def test_a_later_handle_finds_the_connection_of_its_port(self, bench):
        got = []
        bench.nh.Subscriber("in", Message, got.append)
        bench.nh.Publisher("out", Message)
        bench.proxy.set_config([("in", "/t"), ("out", "/u")])
        assert bench.nh.Subscriber("in", Message, got.append).name == "/t"
        assert bench.nh.Publisher("out", Message).name == "/u"
        bench.probe.Publisher("/t", Message).publish(1)
        bench.world.drain()
        assert numbers(got) == [1, 1]

    def test_one_handle_unregistered_leaves_the_others(self, bench):
        got = []
        first, second = (bench.nh.Subscriber("in", Message, got.append) for _ in range(2))
        one, two = (bench.nh.Publisher("out", Message) for _ in range(2))
        bench.proxy.set_config([("in", "/t"), ("out", "/t")])
        first.unregister()
        one.unregister()
        with pytest.raises(HandleClosed):
            one.publish(1)
        two.publish(2)
        bench.world.drain()
        assert numbers(got) == [2]
        assert second.name == two.name == "/t"


class TestPersistence:
    def test_a_port_outlives_its_handles_and_their_connection_comes_back(self, bench):
        got = []
        subscriber = bench.nh.Subscriber("in", Message, got.append)
        publisher = bench.nh.Publisher("out", Message)
        bench.proxy.set_config([("in", "/t"), ("out", "/u")])
        for handle in (subscriber, publisher):
            handle.unregister()
            handle.unregister()
        assert bench.topics() == {"in": "/t", "out": "/u"}
        assert bench.world.registrations == []
        bench.nh.Subscriber("in", Message, got.append)
        bench.nh.Publisher("out", Message)
        assert bench.world.registrations == [("publisher", "/u"), ("subscriber", "/t")]
        bench.probe.Publisher("/t", Message).publish(1)
        bench.world.drain()
        assert numbers(got) == [1]

    def test_a_port_without_handles_can_be_connected_elsewhere(self, bench):
        bench.nh.Publisher("out", Message).unregister()
        bench.proxy.set_config([("out", "/later")])
        assert bench.world.registrations == []
        assert bench.nh.Publisher("out", Message).name == "/later"

    def test_a_port_without_handles_keeps_its_type(self, bench):
        bench.nh.Publisher("out", Message).unregister()
        with pytest.raises(PortConflict):
            bench.nh.Publisher("out", OtherMessage)

    def test_handles_that_are_forgotten_go_on_working(self, bench):
        # As in rospy: a subscriber need not be kept by the author.
        got = []
        bench.nh.Subscriber("in", Message, got.append)
        gc.collect()
        bench.proxy.set_config([("in", "/t")])
        bench.probe.Publisher("/t", Message).publish(1)
        bench.world.drain()
        assert numbers(got) == [1]


class TestWaitForMessage:
    @pytest.fixture(name="bench")
    def _bench(self, pool):
        return Bench(pool)

    def test_waits_at_a_port_though_it_is_connected_meanwhile(self, bench):
        got = []
        thread = in_thread(lambda: got.append(bench.nh.wait_for_message("in", Message)))
        wait_until(lambda: "in" in bench.topics())
        bench.probe.Publisher("/t", Message, latch=True).publish(3)
        bench.proxy.set_config([("in", "/t")])
        join(thread)
        assert numbers(got) == [3]
        assert bench.world.registrations == [("publisher", "/t")]
        assert bench.topics() == {"in": "/t"}

    def test_works_in_on_init(self, bench):
        bench.probe.Publisher("/t", Message, latch=True).publish(3)
        context = Context(bench.world.runtime, "/starting", {"/in": "/t"})
        nh = dyknow.NodeHandle(PlainNodeHandle(context, "/"))
        assert nh.wait_for_message("in", Message, 10.0).number == 3

    def test_raises_in_time_and_at_the_unload(self, bench):
        with pytest.raises(Exception, match=r"port 'in' did not come within 0.01 s"):
            bench.nh.wait_for_message("in", Message, 0.01)
        raised = threading.Event()

        def wait():
            with pytest.raises(Exception, match="was unloaded"):
                bench.nh.wait_for_message("in", Message)
            raised.set()

        thread = in_thread(wait)
        wait_until(lambda: bench.context._closables)
        bench.context.close()
        join(thread)
        assert raised.is_set()
