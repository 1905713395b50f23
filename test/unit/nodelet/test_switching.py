# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Switches of publications and subscriptions, in every order, against a simple model.

The model: a message goes to all subscriptions of its topic at the time of publishing, and a
nodelet's callbacks run in the order of its events. The bus must deliver nothing else.
"""

from __future__ import annotations

from collections import Counter
from itertools import groupby
from typing import List

from hypothesis import example, given
from hypothesis import strategies as st
from property_tests import examples
from unit.nodelet.fakes import Message, World

from dyknow.nodelet.bus import Endpoint

PUBLISHERS, SUBSCRIBERS = 3, 4
TOPICS = ("", "/a", "/b", "/c")

#: Publications are ends 0, 1, 2; subscriptions 3, 4, 5, 6 (two of each nodelet).
MOVES = st.dictionaries(
    st.integers(0, PUBLISHERS + SUBSCRIBERS - 1), st.sampled_from(TOPICS), min_size=1, max_size=5
)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), st.integers(0, PUBLISHERS - 1)),
        st.tuples(st.just("publish"), st.integers(0, PUBLISHERS - 1)),
        st.tuples(st.just("outside"), st.sampled_from(TOPICS[1:])),
        st.tuples(st.just("switch"), MOVES),
        st.tuples(st.just("step"), st.none()),
        st.tuples(st.just("drain"), st.none()),
        st.tuples(st.just("release"), st.integers(0, PUBLISHERS + SUBSCRIBERS - 1)),
        st.tuples(st.just("unload"), st.integers(0, SUBSCRIBERS // 2 - 1)),
    ),
    max_size=40,
)


class Bench:
    """Real ends on a bus, with the messages that the model expects at each."""

    def __init__(self, queue_size=None):
        self.world = World()
        self.contexts = [self.world.context(f"/n{n}") for n in range(SUBSCRIBERS // 2)]
        self.owner = self.world.context("/publishers")
        self.logs = [[] for _ in self.contexts]
        self.expected = [[] for _ in self.contexts]
        self.ends: List[Endpoint] = [
            self.owner.publication(str(n), Message, False, 1) for n in range(PUBLISHERS)
        ]
        for n in range(SUBSCRIBERS):
            context, log = self.contexts[n // 2], self.logs[n // 2]
            receive = lambda message, n=n, log=log: log.append((n, message.number))  # noqa: E731
            subscription = context.subscription(str(n), Message, queue_size, context.strand)
            subscription.receive = receive
            self.ends.append(subscription)
        self.topics = [""] * len(self.ends)
        self.released, self.unloaded = set(), set()
        self.moved = set()
        self.count = 0

    def run(self, steps):
        for verb, what in steps:
            getattr(self, verb)(what)
        self.drain()

    def publish(self, which):
        if which not in self.released:
            self._expect(self.topics[which])
            self.ends[which].publish(Message(self.count))

    def outside(self, topic):
        self._expect(topic)
        self.world.transport.send(topic, Message(self.count))

    def _expect(self, topic):
        self.count += 1
        for n in range(SUBSCRIBERS):
            if topic and self.topics[PUBLISHERS + n] == topic:
                self.expected[n // 2].append((n, self.count))

    def switch(self, moves):
        moves = {end: topic for end, topic in moves.items() if end not in self.released}
        self.count += 1
        marker = ("switch", self.count)

        def mark():
            for context, log in zip(self.contexts, self.logs):
                context.strand.post(lambda log=log: log.append(marker))

        self.world.bus.rewire([(self.ends[e], topic) for e, topic in moves.items()], mark)
        for end, topic in moves.items():
            if self.topics[end] != topic:
                self.moved.add((end, self.count))
            self.topics[end] = topic
        for which, expected in enumerate(self.expected):
            if which not in self.unloaded:
                expected.append(marker)

    def step(self, _):
        self.world.executor.step()

    def drain(self, _=None):
        self.world.drain()

    def release(self, end):
        self.drain()  # drops by a release are tested elsewhere
        self.released.add(end)
        self.topics[end] = ""
        self.world.bus.release([self.ends[end]])

    def unload(self, gone):
        """Close a nodelet, whose queued messages are dropped: it hears nothing more."""
        self.contexts[gone].close()
        self.expected[gone] = list(self.logs[gone])
        self.unloaded.add(gone)
        for end in range(PUBLISHERS + 2 * gone, PUBLISHERS + 2 * gone + 2):
            self.released.add(end)
            self.topics[end] = ""

    def agrees(self):
        """Whether everything came as expected; subscriptions of one nodelet go in any order."""
        return [_grouped(log) for log in self.logs] == [_grouped(log) for log in self.expected]

    def registered(self):
        kinds = ["publisher"] * PUBLISHERS + ["subscriber"] * SUBSCRIBERS
        return Counter((kind, topic) for kind, topic in zip(kinds, self.topics) if topic)


def _grouped(log):
    return [sorted(entries, key=str) for _, entries in groupby(log, key=lambda entry: entry[1])]


#: A full queue goes before the switch and what follows it; two ends swap their topics.
SWITCHED_FULL = [
    ("switch", {0: "/a", 1: "/b", 3: "/a", 4: "/b"}),
    *[("publish", 0)] * 100,
    ("switch", {0: "/b", 1: "/a", 3: "/b", 4: "/a"}),
    ("publish", 0),
    ("publish", 1),
]


@examples(300)
@given(STEPS)
@example(SWITCHED_FULL)
def test_every_message_arrives_once_in_order_and_on_its_side_of_each_switch(steps):
    bench = Bench()
    bench.run(steps)
    assert bench.agrees(), (bench.logs, bench.expected)
    assert Counter(bench.world.registrations) == bench.registered()
    assert [end.topic for end in bench.ends] == bench.topics
    for context in (bench.owner, *bench.contexts):
        context.close()
    assert bench.world.registrations == []
    assert bench.world.bus._topics == {}


@examples(150)
@given(STEPS, st.integers(1, 3))
def test_a_bounded_queue_loses_only_what_it_counts(steps, queue_size):
    bench = Bench(queue_size)
    bench.run([step for step in steps if step[0] != "unload"])
    for n in range(SUBSCRIBERS):
        # A message that takes a dropped one's place may overtake what came in between, but never
        # a switch of its own subscription.
        mine = {("switch", count) for end, count in bench.moved if end == PUBLISHERS + n}
        expected = [each for each in bench.expected[n // 2] if each[0] == n or each in mine]
        got = [each for each in bench.logs[n // 2] if each[0] == n or each in mine]
        rest = iter(expected)
        assert all(entry in rest for entry in got), "out of order, doubled, or on the wrong side"
        dropped = bench.ends[PUBLISHERS + n].traffic.dropped
        assert len(got) + dropped == len(expected)


def test_a_queue_is_bounded_for_each_connection_by_itself():
    # The first new message does not push out one that waits from the old topic.
    bench = Bench(queue_size=1)
    bench.switch({0: "/a", 1: "/b", 3: "/a"})
    bench.publish(0)
    bench.switch({3: "/b"})
    bench.publish(1)
    bench.drain()
    assert [entry[0] for entry in bench.logs[0]] == ["switch", 0, "switch", 0]
