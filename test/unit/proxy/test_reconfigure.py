# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The reconfigure callback, and the notifications to the host."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples
from unit.nodelet.fakes import Message, World

import dyknow
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.middleware import Closable
from dyknow.proxy.proxy import NodeletProxy

IN_PORTS, OUT_PORTS = ("in1", "in2"), ("out1", "out2")
TOPICS = ("", "/a", "/b", "/c")


class Recorder:
    """A nodelet that records all its calls, in order."""

    def __init__(self, world, name):
        self.context = world.context(name)
        self.nh = dyknow.NodeHandle(PlainNodeHandle(self.context, "/"))
        self.proxy = NodeletProxy.of(self.context)
        self.log = []
        self.nh.set_reconfigure_callback(
            lambda inputs, outputs: self.log.append(("reconfigured", inputs, outputs))
        )
        for port in IN_PORTS:
            self.nh.Subscriber(port, Message, self.receive, port)
        self.publishers = {port: self.nh.Publisher(port, Message) for port in OUT_PORTS}

    def receive(self, message, port):
        self.log.append((port, message.number))


@pytest.fixture(name="world")
def _world():
    return World()


@pytest.fixture(name="nodelet")
def _nodelet(world):
    return Recorder(world, "/n")


def test_its_failure_does_not_undo_the_switch_and_its_maps_are_its_own(world, nodelet, caplog):
    def fail(inputs, outputs):
        nodelet.log.append(inputs)
        inputs["in1"] = "/nowhere"
        raise SystemExit("no")

    nodelet.nh.set_reconfigure_callback(fail)
    nodelet.proxy.set_config([("in1", "/a")])
    assert nodelet.log == [], "it runs on the nodelet's queue"
    world.handle("/probe").Publisher("/a", Message).publish(1)
    world.drain()
    assert nodelet.log[1:] == [("in1", 1)]
    assert nodelet.proxy.get_config()[0].topic == "/a"
    statistics = nodelet.proxy.get_statistics()
    assert (statistics.callback_errors, statistics.reconfigurations) == (1, 1)
    assert "/n: the callback of a reconfiguration raised" in caplog.text


def test_it_may_reconfigure_the_nodelet_itself_and_can_be_taken_away(world, nodelet):
    def again(inputs, outputs):
        nodelet.log.append(inputs["in1"])
        if inputs["in1"] == "/a":
            nodelet.proxy.set_config([("in1", "/b")])

    nodelet.nh.set_reconfigure_callback(again)
    nodelet.proxy.set_config([("in1", "/a")])
    world.drain()
    nodelet.nh.set_reconfigure_callback(None)
    nodelet.proxy.set_config([("in1", "/c")])
    world.drain()
    assert nodelet.log == ["/a", "/b"]


def test_the_host_is_notified_of_every_change_and_may_open_services(world):
    changes, opened, closed = [], [], []

    class Services(Closable):
        def close(self):
            closed.append(1)

    def attach(context, proxy):
        opened.append((context.name, type(proxy)))
        proxy.on_change = lambda: changes.append([port.topic for port in proxy.get_config()])
        return Services()

    context = world.context("/n")
    context.on_attach = attach
    for _ in range(2):
        nh = dyknow.NodeHandle(PlainNodeHandle(context, "/"))
    assert opened == [("/n", NodeletProxy)]
    nh.Publisher("out", Message)
    nh.Subscriber("in", Message, print)
    for _ in range(2):
        NodeletProxy.of(context).set_config([("in", "/a")])
    assert changes == [[""], ["", ""], ["", "/a"]]
    context.close()
    assert closed == [1]


MOVES = st.dictionaries(
    st.sampled_from(IN_PORTS + OUT_PORTS), st.sampled_from(TOPICS), min_size=1, max_size=4
)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), st.integers(0, 1), st.sampled_from(OUT_PORTS)),
        st.tuples(st.just("publish"), st.integers(0, 1), st.sampled_from(OUT_PORTS)),
        st.tuples(st.just("set_config"), st.integers(0, 1), MOVES),
        st.tuples(st.just("step"), st.none(), st.none()),
    ),
    max_size=40,
)


@examples(150)
@given(STEPS)
def test_nodelets_see_messages_and_reconfigurations_exactly_in_order(steps):
    world = World()
    nodelets = [Recorder(world, f"/n{n}") for n in range(2)]
    topics = [dict.fromkeys(IN_PORTS + OUT_PORTS, "") for _ in nodelets]
    expected = [[] for _ in nodelets]
    for number, (verb, which, what) in enumerate(steps):
        if verb == "step":
            world.executor.step()
        elif verb == "publish":
            nodelets[which].publishers[what].publish(number)
            topic = topics[which][what]
            for connected, log in zip(topics, expected):
                hits = [port for port in IN_PORTS if topic and connected[port] == topic]
                log.extend((port, number) for port in hits)
        else:
            nodelets[which].proxy.set_config(sorted(what.items()))
            if any(topics[which][port] != topic for port, topic in what.items()):
                topics[which].update(what)
                maps = [{p: topics[which][p] for p in side} for side in (IN_PORTS, OUT_PORTS)]
                expected[which].append(("reconfigured", *maps))
    world.drain()
    for nodelet, log in zip(nodelets, expected):
        assert _any_order_of_one_message(nodelet.log) == _any_order_of_one_message(log)


def _any_order_of_one_message(log):
    """Two ports on one topic get a message in either order: sort neighbours."""
    result = list(log)
    for at in range(len(result) - 1):
        first, second = result[at : at + 2]
        if len(first) == len(second) == 2 and first[1] == second[1] and first[0] > second[0]:
            result[at : at + 2] = second, first
    return result
