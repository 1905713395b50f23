# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Switches under fire: publishers at full speed on threads of their own, real workers."""

from __future__ import annotations

import threading

import pytest
from unit.nodelet.fakes import Message, in_thread, join, paced, pool_world

pytestmark = pytest.mark.usefixtures("impatient_interpreter")
world = pool_world(3)

SWITCHES = 400


class Stream:
    """A publisher that counts up as fast as its reader keeps pace."""

    def __init__(self, world, name, topic):
        self.handle = world.handle(name)
        self.publisher = self.handle.Publisher(topic, Message, queue_size=1)
        self.end = self.publisher.publication
        self.sent = 0
        self.received = 0
        self.going = True

    def start(self):
        self.thread = in_thread(self._run)

    def _run(self):
        while self.going:
            # A bound on what is under way, or memory would set the pace.
            if self.sent - self.received < 1000:
                self.sent += 1
                self.publisher.publish((self, self.sent))
            else:
                threading.Event().wait(0.0005)


def end(world, *streams):
    """Let the last messages arrive."""
    for stream in streams:
        stream.going = False
    join(*[stream.thread for stream in streams])
    world.drain()


def switches(*streams):
    """Numbers of the switches to make."""
    return paced(SWITCHES, *[lambda stream=stream: stream.sent for stream in streams])


def watcher(faults):
    """Make a callback that checks the numbers of each stream."""
    last = {}

    def receive(message):
        stream, number = message.number
        if number != last.get(stream, 0) + 1:
            faults.append((stream, last.get(stream, 0), number))
        last[stream] = number
        stream.received = number

    return receive


def test_publishers_move_between_topics_that_one_nodelet_hears_both(world):
    # One strand, two subscriptions: even the order across the two topics must stay.
    faults = []
    streams = [Stream(world, f"/source{n}", "a") for n in range(3)]
    sink = world.handle("/sink")
    receive = watcher(faults)
    for topic in ("/a", "/b"):
        sink.Subscriber(topic, Message, receive)
    for stream in streams:
        stream.start()
    for number in switches(*streams):
        for stream in streams:
            world.bus.rewire([(stream.end, "/" + "ab"[number % 2])])
    end(world, *streams)
    assert faults == []
    assert [s.received for s in streams] == [s.sent for s in streams]


def test_a_subscriber_that_moves_gets_a_gapless_piece_of_each_topic(world):
    # While it is away from a topic it misses messages; within a visit it must miss none.
    visits = [[]]
    streams = {topic: Stream(world, f"/source{topic}", f"/{topic}") for topic in "ab"}

    def receive(message):
        visits[-1].append(message.number)

    sink = world.handle("/sink")
    subscriber = sink.Subscriber("/a", Message, receive)
    listeners = world.handle("/pace")
    for topic, stream in streams.items():
        listeners.Subscriber(
            f"/{topic}", Message, lambda m: setattr(m.number[0], "received", m.number[1])
        )
        assert stream.publisher.name == f"/{topic}"
    for stream in streams.values():
        stream.start()
    for number in switches(*streams.values()):
        world.bus.rewire(
            [(subscriber.subscription, "/" + "ba"[number % 2])],
            on_switch=lambda: sink.context.strand.post(lambda: visits.append([])),
        )
    end(world, *streams.values())
    seen = {stream: 0 for stream in streams.values()}
    for number, visit in enumerate(visits):
        stream = streams["ab"[number % 2]]
        assert {each for each, _ in visit} <= {stream}, "on the wrong side of a switch"
        numbers = [each for _, each in visit]
        if numbers:
            assert numbers[0] > seen[stream], "a message came twice"
            assert numbers == list(range(numbers[0], numbers[-1] + 1)), "a message was lost"
            seen[stream] = numbers[-1]
    assert len(visits) == SWITCHES + 1
    assert len([visit for visit in visits if visit]) > 10


def test_handles_that_come_and_go_disturb_nobody(world):
    faults = []
    stream = Stream(world, "/source", "t")
    world.handle("/sink").Subscriber("/t", Message, watcher(faults))
    before = world.registrations
    stream.start()
    guest = world.handle("/guest")
    for _ in switches(stream):
        subscriber = guest.Subscriber("/t", Message, lambda message: None, queue_size=1)
        publisher = guest.Publisher("/t", Message, queue_size=1)
        subscriber.unregister()
        publisher.unregister()
    end(world, stream)
    assert faults == []
    assert stream.received == stream.sent
    assert world.registrations == before


def test_switching_threads_do_not_get_in_each_others_way(world):
    faults = []
    pairs = []
    for n in range(4):
        stream = Stream(world, f"/source{n}", f"t{n}")
        sink = world.handle(f"/sink{n}").Subscriber(f"/t{n}", Message, watcher(faults))
        pairs.append((stream, sink.subscription))

    def switch(n, stream, subscription):
        for number in range(SWITCHES // 4):
            topic = f"/t{n}_{number % 3}"
            world.bus.rewire([(stream.end, topic), (subscription, topic)])

    for stream, _ in pairs:
        stream.start()
    join(*[in_thread(lambda n=n, p=p: switch(n, *p)) for n, p in enumerate(pairs)])
    end(world, *[stream for stream, _ in pairs])
    assert faults == []
    assert all(stream.received == stream.sent for stream, _ in pairs)
    assert len(world.registrations) == 8
