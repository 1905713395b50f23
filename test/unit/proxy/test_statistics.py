# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""get_statistics: counts that add up."""

from __future__ import annotations

import pytest
from unit.nodelet.fakes import FakeClock, Message, World

import dyknow
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.proxy import NodeletProxy


class Bench:
    """A nodelet on a clock that the test sets."""

    def __init__(self):
        self.clock = FakeClock()
        self.world = World(clock=self.clock)
        self.context = self.world.context("/n")
        self.nh = dyknow.NodeHandle(PlainNodeHandle(self.context, "/"))
        self.proxy = NodeletProxy.of(self.context)

    def port(self, name):
        (found,) = [p for p in self.proxy.get_statistics().ports if p.port == name]
        return found


@pytest.fixture(name="bench")
def _bench():
    return Bench()


def test_uptime_is_steady_time_since_the_load(bench):
    bench.clock.seconds += 12.5
    bench.world.ticker.advance(1000.0)
    assert bench.proxy.get_statistics().uptime == 12.5


def test_ports_come_in_the_order_of_their_declaration(bench):
    for name in ("z", "a", "m"):
        bench.nh.Publisher(name, Message)
    assert [p.port for p in bench.proxy.get_statistics().ports] == ["z", "a", "m"]


def test_what_an_unconnected_publisher_is_given_is_dropped_and_no_error(bench):
    publisher = bench.nh.Publisher("out", Message)
    for _ in range(3):
        publisher.publish(1)
    traffic = bench.port("out")
    assert (traffic.messages, traffic.dropped) == (0, 3)
    bench.proxy.set_config([("out", "/t")])
    publisher.publish(1)
    bench.proxy.set_config([("out", "")])
    publisher.publish(1)
    traffic = bench.port("out")
    assert (traffic.messages, traffic.dropped) == (1, 4)
    assert bench.proxy.get_statistics().callback_errors == 0


def test_what_nobody_hears_is_sent_and_not_dropped(bench):
    publisher = bench.nh.Publisher("out", Message)
    bench.proxy.set_config([("out", "/t")])
    publisher.publish(1)
    assert (bench.port("out").messages, bench.port("out").dropped) == (1, 0)


def test_callback_times_and_rates_of_an_in_port(bench):
    def work(message):
        bench.clock.seconds += message.number

    bench.nh.Subscriber("in", Message, work)
    bench.proxy.set_config([("in", "/t")])
    publisher = bench.world.handle("/probe").Publisher("/t", Message)
    for seconds in (0.25, 0.75):
        publisher.publish(seconds)
        bench.world.drain()
    traffic = bench.port("in")
    assert traffic.messages == 2
    assert traffic.mean_callback == pytest.approx(0.5)
    assert traffic.max_callback == 0.75
    assert traffic.rate == pytest.approx(1.0), "one in 0.25 s, then 0.75 s without a start"


def test_what_a_full_queue_loses_is_counted(bench):
    bench.nh.Subscriber("in", Message, lambda message: None, queue_size=2)
    bench.proxy.set_config([("in", "/t")])
    publisher = bench.world.handle("/probe").Publisher("/t", Message)
    for number in range(10):
        publisher.publish(number)
    bench.world.drain()
    assert (bench.port("in").messages, bench.port("in").dropped) == (2, 8)


def test_errors_are_counted_and_so_are_their_messages(bench):
    bench.nh.Subscriber("in", Message, lambda message: 1 / 0)
    bench.proxy.set_config([("in", "/t")])
    bench.world.handle("/probe").Publisher("/t", Message).publish(1)
    bench.world.drain()
    assert bench.proxy.get_statistics().callback_errors == 1
    assert bench.port("in").messages == 1


def test_counts_survive_a_switch(bench):
    publisher = bench.nh.Publisher("out", Message)
    for topic in ("/a", "/b", "/c"):
        bench.proxy.set_config([("out", topic)])
        publisher.publish(1)
    statistics = bench.proxy.get_statistics()
    assert statistics.reconfigurations == 3
    assert statistics.ports[0].messages == 3
    assert statistics.ports[0].topic == "/c"


def test_several_handles_count_as_one_port(bench):
    for _ in range(3):
        bench.nh.Subscriber("in", Message, lambda message: None)
    publishers = [bench.nh.Publisher("out", Message) for _ in range(2)]
    bench.proxy.set_config([("in", "/t"), ("out", "/t")])
    for publisher in publishers:
        publisher.publish(1)
    bench.world.drain()
    assert bench.port("out").messages == 2
    assert bench.port("in").messages == 2, "a message is received once by the port"


def test_counts_outlive_the_handles(bench):
    publisher = bench.nh.Publisher("out", Message)
    subscriber = bench.nh.Subscriber("in", Message, lambda message: None)
    bench.proxy.set_config([("in", "/t"), ("out", "/t")])
    publisher.publish(1)
    bench.world.drain()
    publisher.unregister()
    subscriber.unregister()
    assert bench.port("out").messages == bench.port("in").messages == 1
    bench.nh.Subscriber("in", Message, lambda message: None)
    bench.nh.Publisher("out", Message).publish(1)
    bench.world.drain()
    assert bench.port("out").messages == bench.port("in").messages == 2


def test_a_port_without_traffic_has_zeros(bench):
    bench.nh.Subscriber("in", Message, print)
    traffic = bench.port("in")
    assert traffic.messages == traffic.dropped == 0
    assert traffic.rate == traffic.mean_callback == traffic.max_callback == 0.0


def test_a_nodelet_has_them_from_its_handle(bench):
    publisher = bench.nh.Publisher("out", Message)
    bench.proxy.set_config([("out", "/t")])
    publisher.publish(1)
    bench.clock.seconds += 2.0
    statistics = bench.nh.get_statistics()
    assert statistics == bench.proxy.get_statistics()
    assert (statistics.uptime, statistics.reconfigurations) == (2.0, 1)
    (out,) = statistics.ports
    assert (out.port, out.topic, out.messages) == ("out", "/t", 1)
