# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports: declared once, shared by handles, remembered by the nodelet."""

from __future__ import annotations

import gc
import inspect

import pytest
from clocks import eventually, in_thread, join
from unit.nodelet.fakes import Message, OtherMessage, numbers, pool_world
from unit.proxy.bench import Bench

import dyknow
from dyknow.errors import HandleClosed, InvalidName, NoMessageClass, PortConflict, TypeMismatch
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle

pool = pool_world(2)
OUT, IN = "Publisher", "Subscriber"


class TestDeclaration:
    def test_a_port_starts_disconnected(self, bench):
        bench.world.node.remappings["/ns/out"] = "/result"  # of the process: is for topics
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
        private = dyknow.NodeHandle(PlainNodeHandle(bench.context, "/ns/nodelet"))
        private.Subscriber("in", Message, print)
        assert bench.topics() == {"out": "/result", "~in": "/source", "in": "/source"}
        bench.send("/source", 5)
        assert numbers(got) == [5]

    @pytest.mark.parametrize(
        ("error", "name", "datatype"),
        [
            *((InvalidName, name, Message) for name in ("", "a b", "1", "a//b")),
            *((NoMessageClass, "x", given) for given in (int, None, Message(1), "std_msgs/Int8")),
            (TypeMismatch, "x", Message),
        ],
    )
    def test_a_refused_declaration_leaves_no_port(self, error, name, datatype):
        bench = Bench(remappings={"/ns/x": "/t"})
        bench.probe.Publisher("/t", OtherMessage)
        for make in (bench.nh.Publisher, bench.nh.Subscriber, bench.nh.wait_for_message):
            with pytest.raises(error):
                make(name, datatype)
        assert bench.topics() == {}
        assert bench.world.registrations == [("publisher", "/t")]
        bench.nh.Subscriber("x", OtherMessage, print)
        assert bench.topics() == {"x": "/t"}

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

    def test_handles_are_the_plain_ones_but_for_ports(self, bench):
        for method in ("Publisher", "Subscriber", "wait_for_message"):
            ours, plain = (
                [(each.name, each.default) for each in inspect.signature(call).parameters.values()]
                for call in (getattr(dyknow.NodeHandle, method), getattr(PlainNodeHandle, method))
            )
            assert ours == plain  # rospy.Publisher(name="image", ...) is converted as it stands
        bench.nh.set_param("~rate", 5)
        assert bench.nh.get_param("~rate") == 5
        assert bench.nh.get_name() == "/ns/nodelet"
        assert bench.nh.resolve_name("x") == "/ns/x"
        with pytest.raises(AttributeError):
            bench.nh.nonsense  # noqa: B018
        with pytest.raises(TypeError, match="such as self.node_handle, not str"):
            dyknow.NodeHandle("/ns")  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="not NodeHandle"):
            dyknow.NodeHandle(bench.nh)


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
def test_conflicts_are_refused_and_leave_the_port_alone(bench, first, second, message):
    kind, *args = first
    handle = getattr(bench.nh, kind)("x", *args)
    before = bench.proxy.get_config()
    kind, *args = second
    for unregister in (False, True):
        if unregister and "latched" not in message:  # the port keeps its type without handles
            handle.unregister()
        with pytest.raises(PortConflict, match=f"'x' exists as .*{message}"):
            getattr(bench.nh, kind)("x", *args)
    assert bench.proxy.get_config() == before
    getattr(dyknow.NodeHandle(bench.world.handle("/other")), kind)("x", *args)


class TestSharing:
    def test_handles_share_the_connection_until_they_are_unregistered(self, bench):
        got = [[], [], []]
        subscribers = [bench.nh.Subscriber("in", Message, each.append) for each in got[:2]]
        one, two = (bench.nh.Publisher("out", Message) for _ in range(2))
        bench.connect(out="/t", **{"in": "/t"})
        assert bench.nh.Subscriber("in", Message, got[2].append).name == "/t"
        assert bench.world.registrations.count(("publisher", "/t")) == 1
        one.publish(1)
        two.publish(2)
        bench.world.drain()
        subscribers[0].unregister()
        one.unregister()
        with pytest.raises(HandleClosed):
            one.publish(3)
        two.publish(3)
        bench.world.drain()
        assert [numbers(each) for each in got] == [[1, 2], [1, 2, 3], [1, 2, 3]]
        assert subscribers[1].name == two.name == "/t"

    def test_a_port_outlives_its_handles_and_their_connection_comes_back(self, bench):
        got = []
        subscriber = bench.nh.Subscriber("in", Message, got.append)
        publisher = bench.nh.Publisher("out", Message)
        bench.connect(out="/u", **{"in": "/t"})
        for handle in (subscriber, publisher):
            handle.unregister()
            handle.unregister()
        assert bench.world.registrations == []
        bench.connect(out="/later")
        assert bench.topics() == {"in": "/t", "out": "/later"}
        assert bench.world.registrations == []
        bench.nh.Subscriber("in", Message, got.append)
        bench.nh.Publisher("out", Message)
        gc.collect()  # as in rospy: a handle need not be kept by the author
        assert bench.world.registrations == [("publisher", "/later"), ("subscriber", "/t")]
        bench.send("/t", 1)
        assert numbers(got) == [1]


def test_a_message_is_awaited_at_a_port_though_it_is_connected_meanwhile(pool):
    bench, got = Bench(pool), []
    thread = in_thread(lambda: got.append(bench.nh.wait_for_message("in", Message)))
    eventually(lambda: "in" in bench.topics())
    bench.probe.Publisher("/t", Message, latch=True).publish(3)
    bench.connect(**{"in": "/t"})
    join(thread)
    assert bench.world.registrations == [("publisher", "/t")]
    assert bench.topics() == {"in": "/t"}
    starting = Context(bench.world.runtime, "/starting", {"/in": "/t"})
    nh = dyknow.NodeHandle(PlainNodeHandle(starting, "/"))
    got.append(nh.wait_for_message("in", Message, 10.0))
    assert numbers(got) == [3, 3]
