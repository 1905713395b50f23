# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""set_config under fire: real workers, publishers at full speed, thousands of switches."""

from __future__ import annotations

import threading

import pytest
from clocks import eventually, in_thread, join
from unit.nodelet.fakes import Message, paced, pool_world

import dyknow
from dyknow.errors import HandleClosed, UnloadedMeanwhile
from dyknow.proxy.proxy import NodeletProxy

pytestmark = pytest.mark.usefixtures("impatient_interpreter")
world = pool_world(3)

SWITCHES = 400


class Filter(dyknow.Nodelet):
    """Checks messages in the order of its queue, and passes them on."""

    def on_init(self):
        nh = dyknow.NodeHandle(self.node_handle)
        self.faults, self.last, self.maps = [], 0, []
        self.out = nh.Publisher("out", Message, queue_size=1)
        nh.Subscriber("in", Message, self.on_message)
        nh.set_reconfigure_callback(lambda inputs, outputs: self.maps.append(inputs["in"]))

    def on_message(self, message):
        if message.number != self.last + 1:
            self.faults.append((self.last, message.number))
        self.last = message.number
        self.out.publish(message.number)


class Pump:
    """Publishes as fast as the end of the chain keeps pace; at most 1000 are under way."""

    def __init__(self, publisher, sink):
        self.sent, self.going = 0, True
        self._publisher, self._sink = publisher, sink
        self.thread = in_thread(self._run)

    def _run(self):
        while self.going:
            if self.sent - self._sink.last < 1000:
                self.sent += 1
                self._publisher.publish(self.sent)
            else:
                threading.Event().wait(0.0005)

    def stop(self):
        self.going = False
        join(self.thread)


def proxy_of(nodelet):
    return NodeletProxy.of(nodelet.context)


def test_a_chain_that_is_rewired_all_the_time_loses_and_doubles_nothing(world):
    # Each nodelet's in-port and the out-port before it cannot move in one call, so the in-port
    # listens on both topics for a while, through a second port of the same nodelet.
    loader = world.loader(filter=Filter)
    first = loader.load("/first", "filter", {"/out": "/m0"})
    last = loader.load("/last", "filter", {"/in": "/m0"})
    spare = dyknow.NodeHandle(last.node_handle)
    spare.Subscriber("in2", Message, last.on_message)
    pump = Pump(first.out, last)
    ports = ["in", "in2"]
    for number in paced(SWITCHES, lambda: pump.sent):
        old, new = ports
        topic = f"/m{(number + 1) % 5}"
        proxy_of(last).set_config([(new, topic)])
        proxy_of(first).set_config([("out", topic)])
        proxy_of(last).set_config([(old, "")])
        ports.reverse()
    pump.stop()
    world.drain()
    assert last.faults == []
    assert last.last == pump.sent > SWITCHES
    assert proxy_of(first).get_statistics().reconfigurations == SWITCHES
    assert proxy_of(first).get_statistics().ports[0].messages == pump.sent
    loader.close()
    assert world.registrations == []


def test_nodelets_whose_both_ends_move_hear_themselves_in_order_and_know_their_topics(world):
    loader = world.loader(filter=Filter)

    def loop(name):
        nodelet = loader.load(name, "filter")
        source = dyknow.NodeHandle(nodelet.node_handle).Publisher("source", Message, queue_size=1)
        proxy = proxy_of(nodelet)
        proxy.set_config([("source", f"{name}0"), ("in", f"{name}0")])
        pump = Pump(source, nodelet)
        for number in paced(SWITCHES // 4, lambda: pump.sent):
            topic = f"{name}{(number + 1) % 7}"
            config = [("source", topic), ("in", topic)]
            proxy.set_config(config[::-1] if number % 2 else config)
        pump.stop()
        pumps.append((pump, nodelet))

    pumps: list[tuple[Pump, Filter]] = []
    join(*[in_thread(lambda name=name: loop(name)) for name in ("/a", "/b", "/c", "/d")])
    world.drain()
    assert len(pumps) == 4
    for pump, nodelet in pumps:
        assert nodelet.faults == []
        assert nodelet.last == pump.sent > SWITCHES // 4
        assert nodelet.maps == [f"{nodelet.name}{n % 7}" for n in range(SWITCHES // 4 + 1)]


def test_an_unload_amid_switches_from_many_threads_leaves_nothing(world):
    loader = world.loader(filter=Filter)
    for _ in range(12):
        nodelet = loader.load("/n", "filter", {"/in": "/a", "/out": "/b"})
        ended = []

        def switch(which, nodelet=nodelet, ended=ended):
            number = 0
            try:
                while True:
                    number += 1
                    config = [("in", f"/a{which}{number % 3}"), ("out", f"/b{number % 2}")]
                    proxy_of(nodelet).set_config(config)
            except UnloadedMeanwhile:
                ended.append(which)

        def publish(nodelet=nodelet, ended=ended):
            try:
                while True:
                    nodelet.out.publish(1)
            except HandleClosed:
                ended.append("publisher")

        threads = [in_thread(lambda w=w: switch(w)) for w in range(3)]
        threads.append(in_thread(publish))
        eventually(lambda n=nodelet: proxy_of(n).get_statistics().reconfigurations > 5)
        loader.unload("/n")
        join(*threads)
        assert sorted(map(str, ended)) == ["0", "1", "2", "publisher"]
        assert world.registrations == []
        assert world.bus._topics == {}
        assert world.bus._making == []


def test_handles_that_come_and_go_do_not_fail_set_config(world):
    loader = world.loader(filter=Filter)
    nodelet = loader.load("/n", "filter")
    going, failed = [True], []

    def come_and_go():
        nh = dyknow.NodeHandle(nodelet.mt_node_handle)
        try:
            while going[0]:
                subscriber = nh.Subscriber("in", Message, lambda message: None)
                publisher = nh.Publisher("guest", Message)
                subscriber.unregister()
                publisher.unregister()
        except Exception as error:
            failed.append(error)

    threads = [in_thread(come_and_go) for _ in range(2)]
    eventually(lambda: "guest" in [port.name for port in proxy_of(nodelet).get_config()])
    for number in range(SWITCHES // 2):
        topic = f"/t{number % 3}"
        proxy_of(nodelet).set_config([("in", topic), ("guest", topic)])
    going[0] = False
    join(*threads)
    assert failed == []
    assert [r for r in world.registrations if r[0] == "subscriber"] == [("subscriber", topic)]
    loader.close()
    assert world.registrations == []
    assert world.bus._topics == {}


def test_handles_that_are_made_at_once_share_one_proxy(world, monkeypatch):
    context = world.context("/bare")
    make, made, opened, others = NodeletProxy.__init__, [], [], threading.Event()

    def wait_for_others(proxy, of):
        made.append(proxy)
        if len(made) > 1:
            others.set()
        others.wait(0.2)  # a call that slips in between check and act has arrived by then
        make(proxy, of)

    monkeypatch.setattr(NodeletProxy, "__init__", wait_for_others)
    context.on_attach = lambda context, proxy: opened.append(proxy)
    found = []
    threads = [in_thread(lambda: found.append(NodeletProxy.of(context))) for _ in range(4)]
    for thread in threads:
        join(thread)
    assert made == opened == [found[0]]
    assert found == [found[0]] * 4
