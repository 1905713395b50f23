# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What happens to a message between publish and callback, within one process."""

from __future__ import annotations

import pytest
from unit.nodelet.fakes import AnyMessage, FakeClock, Message, OtherMessage, numbers

from dyknow.errors import HandleClosed, TypeMismatch
from dyknow.nodelet.endpoints import Traffic


def test_every_subscriber_gets_the_very_object_that_was_published(world):
    got = []
    nh = world.handle()
    nh.Subscriber("t", Message, got.append)
    world.handle("/second").Subscriber("/t", Message, got.append)
    message = Message(1)
    nh.Publisher("t", Message, queue_size=1).publish(message)
    world.drain()
    assert len(got) == 2
    assert got[0] is message and got[1] is message


def test_a_message_can_be_given_as_its_fields(world):
    got = []
    nh = world.handle()
    nh.Subscriber("t", Message, got.append)
    publisher = nh.Publisher("t", Message, queue_size=1)
    publisher.publish(1)
    publisher.publish(number=2)
    publisher.publish()
    world.drain()
    assert numbers(got) == [1, 2, 0]
    with pytest.raises(TypeError):
        publisher.publish(1, 2, 3)


def test_callbacks_run_on_the_strand_and_not_in_publish(world):
    got = []
    nh = world.handle()
    nh.Subscriber("t", Message, got.append)
    nh.Publisher("t", Message, queue_size=1).publish(1)
    assert got == []
    world.drain()
    assert len(got) == 1


def test_a_full_queue_drops_the_oldest_and_counts_it(world):
    got = []
    nh = world.handle()
    subscriber = nh.Subscriber("t", Message, got.append, queue_size=2)
    publisher = nh.Publisher("t", Message, queue_size=1)
    for number in range(5):
        publisher.publish(number)
    world.drain()
    publisher.publish(5)
    world.drain()
    assert numbers(got) == [3, 4, 5]
    traffic = subscriber.subscription.traffic
    assert (traffic.messages, traffic.dropped) == (3, 3)


@pytest.mark.parametrize("queue_size", [None, 0])
def test_without_a_bound_nothing_is_dropped(world, queue_size):
    got = []
    nh = world.handle()
    nh.Subscriber("t", Message, got.append, queue_size=queue_size)
    publisher = nh.Publisher("t", Message, queue_size=1)
    for number in range(1000):
        publisher.publish(number)
    world.drain()
    assert numbers(got) == list(range(1000))


def test_subscriptions_have_queues_of_their_own(world):
    small, large = [], []
    nh = world.handle()
    nh.Subscriber("t", Message, small.append, queue_size=1)
    nh.Subscriber("t", Message, large.append, queue_size=10)
    publisher = nh.Publisher("t", Message, queue_size=1)
    for number in range(5):
        publisher.publish(number)
    world.drain()
    assert numbers(small) == [4]
    assert numbers(large) == [0, 1, 2, 3, 4]


def test_messages_of_several_topics_are_called_back_in_the_order_of_publishing(world):
    got = []
    nh = world.handle()
    nh.Subscriber("a", Message, got.append)
    nh.Subscriber("b", Message, got.append)
    publishers = [nh.Publisher(topic, Message, queue_size=1) for topic in ("a", "b")]
    for number in range(10):
        publishers[number % 2].publish(number)
    world.drain()
    assert numbers(got) == list(range(10))


def test_a_failing_callback_takes_nothing_else_down(world, caplog):
    got = []
    nh = world.handle("/failing")

    def fail(message):
        got.append(message)
        if message.number == 0:
            raise ValueError("no good")
        if message.number == 1:
            raise SystemExit

    nh.Subscriber("t", Message, fail)
    neighbour = []
    world.handle("/neighbour").Subscriber("/t", Message, neighbour.append)
    publisher = nh.Publisher("t", Message, queue_size=1)
    for number in range(3):
        publisher.publish(number)
    world.drain()
    assert numbers(got) == numbers(neighbour) == [0, 1, 2]
    assert nh.context.callback_errors == 2
    assert "/failing: the callback of 't' raised" in caplog.text
    assert "ValueError: no good" in caplog.text
    assert "Traceback" in caplog.text


class TestLatch:
    def test_a_late_subscriber_gets_the_last_message_once(self, world):
        got = []
        nh = world.handle()
        publisher = nh.Publisher("t", Message, latch=True, queue_size=1)
        publisher.publish(1)
        publisher.publish(2)
        nh.Subscriber("t", Message, got.append)
        world.drain()
        assert numbers(got) == [2]
        publisher.publish(3)
        world.drain()
        assert numbers(got) == [2, 3]

    def test_each_of_several_publishers_gives_its_last(self, world):
        got = []
        nh = world.handle()
        for number in (1, 2):
            nh.Publisher("t", Message, latch=True, queue_size=1).publish(number)
        nh.Subscriber("t", Message, got.append)
        world.drain()
        assert sorted(numbers(got)) == [1, 2]

    def test_subscribers_that_are_there_get_it_only_when_it_is_published(self, world):
        got = []
        nh = world.handle()
        nh.Subscriber("t", Message, got.append)
        nh.Publisher("t", Message, latch=True, queue_size=1).publish(1)
        nh.Subscriber("t", Message, lambda message: None)
        nh.Subscriber("u", Message, lambda message: None)
        world.drain()
        assert numbers(got) == [1]

    def test_without_latch_a_late_subscriber_gets_nothing(self, world):
        got = []
        nh = world.handle()
        nh.Publisher("t", Message, queue_size=1).publish(1)
        nh.Subscriber("t", Message, got.append)
        world.drain()
        assert got == []

    def test_it_moves_with_the_publication(self, world):
        there, here = [], []
        nh = world.handle()
        nh.Subscriber("old", Message, here.append)
        nh.Subscriber("new", Message, there.append)
        publisher = nh.Publisher("old", Message, latch=True, queue_size=1)
        publisher.publish(1)
        world.bus.rewire([(publisher.publication, "/new")])
        world.drain()
        assert numbers(here) == numbers(there) == [1]

    def test_both_ends_that_move_together_meet_it_once(self, world):
        got = []
        nh = world.handle()
        subscriber = nh.Subscriber("old", Message, got.append)
        publisher = nh.Publisher("old", Message, latch=True, queue_size=1)
        publisher.publish(1)
        world.drain()
        moves = [
            (subscriber.subscription, "/new"),
            (publisher.publication, "/new"),
        ]
        world.bus.rewire(moves)
        world.drain()
        assert numbers(got) == [1, 1], "once on each connection"

    def test_it_goes_with_its_publisher(self, world):
        got = []
        nh = world.handle()
        publisher = nh.Publisher("t", Message, latch=True, queue_size=1)
        publisher.publish(1)
        publisher.unregister()
        nh.Subscriber("t", Message, got.append)
        world.drain()
        assert got == []


class TestTypes:
    def test_a_second_type_on_a_topic_is_refused_by_name(self, world):
        nh = world.handle()
        nh.Publisher("t", Message, queue_size=1)
        with pytest.raises(TypeMismatch) as caught:
            nh.Subscriber("t", OtherMessage, print)
        assert "'/t' carries test/Message, but test/OtherMessage" in str(caught.value)
        with pytest.raises(TypeMismatch):
            nh.Publisher("t", OtherMessage, queue_size=1)

    def test_a_refused_handle_leaves_nothing_behind(self, world):
        got = []
        nh = world.handle()
        publisher = nh.Publisher("t", Message, queue_size=1)
        before = world.registrations
        for make in (nh.Subscriber, nh.Publisher):
            with pytest.raises(TypeMismatch):
                make("t", OtherMessage, got.append)
        publisher.publish(1)
        world.drain()
        assert got == []
        assert world.registrations == before
        publisher.unregister()
        nh.Publisher("t", OtherMessage, queue_size=1)

    def test_a_topic_may_change_type_once_nobody_is_on_it(self, world):
        nh = world.handle()
        nh.Publisher("t", Message, queue_size=1).unregister()
        assert world.bus.datatype_of("/t") == ""
        nh.Publisher("t", OtherMessage, queue_size=1)
        assert world.bus.datatype_of("/t") == "test/OtherMessage"

    def test_a_subscriber_of_any_type_fits_every_topic(self, world):
        got = []
        nh = world.handle()
        nh.Subscriber("t", AnyMessage, got.append)
        assert world.bus.datatype_of("/t") == ""
        nh.Publisher("t", OtherMessage, queue_size=1).publish(1)
        nh.Subscriber("t", AnyMessage, got.append)
        with pytest.raises(TypeMismatch):
            nh.Publisher("t", Message, queue_size=1)
        world.drain()
        assert numbers(got) == [1]
        assert type(got[0]) is OtherMessage

    def test_a_topic_on_which_only_any_is_left_takes_every_type_again(self, world):
        nh = world.handle()
        nh.Subscriber("t", AnyMessage, print)
        nh.Publisher("t", Message, queue_size=1).unregister()
        assert world.bus.datatype_of("/t") == ""
        nh.Publisher("t", OtherMessage, queue_size=1)
        assert world.bus.datatype_of("/t") == "test/OtherMessage"

    def test_a_refused_type_does_not_become_that_of_a_topic_of_any(self, world):
        nh = world.handle()
        nh.Subscriber("t", AnyMessage, print)
        world.transport.refused["/t"] = RuntimeError("no")
        with pytest.raises(RuntimeError):
            nh.Publisher("t", Message, queue_size=1)
        del world.transport.refused["/t"]
        nh.Publisher("t", OtherMessage, queue_size=1)

    def test_the_type_of_a_topic_outside_is_asked_for(self, world):
        world.transport.types["/t"] = "test/Outside"
        assert world.bus.datatype_of("/t") == "test/Outside"


class TestUnregister:
    def test_publishing_afterwards_raises(self, world):
        nh = world.handle("/probe")
        publisher = nh.Publisher("t", Message, queue_size=1)
        publisher.unregister()
        with pytest.raises(HandleClosed, match="publisher 't' of /probe is closed"):
            publisher.publish(1)

    def test_a_bound_publish_raises_too(self, world):
        publisher = world.handle().Publisher("t", Message, queue_size=1)
        publish = publisher.publish
        publisher.unregister()
        with pytest.raises(HandleClosed):
            publish(1)

    def test_queued_messages_are_dropped(self, world):
        got = []
        nh = world.handle()
        subscriber = nh.Subscriber("t", Message, got.append)
        publisher = nh.Publisher("t", Message, queue_size=1)
        publisher.publish(1)
        subscriber.unregister()
        publisher.publish(2)
        world.drain()
        assert got == []

    def test_twice_is_once(self, world):
        nh = world.handle()
        publisher = nh.Publisher("t", Message, queue_size=1)
        other = nh.Publisher("t", Message, queue_size=1)
        subscriber = nh.Subscriber("t", Message, print)
        for _ in range(2):
            publisher.unregister()
            subscriber.unregister()
        assert world.registrations == [("publisher", "/t")]
        other.publish(1)


class TestTraffic:
    def test_counts_and_callback_times(self):
        clock = FakeClock()
        traffic = Traffic(clock)
        for took in (0.1, 0.3):
            start = clock()
            clock.seconds += took
            traffic.received(start)
            clock.seconds += 1.0
        assert traffic.messages == 2
        assert traffic.busy == pytest.approx(0.4)
        assert traffic.longest == pytest.approx(0.3)

    def test_rate_follows_and_falls_in_silence(self):
        clock = FakeClock()
        traffic = Traffic(clock)
        assert traffic.rate() == 0.0
        traffic.sent()
        assert traffic.rate() == 0.0
        for _ in range(200):
            clock.seconds += 0.1
            traffic.sent()
        assert traffic.rate() == pytest.approx(10.0)
        clock.seconds += 63.0
        assert traffic.rate() < 1.0
        for _ in range(100):
            clock.seconds += 0.01
            traffic.sent()
        assert traffic.rate() == pytest.approx(100.0)


def test_the_same_error_is_logged_once_a_second_with_the_number_of_the_others(world, caplog):
    now = [0.0]
    context = world.context("/n")
    object.__setattr__(context.runtime, "clock", lambda: now[0])
    for _ in range(1000):
        context.failed("'in'", ValueError("same"))
    context.failed("'in'", ValueError("other"))
    assert context.callback_errors == 1001
    assert [record.getMessage().count("same") for record in caplog.records] == [1, 0]
    now[0] = 1.5
    caplog.clear()
    context.failed("'in'", ValueError("same"))
    assert "999 times more" in caplog.records[0].getMessage()
    assert "ValueError: same" in caplog.records[0].getMessage()
