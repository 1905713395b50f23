# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""get_statistics: counts that add up."""

from __future__ import annotations

import pytest
from unit.nodelet.fakes import Message


def ignore(message):
    pass


def test_a_nodelet_has_its_uptime_and_its_ports_in_the_order_of_their_declaration(bench):
    for name in ("z", "a"):
        bench.nh.Publisher(name, Message)
    bench.nh.Subscriber("m", Message, ignore)
    bench.clock.seconds += 12.5
    bench.world.ticker.advance(1000.0)
    statistics = bench.nh.get_statistics()
    assert statistics == bench.proxy.get_statistics()
    assert statistics.uptime == 12.5
    assert [port.port for port in statistics.ports] == ["z", "a", "m"]
    for port in statistics.ports:
        assert port.messages == port.dropped == 0
        assert port.rate == port.mean_callback == port.max_callback == 0.0


def test_messages_of_an_unconnected_publisher_are_dropped_and_no_error(bench):
    publisher = bench.nh.Publisher("out", Message)
    for _ in range(3):
        publisher.publish(1)
    bench.connect(out="/t")
    publisher.publish(1)  # it has no subscriber, but it is sent
    bench.connect(out="")
    publisher.publish(1)
    assert (bench.port("out").messages, bench.port("out").dropped) == (1, 4)
    assert bench.proxy.get_statistics().callback_errors == 0


def test_callback_times_and_rates_of_an_in_port(bench):
    def work(message):
        bench.clock.seconds += message.number

    subscriber = bench.nh.Subscriber("in", Message, work)
    bench.connect(**{"in": "/t"})
    for seconds in (0.25, 0.75):
        bench.send("/t", seconds)
    traffic = bench.port("in")
    assert traffic.messages == 2
    assert traffic.mean_callback == pytest.approx(0.5)
    assert traffic.max_callback == 0.75
    assert traffic.rate == pytest.approx(1.0), "one in 0.25 s, then 0.75 s without a start"
    for busy in (1.0, 1.5, 2.0):
        assert bench.context.busy() == busy, "it counts once, however often it is subscribed"
        subscriber.unregister()
        assert bench.context.busy(with_running=True) == busy, "its time stays"
        subscriber = bench.nh.Subscriber("in", Message, work)
        bench.send("/t", 0.5)


def test_a_callback_that_still_runs_has_taken_its_time(bench):
    seen = []

    def work(message):
        bench.clock.seconds += 3.0
        seen.append((bench.context.busy(with_running=True), bench.context.busy()))

    bench.nh.Subscriber("in", Message, work)
    bench.connect(**{"in": "/t"})
    bench.send("/t", 1, 1)
    assert seen == [(3.0, 0.0), (6.0, 3.0)]
    assert bench.context.busy(with_running=True) == 6.0


def test_errors_and_losses_of_a_full_queue_are_counted(bench):
    bench.nh.Subscriber("in", Message, lambda message: 1 / 0, queue_size=2)
    bench.connect(**{"in": "/t"})
    bench.send("/t", *range(10))
    assert (bench.port("in").messages, bench.port("in").dropped) == (2, 8)
    assert bench.proxy.get_statistics().callback_errors == 2


def test_counts_survive_switches_and_handles_of_which_several_count_as_one(bench):
    publishers = [bench.nh.Publisher("out", Message) for _ in range(2)]
    subscribers = [bench.nh.Subscriber("in", Message, ignore) for _ in range(3)]
    for topic in ("/a", "/b", "/c"):
        bench.connect(out=topic, **{"in": topic})
        for publisher in publishers:
            publisher.publish(1)
        bench.world.drain()
    for handle in (*publishers, *subscribers):
        handle.unregister()
    assert bench.port("out").messages == bench.port("in").messages == 6
    bench.nh.Subscriber("in", Message, ignore)
    bench.nh.Publisher("out", Message).publish(1)
    bench.world.drain()
    statistics = bench.proxy.get_statistics()
    assert statistics.reconfigurations == 3
    assert [(port.messages, port.topic) for port in statistics.ports] == [(7, "/c")] * 2
