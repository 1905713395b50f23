# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A nodelet that moves to another process receives each message once, in order."""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import pytest
from clocks import in_thread, join
from hypothesis import given
from hypothesis import strategies as st
from unit.nodelet.fakes import FakeClock, Message, World, make_pool_world

import dyknow
from dyknow.errors import CannotMove, DyKnowError, UnknownNodelet, UnloadedMeanwhile
from dyknow.nodelet import hand_over
from dyknow.nodelet.hand_over import HandOvers
from dyknow.nodelet.scheduler import ManualExecutor
from dyknow.nodelet.streams.endpoints import MOST_KEPT
from dyknow.nodelet.streams.parked import LATENESS

NAME = "/moving"
WIRING = {"/in": "/t", "/out": "/o"}
TYPES = {"test/Message": Message}


class Latched(Message):
    """A message that rospy has received from a publisher that latches."""

    _connection_header = {"latching": "1"}


class OtherLatched(Message):
    _connection_header = {"latching": "1", "callerid": "/other"}


@pytest.fixture(autouse=True)
def no_move_is_left():
    yield
    while Place.made:
        Place.made.pop().moves.close()


class Place:
    """A process: a world, its loader with the type ``Moving``, and its moves."""

    made: ClassVar[list[Place]] = []

    def __init__(self, world, received, size=None):
        self.made.append(self)

        class Moving(dyknow.Nodelet):
            def on_init(self):
                handle = dyknow.NodeHandle(self.node_handle)
                self.out = handle.Publisher("out", Message, queue_size=1)
                handle.Subscriber("in", Message, self.on_message, queue_size=size)
                self.node_handle.Subscriber("/plain", Message, self.on_message)

            def on_message(self, message):
                received.append(message.number)
                self.out.publish(message)

        self.world = world
        self.loader = world.loader(Moving=Moving)
        self.moves = HandOvers(
            self.loader, TYPES.get, lambda context: self.loader.unload(context.name, context)
        )
        self.on_the_way = deque()
        world.transport.on_made = self._made

    def _made(self, registration):
        if registration.topic == "/t":
            registration.drain = lambda seconds: self.arrive(len(self.on_the_way))

    def arrive(self, count):
        """Receive messages that are on the way from publishers outside."""
        for _ in range(min(count, len(self.on_the_way))):
            self.send(self.on_the_way.popleft())

    def load(self):
        self.loader.load(NAME, "Moving", WIRING)

    def send(self, number, topic="/t", kind=Message):
        """A message comes from outside."""
        self.world.transport.send(topic, kind(number))

    @property
    def hears(self):
        return ("subscriber", "/t") in self.world.registrations


@contextmanager
def places(clock, received, size=None):
    """Two processes with threads, the first of which has the nodelet."""
    worlds = [make_pool_world(1, clock=clock) for _ in range(2)]
    try:
        pair = [Place(world, received, size) for world in worlds]
        pair[0].load()
        yield pair
    finally:
        for world in worlds:
            world.close()


def steps(old, new):
    """The move, step by step."""
    topics = old.moves.note(NAME)
    yield
    new.moves.park(NAME, topics)
    yield
    topics = old.moves.give(NAME)
    old.moves.end(NAME)
    yield
    new.moves.take(NAME, topics)
    yield
    new.load()
    yield
    new.moves.end(NAME)


@given(schedule=st.lists(st.sampled_from("pppooonnns"), max_size=60))
def test_each_message_is_received_once_in_order_whenever_it_arrives(schedule):
    clock, received, published = FakeClock(), [], 0
    with places(clock, received) as (old, new):
        move = steps(old, new)
        for what in [*schedule, *"pssspssonpo"]:
            clock.seconds += 0.03
            if what == "p":
                for place in (old, new):
                    if place.hears:  # a publisher sends to those that are connected
                        place.on_the_way.append(published)
                published += 1
            elif what == "s":
                next(move, None)
            else:
                (old if what == "o" else new).arrive(1)
        new.arrive(len(new.on_the_way))
        new.world.drain()
        assert received == list(range(published))
        assert old.world.registrations == []


@pytest.mark.parametrize(("patience", "pause"), [(2.0, 0.01), (2.0, 1.2), (0.0, 0.01)])
@pytest.mark.parametrize("count", range(2, 6))
def test_what_a_publisher_has_queued_for_the_old_process_is_awaited(
    monkeypatch, count, patience, pause
):
    clock, received, queued, steady = FakeClock(), [], deque(range(count)), FakeClock()

    def sleep(seconds):
        clock.seconds += 0.01
        steady.seconds += pause
        if queued and patience:
            old.send(queued.popleft())
        time.sleep(seconds)

    monkeypatch.setattr(hand_over, "time", SimpleNamespace(monotonic=steady, sleep=sleep))
    monkeypatch.setattr(hand_over, "PATIENCE", patience)
    with places(clock, received) as (old, new):
        new.world.transport.on_made = lambda made: setattr(
            made,
            "hear",
            lambda *args: made.topic == "/t" and [new.send(count - 2 + i) for i in (0, 1)],
        )
        parked = new.moves.park(NAME, old.moves.note(NAME))
        given = old.moves.give(NAME, parked)
        finish(new, given)
        assert received == (list(range(count)) if patience else [count - 2, count - 1])
        assert old.world.registrations == []


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        ([], []),
        ([(Message, 1), (Message, 2)], [2]),
        ([(Message, 1), (OtherLatched, 2)], [1]),
        ([(Latched, 2), (Latched, 3), (OtherLatched, 4)], [3]),
    ],
)
def test_the_last_message_of_each_publisher_is_awaited_unless_it_was_latched(sent, expected):
    place, topics, _ = parked()
    place.moves.end(NAME)
    place.world.transport.on_made = lambda made: setattr(
        made, "hear", lambda *args: made.topic == "/t" and [place.send(n, kind=k) for k, n in sent]
    )
    digests = [digest for each in place.moves.park(NAME, topics) for _, digest in each.given]
    assert digests == [place.world.transport.digest(Message(number)) for number in expected]


@pytest.mark.parametrize(("count", "seconds"), [(0, 0.25), (1, 0.25), (2, 2.0)])
def test_the_publishers_of_a_topic_on_which_messages_flow_have_more_time(
    monkeypatch, count, seconds
):
    monkeypatch.setattr(hand_over, "time", SimpleNamespace(monotonic=lambda: 100.0))
    clock, asked = FakeClock(), {}
    with places(clock, []) as (old, new):
        for number in range(count):
            old.send(number)
            old.world.drain()
            clock.seconds += 0.1
        new.world.transport.on_made = lambda made: setattr(
            made, "hear", lambda arrived, limit: asked.update({made.topic: limit})
        )
        new.moves.park(NAME, old.moves.note(NAME))
    assert asked == {"/t": seconds, "/plain": 0.25}


def parked(size=None, clock=None):
    """A place where the nodelet is parked, without threads, its topics and its messages."""
    received = []
    world = World(ManualExecutor(clock or FakeClock()))
    with places(world.executor.clock, []) as (old, _):
        topics = old.moves.note(NAME)
    place = Place(world, received, size)
    place.moves.park(NAME, topics)
    return place, topics, received


def given_in(place, topics, times, kind=Message):
    """The ends of a nodelet that was given these numbers, each with its time, on /t."""
    digest = place.world.transport.digest
    found = []
    for each in topics:
        noted = [(time, digest(kind(n))) for time, n in times] if each.topic == "/t" else []
        found.append(type(each)(each.topic, each.datatype, each.direction, tuple(noted)))
    return found


def finish(place, topics):
    place.moves.take(NAME, topics)
    place.load()
    place.moves.end(NAME)
    place.world.drain()


@pytest.mark.parametrize(
    ("runs_meanwhile", "expected"), [(True, [*range(5), 8, 9]), (False, list(range(3, 10)))]
)
def test_what_waits_has_room_beside_the_limit_of_the_queue(runs_meanwhile, expected):
    place, topics, received = parked(size=2)
    for number in range(5):
        place.send(number)
    place.moves.take(NAME, topics)
    place.load()
    if runs_meanwhile:
        place.world.drain()
        assert received == list(range(5))
    for number in range(5, 10):
        place.send(number)
    place.world.drain()
    assert received == expected


def test_what_comes_during_a_load_is_bounded_beside_what_waits():
    place, topics, received = parked()
    for number in range(5):
        place.send(number)
    content = place.world.transport.pack(Message("waits"))
    waiting = (content,) * MOST_KEPT
    place.moves.take(NAME, [replace(e, waiting=waiting) if e.topic == "/t" else e for e in topics])
    for number in range(2000):
        place.send(number)
    place.load()
    place.world.drain()
    assert len(received) == MOST_KEPT + 5
    assert received[-1] == 1999


def test_equal_messages_are_counted_from_the_first_that_came_here():
    clock = FakeClock()
    place, topics, received = parked(clock=clock)
    clock.seconds = 110.0
    for _ in range(4):
        place.send(7)
    finish(place, given_in(place, topics, [(109.0, 7), (109.5, 7), (110.0, 7), (110.0, 7)]))
    assert received == [7, 7]


def test_an_equal_message_follows_one_that_came_before_the_nodelet_was_parked():
    clock, received = FakeClock(), []
    with places(clock, received) as (old, new):
        move = steps(old, new)
        next(move)
        clock.seconds += 0.05
        old.send(7)
        clock.seconds += 0.05
        for _ in range(5):
            next(move, None)
        clock.seconds += 0.9
        new.send(7)
        new.world.drain()
    assert received == [7, 7]


def test_late_messages_are_left_out_for_some_seconds_only():
    clock = FakeClock()
    place, topics, received = parked(clock=clock)
    finish(place, given_in(place, topics, [(clock(), 1), (clock(), 2)]))
    clock.seconds += LATENESS
    place.send(1)
    clock.seconds += 0.1
    place.send(2)
    place.world.drain()
    assert received == [2]


@pytest.mark.parametrize(("waits", "expected"), [(None, [3, 4]), (4, [4, 3]), (9, [9, 3, 4])])
def test_the_last_message_of_each_latching_publisher_comes_again(waits, expected):
    place, topics, received = parked()
    sent = {1: Latched, 2: OtherLatched, 3: Latched, 4: OtherLatched}
    for number, kind in sent.items():
        place.send(number, kind=kind)
    given = given_in(place, topics, [(100.0, number) for number in sent])
    if waits is not None:
        content = place.world.transport.pack(Message(waits))
        given = [replace(e, waiting=(content,)) if e.topic == "/t" else e for e in given]
    finish(place, given)
    assert received == expected


def test_the_first_message_of_a_latching_publisher_during_a_move_is_received():
    place, topics, received = parked()
    for number in range(3):
        place.send(number, kind=Latched)
    finish(place, topics)
    assert received == [0, 1, 2]


@pytest.mark.parametrize("waits", [True, False])
@pytest.mark.parametrize("is_here", [True, False])
def test_a_message_that_was_latched_before_the_move_is_not_awaited_and_outdated(is_here, waits):
    clock, received = FakeClock(), []
    with places(clock, received) as (old, new):
        publisher = new.world.publisher("/t", latch=True)

        def publish(number):
            if is_here:
                publisher.publish(Message(number))
            else:
                new.send(number, kind=Latched)

        if is_here:
            publish(1)
        else:
            new.world.transport.on_made = lambda made: made.topic == "/t" and setattr(
                made, "hear", lambda *args: publish(1)
            )
        parked = new.moves.park(NAME, old.moves.note(NAME))
        assert [each.given for each in parked] == [(), ()]
        clock.seconds += 0.1
        opened = threading.Event()
        if waits:
            old.loader.find(NAME).strand.post(opened.wait)
        publish(2)
        old.send(2)
        if not waits:
            old.world.drain()
        context, stop = old.loader.find(NAME), old.loader.find(NAME).stop
        context.stop = lambda: (stop(), opened.set())
        given = old.moves.give(NAME, parked)
        del received[:]
        finish(new, given)
        assert received == [2]


def test_a_publisher_has_its_latch_and_headers_from_the_first_connection_on(monkeypatch):
    with places(FakeClock(), []) as (old, new):
        options = {"headers": {"made": "here"}, "tcp_nodelay": True}
        end = old.loader.find(NAME).publication("late", Message, True, 5, **options)
        old.world.bus.rewire([(end, "/late")])
        transport, made = new.world.transport, {}
        advertise = transport.advertise

        def watched(topic, datatype, latch, queue_size, options):
            made[topic] = (latch, options)
            return advertise(topic, datatype, latch, queue_size, options)

        monkeypatch.setattr(transport, "advertise", watched)
        new.moves.park(NAME, old.moves.note(NAME))
        assert made == {"/o": (False, {}), "/late": (True, options)}


def test_a_move_that_is_given_up_leaves_nothing():
    with places(FakeClock(), received := []) as (old, new):
        new.moves.park(NAME, old.moves.note(NAME))
        new.moves.close()
        old.moves.close()
        assert new.world.registrations == []
        old.send(1)
        old.world.drain()
        assert received == [1]
        with pytest.raises(CannotMove, match="are not kept any more"):
            new.moves.take(NAME, [])
        with pytest.raises(CannotMove, match="connected elsewhere meanwhile"):
            old.moves.give(NAME)
        old.moves.note(NAME)
        old.loader.get(NAME).context.attached.set_config([("in", "/elsewhere")])
        with pytest.raises(CannotMove, match="connected elsewhere meanwhile"):
            old.moves.give(NAME)
        assert old.loader.list() == [NAME]


@pytest.mark.parametrize("ends", [True, False])
def test_what_waits_for_a_busy_nodelet_moves_with_it(monkeypatch, ends):
    monkeypatch.setattr(hand_over, "LONGEST_END", 10.0 if ends else 0.0)
    opened, received = threading.Event(), []
    with places(FakeClock(), received) as (old, new):
        old.loader.find(NAME).strand.post(opened.wait)
        for number in range(3):
            old.send(number)
        new.moves.park(NAME, old.moves.note(NAME))
        for number in range(3, 6):
            old.send(number)
            new.send(number)
        if ends:  # once it has been disconnected
            context, stop = old.loader.find(NAME), old.loader.find(NAME).stop
            context.stop = lambda: (stop(), opened.set())
        given = old.moves.give(NAME)
        opened.set()
        new.moves.take(NAME, given)
        new.load()
        new.world.drain()
        assert received == list(range(6))


def test_what_is_unknown_there_and_a_publisher_that_does_not_connect_are_named():
    with places(FakeClock(), []) as (old, new):
        with pytest.raises(UnknownNodelet):
            new.moves.note(NAME)
        topics = old.moves.note(NAME)
        renamed = [type(each)(each.topic, "test/Unknown", each.direction) for each in topics]
        with pytest.raises(CannotMove, match="carries test/Unknown, unknown there"):
            new.moves.park(NAME, renamed)
        assert new.world.registrations == []
        new.world.transport.on_made = lambda made: setattr(
            made, "missing", lambda: ["http://absent:1"]
        )
        with pytest.raises(CannotMove, match="http://absent:1"):
            new.moves.park(NAME, topics)
        assert new.world.registrations == []


# A move that fails, or whose manager dies


def test_the_next_nodelet_of_the_name_stays_when_the_one_that_moves_is_unloaded():
    with places(FakeClock(), []) as (old, new):
        new.moves.park(NAME, old.moves.note(NAME))
        context = old.loader.find(NAME)
        stop = context.stop

        def replaced():
            context.stop = stop
            old.loader.unload(NAME)
            old.load()

        context.stop = replaced
        with pytest.raises(UnknownNodelet):
            old.moves.give(NAME)
        assert old.loader.list() == [NAME]


class Unserialisable(Message):
    """A message with a field of a wrong type, which passes by reference alone."""

    def __repr__(self):
        raise ValueError("a field")

    def __reduce__(self):
        raise ValueError("a field")


def test_a_message_that_cannot_be_serialised_is_dropped_and_the_move_goes_on(caplog, monkeypatch):
    monkeypatch.setattr(hand_over, "LONGEST_END", 0.0)  # nothing is received in the old process
    opened, received = threading.Event(), []
    with places(FakeClock(), received) as (old, new):
        topics = old.moves.note(NAME)
        new.moves.park(NAME, topics)
        new.world.publisher("/t").publish(Unserialisable("there"))
        old.loader.find(NAME).strand.post(opened.wait)
        publisher = old.world.publisher("/t")
        for message in (Message(1), Unserialisable(2), Message(3)):
            publisher.publish(message)
        given = old.moves.give(NAME)
        opened.set()
        new.moves.take(NAME, given)
        new.load()
        new.moves.end(NAME)
        new.world.drain()
        assert received == [1, 3, "there"]
        assert caplog.text.count("a message on /t is lost in its move: a field") == 1


@pytest.mark.parametrize("fails", ["stop", "endpoints"])
def test_a_nodelet_that_cannot_be_given_away_is_unloaded(monkeypatch, fails):
    with places(FakeClock(), []) as (old, _):
        old.moves.note(NAME)
        context = old.loader.find(NAME)
        works = getattr(context, fails)
        calls = itertools.count()

        def fail(*arguments):
            if next(calls) == 0:
                raise RuntimeError("no memory")
            return works(*arguments)

        monkeypatch.setattr(context, fails, fail)
        with pytest.raises(RuntimeError, match="no memory"):
            old.moves.give(NAME)
        assert old.loader.list() == []
        assert old.world.registrations == []
        old.load()  # its manager brings it back


@pytest.mark.parametrize("port", ["in", "out"])
def test_a_port_that_is_connected_elsewhere_during_the_drain_stays_so(port):
    with places(FakeClock(), received := []) as (old, _):
        old.moves.note(NAME)
        proxy = old.loader.find(NAME).attached
        moved = []

        def drain(seconds):
            outside.drained = True
            if not moved:
                moved.append(port)
                join(in_thread(lambda: proxy.set_config([(port, "/elsewhere")])))

        outside = old.loader.find(NAME).endpoints()[1].connection.outside
        outside.drain = drain
        with pytest.raises(CannotMove, match="connected elsewhere meanwhile"):
            old.moves.give(NAME)
        assert {each.name: each.topic for each in proxy.get_config()}[port] == "/elsewhere"
        old.send(1, "/elsewhere" if port == "in" else "/t")
        old.send(2, "/plain")
        old.world.drain()
        assert received == [1, 2]
        assert len(old.world.registrations) == 3


def test_a_nodelet_that_is_given_away_takes_part_in_nothing_else():
    with places(FakeClock(), []) as (old, _):
        old.moves.note(NAME)
        context, seen = old.loader.find(NAME), []

        def meanwhile():
            context.stop = stop
            for refused in (
                lambda: old.moves.note(NAME),
                lambda: old.moves.give(NAME),
                lambda: context.attached.set_config([("in", "/elsewhere")]),
            ):
                with pytest.raises(DyKnowError) as caught:
                    refused()
                seen.append(type(caught.value))
            old.moves.end(NAME)
            with pytest.raises(CannotMove):
                old.moves.note(NAME)
            stop()

        stop, context.stop = context.stop, meanwhile
        old.moves.give(NAME)
        assert seen == [CannotMove, CannotMove, UnloadedMeanwhile]
        assert old.loader.list() == []
        assert old.moves._moves == {}


#: The steps of a move; its manager dies before one of them, or after the last.
STEPS = ("note", "park", "give", "take", "load", "end")


@pytest.mark.parametrize(
    ("first", "second", "back"),
    itertools.product(range(len(STEPS) + 1), range(len(STEPS) + 1), [0, 1]),
)
def test_no_message_comes_twice_whenever_managers_die(first, second, back):
    """Two moves are cut off; the next manager brings a lost nodelet back, and moves it at last."""
    clock, received, numbers, lost = FakeClock(), [], itertools.count(), set()
    with places(clock, received) as pair:

        def publish(is_kept=True):
            for _ in range(2):
                clock.seconds += 0.03
                number = next(numbers)
                for place in pair:
                    if place.hears:
                        place.send(number)
                if not is_kept:
                    lost.add(number)
                for place in pair:
                    place.world.drain()

        def move(count):
            (source,) = [place for place in pair if place.loader.list()]
            (target,) = [place for place in pair if place is not source]
            # Messages after the report of the old process are lost with the manager.
            is_lost = count in (STEPS.index("take"), STEPS.index("load"))
            done = steps(source, target)
            for number in range(count):
                next(done, None)
                publish(not (is_lost and number >= 1))
            if not any(place.loader.list() for place in pair):
                publish(is_kept=False)
                pair[back].load()
            publish()

        publish()
        for count in (first, second, len(STEPS)):
            move(count)
        assert received == sorted(set(received))
        assert set(range(next(numbers))) - set(received) <= lost
        assert [place.moves._moves for place in pair] == [{}, {}]
        assert sorted(len(place.world.registrations) for place in pair) == [0, 3]


def test_a_move_is_ended_by_its_own_time_limit_alone(monkeypatch):
    limits = []
    monkeypatch.setattr(hand_over, "in_background", lambda name, expire: limits.append(expire))
    for limit in ("_EXPIRY", "_LOAD_EXPIRY", "_LOOK"):
        monkeypatch.setattr(hand_over, limit, 0.0)
    with places(FakeClock(), []) as (old, new):
        topics = old.moves.note(NAME)
        old.moves.note(NAME)
        limits[0]()
        assert list(old.moves._moves) == [NAME], "the second goes on"
        for _ in range(2):
            new.moves.park(NAME, topics)
        limits[2]()
        new.moves.take(NAME, topics)
        limits[3]()
        assert new.moves._moves == {}
        assert new.world.registrations == []


def test_what_was_taken_waits_for_the_load_and_not_for_long(monkeypatch):
    limits = []
    monkeypatch.setattr(hand_over, "in_background", lambda name, expire: limits.append(expire))
    for limit in ("_LOAD_EXPIRY", "_LOOK"):
        monkeypatch.setattr(hand_over, limit, 0.0)
    place, topics, received = parked()
    place.moves.take(NAME, topics)
    place.send(1)
    find = place.loader.find
    found = iter([None, None])
    monkeypatch.setattr(place.loader, "find", lambda name: next(found, find(name)))
    monkeypatch.setattr(place.loader, "known", lambda name: place.loader)  # it is being loaded
    waiting = in_thread(limits[-1])
    monkeypatch.setattr(place.loader, "known", find)
    join(waiting)
    place.load()
    place.world.drain()
    assert received == [], "it may have run elsewhere"


def test_a_parking_that_is_ended_before_it_is_complete_leaves_nothing():
    with places(FakeClock(), []) as (old, new):
        topics = old.moves.note(NAME)
        new.world.transport.on_made = lambda made: new.moves.end(NAME)
        with pytest.raises(CannotMove, match="ended meanwhile"):
            new.moves.park(NAME, topics)
        assert new.world.registrations == []


def test_a_second_report_changes_nothing():
    place, topics, received = parked()
    for number in range(4):
        place.send(number)
    given = given_in(place, topics, [(100.0, 0), (100.0, 1)])
    place.moves.take(NAME, given)
    finish(place, given)
    assert received == [2, 3]
    place, topics, received = parked()
    place.moves.take(NAME, topics)
    place.load()
    with pytest.raises(CannotMove, match="not kept any more"):
        place.moves.take(NAME, topics)
    place.send(5)
    place.world.drain()
    assert received == [5]
