# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Switches in every order, against a simple model; the reconfigure callback; the host's news."""

from __future__ import annotations

from collections import Counter
from itertools import groupby
from typing import Any, Dict

import pytest
from hypothesis import example, given
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

    def __init__(self, world, name, queue_size=None):
        self.context = world.context(name)
        self.nh = dyknow.NodeHandle(PlainNodeHandle(self.context, "/"))
        self.proxy = NodeletProxy.of(self.context)
        self.log = []
        self.nh.set_reconfigure_callback(self.reconfigured)
        self.handles: Dict[str, Any] = {
            port: self.nh.Publisher(port, Message, queue_size=1) for port in OUT_PORTS
        }
        for port in IN_PORTS:
            self.handles[port] = self.nh.Subscriber(port, Message, self.receive, port, queue_size)

    def receive(self, message, port):
        self.log.append((port, message.number))

    def reconfigured(self, *maps):
        count = sum(1 for entry in self.log if entry[0] == "switch")
        self.log.append(("switch", -count, *maps))


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
    assert ("in1", "/a") in [(port.name, port.topic) for port in nodelet.proxy.get_config()]
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
BOTH = st.integers(0, 1)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), BOTH, st.sampled_from(OUT_PORTS)),
        st.tuples(st.just("publish"), BOTH, st.sampled_from(OUT_PORTS)),
        st.tuples(st.just("outside"), st.none(), st.sampled_from(TOPICS[1:])),
        st.tuples(st.just("switch"), BOTH, MOVES),
        st.tuples(st.just("step"), st.none(), st.booleans()),
        st.tuples(st.just("unregister"), BOTH, st.sampled_from(IN_PORTS + OUT_PORTS)),
        st.tuples(st.just("unload"), BOTH, st.none()),
    ),
    max_size=40,
)


class Model:
    """Two nodelets, and the messages and switches that each of them has to note.

    A message goes to all in-ports that are on its topic when it is published, and the callbacks
    of a nodelet run in the order of its messages and switches.
    """

    def __init__(self, queue_size=None):
        self.world = World()
        self.nodelets = [Recorder(self.world, f"/n{n}", queue_size) for n in range(2)]
        self.topics = [dict.fromkeys(OUT_PORTS + IN_PORTS, "") for _ in self.nodelets]
        self.expected = [[] for _ in self.nodelets]
        self.moved = [[] for _ in self.nodelets]
        self.gone, self.count = set(), 0

    def run(self, steps):
        for verb, which, what in steps:
            self.count += 1
            getattr(self, verb)(which, what)
        self.world.drain()
        return self

    def publish(self, which, port):
        if (which, port) not in self.gone:
            self._expect(self.topics[which][port])
            self.nodelets[which].handles[port].publish(self.count)

    def outside(self, _, topic):
        self._expect(topic)
        self.world.transport.send(topic, Message(self.count))

    def _expect(self, topic):
        for which, topics in enumerate(self.topics):
            for port in IN_PORTS if topic else ():
                if topics[port] == topic and (which, port) not in self.gone:
                    self.expected[which].append((port, self.count))

    def switch(self, which, moves):
        if which in self.gone:
            return
        self.nodelets[which].proxy.set_config(sorted(moves.items()))
        topics, before = self.topics[which], dict(self.topics[which])
        topics.update(moves)
        if topics != before:
            maps = [{port: topics[port] for port in side} for side in (IN_PORTS, OUT_PORTS)]
            self.expected[which].append(("switch", -len(self.moved[which]), *maps))
            self.moved[which].append([port for port in topics if topics[port] != before[port]])

    def step(self, _, drain):
        (self.world.drain if drain else self.world.executor.step)()

    def unregister(self, which, port):
        self.world.drain()  # the messages in its queue are dropped
        self.nodelets[which].handles[port].unregister()
        self.gone.add((which, port))

    def unload(self, which, _):
        self.nodelets[which].context.close()
        self.expected[which] = list(self.nodelets[which].log)
        self.gone.update([which, *((which, port) for port in self.topics[which])])

    def registered(self):
        return Counter(
            ("publisher" if port in OUT_PORTS else "subscriber", topic)
            for which, topics in enumerate(self.topics)
            for port, topic in topics.items()
            if topic and (which, port) not in self.gone
        )


def _grouped(log):
    """Two ports on one topic get a message in either order."""
    return [sorted(entries, key=str) for _, entries in groupby(log, key=lambda entry: entry[1])]


@examples(300)
@given(STEPS)
@example(  # a full queue goes before the switch and later messages; two ports swap their topics
    [
        ("switch", 0, {"out1": "/a", "out2": "/b", "in1": "/a", "in2": "/b"}),
        *[("publish", 0, "out1")] * 100,
        ("switch", 0, {"out1": "/b", "out2": "/a", "in1": "/b", "in2": "/a"}),
        ("publish", 0, "out1"),
        ("publish", 0, "out2"),
    ]
)
def test_every_message_arrives_once_in_order_and_on_its_side_of_each_switch(steps):
    model = Model().run(steps)
    for which, nodelet in enumerate(model.nodelets):
        assert _grouped(nodelet.log) == _grouped(model.expected[which])
        assert {p.name: p.topic for p in nodelet.proxy.get_config()} == model.topics[which]
    assert Counter(model.world.registrations) == model.registered()
    for nodelet in model.nodelets:
        nodelet.context.close()
    assert model.world.registrations == []
    assert model.world.bus._topics == {}


@examples(150)
@given(STEPS, st.integers(1, 3))
def test_a_bounded_queue_loses_only_what_it_counts(steps, queue_size):
    model = Model(queue_size).run([step for step in steps if step[0] != "unload"])
    for which, nodelet in enumerate(model.nodelets):
        dropped = {port.port: port.dropped for port in nodelet.proxy.get_statistics().ports}
        for port in IN_PORTS:

            def mine(log, port=port, moved=model.moved[which]):
                # A message that takes a dropped one's place may overtake those in between,
                # but never a switch of its own port.
                return [e for e in log if e[0] == port or (e[1] <= 0 and port in moved[-e[1]])]

            got, expected = mine(nodelet.log), mine(model.expected[which])
            rest = iter(expected)
            assert all(entry in rest for entry in got), "out of order, doubled, or a wrong side"
            assert len(got) + dropped[port] == len(expected)


def test_a_queue_is_bounded_for_each_connection_by_itself():
    # The first new message does not push out one that waits from the old topic.
    steps = [("switch", 0, {"out1": "/a", "out2": "/b", "in1": "/a"}), ("publish", 0, "out1")]
    model = Model(1).run([*steps, ("switch", 0, {"in1": "/b"}), ("publish", 0, "out2")])
    assert [entry[0] for entry in model.nodelets[0].log] == ["switch", "in1", "switch", "in1"]
