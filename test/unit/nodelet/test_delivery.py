# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Delivery of messages from publish to callback, within one process."""

from __future__ import annotations

import collections

import pytest
from unit.nodelet.fakes import AnyMessage, FakeClock, Message, OtherMessage, WithoutText, World

from dyknow.errors import HandleClosed, TypeMismatch


def test_a_message_can_be_given_as_its_fields(world):
    got, publisher = world.listen("/t"), world.publisher("/t")
    publisher.publish(1)
    publisher.publish(number=2)
    publisher.publish()
    world.drain()
    assert got == [1, 2, 0]
    with pytest.raises(TypeError):
        publisher.publish(1, 2, 3)


def test_each_subscription_has_a_queue_with_a_bound_of_its_own_or_none(world):
    sizes = {1: [99], 10: list(range(90, 100)), None: list(range(100)), 0: list(range(100))}
    got = {size: world.listen("/t", queue_size=size) for size in sizes}
    publisher = world.publisher("/t")
    for number in range(100):
        publisher.publish(number)
    world.drain()
    assert got == sizes


def test_the_newest_message_stays_if_the_oldest_is_delivered_at_that_moment(world):
    got = []
    subscriber = world.handle().Subscriber("/t", Message, got.append, queue_size=1)
    connection, publisher = subscriber.subscription.connection, world.publisher("/t")

    class Queue(collections.deque):
        def __len__(self):
            length = super().__len__()
            if length == 2 and not got:
                world.drain()
            return length

    connection._queue = Queue()
    first, last = Message(1), Message(2)
    publisher.publish(first)
    publisher.publish(last)
    world.drain()
    assert (got, subscriber.subscription.traffic.dropped) == ([first, last], 0)


def test_a_message_goes_out_once_and_only_if_somebody_listens(world):
    for _ in range(3):
        world.listen("/t")
    publisher = world.publisher("/t")
    registration, sent, message = world.transport.made[-1], [], Message(2)
    registration.publish = sent.append
    publisher.publish(1)
    registration.connections.append(print)
    publisher.publish(message)
    assert sent == [message]


def test_a_busy_nodelet_lets_others_in_between(world):
    order, publisher = [], world.publisher("/greedy")

    def again(message):
        order.append("greedy")
        if len(order) < 1000:
            publisher.publish()

    world.handle("/g").Subscriber("/greedy", Message, again)
    world.handle("/m").Subscriber("/modest", Message, lambda message: order.append("modest"))
    publisher.publish()
    world.publisher("/modest").publish()
    world.drain()
    assert order.index("modest") < 100


class TestLatch:
    def test_a_late_subscriber_gets_the_last_message_of_each_that_latches_once(self, world):
        world.publisher("/t").publish(-1)
        gone = world.publisher("/t", latch=True)
        gone.publish(-1)
        gone.unregister()
        publishers = [world.publisher("/t", latch=True) for _ in range(2)]
        early = world.listen("/t")
        for number in (1, 2):
            for publisher in publishers:
                publisher.publish(number)
        late = world.listen("/t")
        world.drain()
        assert (early, late) == ([1, 1, 2, 2], [2, 2])
        publishers[0].publish(3)
        world.drain()
        assert late == [2, 2, 3]

    def test_it_moves_with_the_publication(self, world):
        here, there, moving = world.listen("/old"), world.listen("/new"), []
        subscriber = world.handle().Subscriber("old", Message, lambda m: moving.append(m.number))
        publisher = world.publisher("/old", latch=True)
        publisher.publish(1)
        world.drain()
        world.bus.rewire([(subscriber.subscription, "/new"), (publisher.publication, "/new")])
        world.drain()
        assert here == there == [1]
        assert moving == [1, 1], "once on each connection"


class TestTypes:
    def test_a_second_type_on_a_topic_is_refused_by_name_and_leaves_nothing(self, world):
        nh, publisher, got = world.handle(), world.publisher("/t"), []
        before = world.registrations
        for make in (nh.Subscriber, nh.Publisher):
            with pytest.raises(TypeMismatch) as caught:
                make("t", OtherMessage, got.append)
            assert "'/t' carries test/Message, but test/OtherMessage" in str(caught.value)
        publisher.publish(1)
        world.drain()
        assert got == []
        assert world.registrations == before

    @pytest.mark.parametrize("with_any", [False, True])
    def test_a_topic_may_change_type_once_only_ends_of_any_type_are_on_it(self, world, with_any):
        if with_any:
            world.handle().Subscriber("t", AnyMessage, print)
        world.publisher("/t").unregister()
        assert world.bus.datatype_of("/t") == ""
        world.transport.refused["/t"] = RuntimeError("no")
        with pytest.raises(RuntimeError):
            world.publisher("/t")  # its type does not become that of the topic
        del world.transport.refused["/t"]
        world.publisher("/t", OtherMessage)
        assert world.bus.datatype_of("/t") == "test/OtherMessage"


def test_an_unregistered_handle_publishes_and_receives_no_more_and_twice_is_once(world):
    got, publisher, gone = [], world.publisher("/t"), world.publisher("/t")
    subscriber, bound = world.handle().Subscriber("t", Message, got.append), gone.publish
    publisher.publish(1)
    for _ in range(2):
        subscriber.unregister()
        gone.unregister()
    publisher.publish(2)
    for publish in (gone.publish, bound):
        with pytest.raises(HandleClosed, match="publisher '/t' of /publisher is closed"):
            publish(1)
    world.drain()
    assert got == []
    assert world.registrations == [("publisher", "/t")]


@pytest.mark.parametrize("period", [0.02, 0.1, 1.5, 10.0, 60.0])
def test_the_rate_knows_pauses(period):
    clock = FakeClock()
    publisher = World(clock=clock).publisher("/t")
    traffic = publisher.publication.traffic
    for messages in (2, 3, 40, 100):
        for number in range(messages):
            clock.seconds += period
            publisher.publish(0)
            if number:
                assert traffic.rate() == pytest.approx(1 / period)
        clock.seconds += 1.9 * period
        assert traffic.rate() == pytest.approx(1 / period)
        clock.seconds += max(2.01, 3.1 * period)
        assert traffic.rate() == 0.0


def test_the_rate_follows_and_falls_in_silence():
    clock = FakeClock()
    publisher = World(clock=clock).publisher("/t")
    traffic = publisher.publication.traffic
    assert traffic.rate() == 0.0
    publisher.publish(0)
    assert traffic.rate() == 0.0
    for _ in range(200):
        clock.seconds += 0.1
        publisher.publish(0)
    assert traffic.rate() == pytest.approx(10.0)
    clock.seconds += 1.5
    assert 0.0 < traffic.rate() < 9.0
    clock.seconds += 1.0
    assert traffic.rate() == 0.0
    for _ in range(100):
        clock.seconds += 0.01
        publisher.publish(0)
    assert traffic.rate() == pytest.approx(100.0)


def test_errors_are_counted_reported_for_a_while_and_logged_once_a_second(caplog):
    clock = FakeClock()
    context = World(clock=clock).context("/n")
    assert context.recent_error() == ""
    for _ in range(1000):
        context.failed("'in'", ValueError("same"))
    context.failed("'in'", KeyError("other"))
    assert context.callback_errors == 1001
    assert [record.getMessage().count("same") for record in caplog.records] == [1, 0]
    clock.seconds += 1.5
    caplog.clear()
    context.failed("'in'", ValueError("same"))
    assert "999 times more" in caplog.records[0].getMessage()
    assert "ValueError: same" in caplog.records[0].getMessage()
    clock.seconds += 29.0
    assert context.recent_error() == "'in': ValueError: same"
    clock.seconds += 2.0
    assert context.recent_error() == ""


def test_errors_of_one_line_are_one_whatever_their_texts(caplog):
    world = World(clock=FakeClock())
    handle = world.handle("/n")

    def receive(message):
        raise LookupError(f"no data at {message.number} " + "x" * 1000 * message.number)

    def receive_again(message):
        raise LookupError("elsewhere")

    handle.Subscriber("/t", Message, receive)
    handle.Subscriber("/t", Message, receive_again)
    publisher = world.publisher("/t")
    for number in range(20):
        publisher.publish(number)
        world.drain()
    assert handle.context.callback_errors == 40
    assert [record.getMessage().splitlines()[-1] for record in caplog.records] == [
        "LookupError: no data at 0 ",
        "LookupError: elsewhere",
    ]


def test_an_error_without_a_text_is_counted(caplog):
    context = World(clock=FakeClock()).context("/n")
    context.failed("'in'", WithoutText())
    assert context.callback_errors == 1
    assert context.recent_error().startswith("'in': WithoutText")
    assert "WithoutText" in caplog.text


@pytest.mark.parametrize("is_left", [True, False])
def test_a_connection_has_one_registration_however_often_it_is_renewed_at_once(world, is_left):
    subscriber = world.handle().Subscriber("/t", Message, print)
    connection, transport = subscriber.subscription.connection, world.transport

    def overtake(topic):
        transport.on_register = print
        subscriber.unregister() if is_left else world.bus.renew(connection)

    transport.on_register = overtake
    world.bus.renew(connection)
    assert transport.subscribers == ([] if is_left else [connection.outside])
