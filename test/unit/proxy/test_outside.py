# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registrations outside amid a switch: when they are made, fed, and withdrawn."""

from __future__ import annotations

from typing import Callable

import pytest
from clocks import eventually, in_thread, join
from unit.nodelet.fakes import Message, numbers
from unit.proxy.bench import Bench

from dyknow.errors import HandleClosed, PeerTimeout, UnloadedMeanwhile
from dyknow.nodelet.local import LocalPublisher, LocalSubscriber
from dyknow.nodelet.streams.awaited import AwaitedPublisher


class Draining(LocalSubscriber):
    """Calls a function when it is drained, and receives once more when it is closed."""

    on_drain: Callable[[], None]

    def drain(self, seconds):
        self.on_drain()
        super().drain(seconds)

    def close(self):
        self.receive(Message("late"))
        super().close()


class Ported(Bench):
    """A bench with an out-port on /a and an in-port on /x, and a further handle of each."""

    def __init__(self):
        super().__init__()
        self.got = []
        self.transport = self.world.transport
        self.out, self.spare = (
            self.nh.Publisher("out", Message, latch=True, queue_size=1) for _ in range(2)
        )
        self.nh.Subscriber("into", Message, self.got.append)
        self.connect(out="/a", into="/x")

    def drained_by(self, on_drain):
        (subscriber,) = self.transport.subscribers
        subscriber.__class__, subscriber.on_drain = Draining, on_drain
        return subscriber

    def received(self):
        self.world.drain()
        return numbers(self.got)


@pytest.fixture(name="bench")
def _bench():
    return Ported()


def test_a_new_connection_is_made_before_the_old_one_is_broken(bench):
    seen = []
    bench.transport.on_register = lambda topic: seen.append((topic, bench.world.registrations))
    bench.connect(out="/b", into="/y")
    both = [("publisher", "/a"), ("subscriber", "/x")]
    assert seen == [("/b", both), ("/y", sorted([*both, ("publisher", "/b")]))]


def test_messages_from_outside_that_come_during_the_switch_follow_the_old_ones(bench):
    bench.nh.set_reconfigure_callback(lambda *maps: bench.got.append(Message("between")))
    bench.transport.send("/x", Message("old"))

    class Early(LocalSubscriber):
        def wait(self, arrived, seconds):
            self.receive(Message("new"))
            assert arrived(0.0)

    bench.transport.on_made = lambda made: setattr(made, "__class__", Early)
    bench.connect(into="/new")
    assert bench.received() == ["old", "between", "new"]


@pytest.mark.parametrize("is_live", [False, True])
def test_a_change_ends_when_all_publishers_outside_send_but_the_switch_is_earlier(bench, is_live):
    if is_live:
        bench.probe.Publisher("/new", Message)

    class Slow(LocalSubscriber):
        def wait_for_all(self, seconds):
            assert seconds > 0
            bench.transport.send("/new", Message("new"))
            assert bench.received() == ["new"]
            bench.got.append(Message("all send"))

    bench.transport.on_made = lambda made: setattr(made, "__class__", Slow)
    bench.connect(into="/new")
    assert bench.received() == ["new", "all send"]


def test_messages_until_the_switch_go_before_the_new_and_later_ones_are_dropped(bench):
    def last_words():
        bench.transport.send("/new", Message("new"))
        bench.transport.send("/x", Message("last"))

    old = bench.drained_by(last_words)
    bench.connect(into="/new")
    old.receive(Message("later still"))
    assert bench.received() == ["last", "new"]


@pytest.mark.parametrize("alive", [False, True])
def test_a_message_published_while_the_latched_one_is_sent_follows_it(bench, alive):
    if alive:  # so that the switch goes before the registration
        bench.probe.Subscriber("/new", Message, print)
    bench.out.publish(1)
    got, threads = [], []

    class Made(LocalPublisher):
        def latch(self, message):
            if not threads:
                threads.append(in_thread(lambda: bench.out.publish(2)))
                eventually(lambda: bench.out.publication.latched.number == 2)
            super().latch(message)

    bench.transport.listen("/new", lambda message: got.append(message.number))
    bench.transport.on_made = lambda made: setattr(made, "__class__", Made)
    bench.connect(out="/new")
    join(*threads)
    assert got == [1, 2]


def test_subscribers_stay_while_the_latched_message_is_sent(bench):
    bench.out.publish(1)
    peers = []
    bench.transport.listen("/new", lambda message: peers.append(bench.out.get_num_connections()))
    bench.connect(out="/new")
    assert peers == [1]


def test_two_ports_that_swap_their_topics_never_meet(bench):
    bench.out.publish("latched")
    bench.transport.on_register = lambda topic: bench.out.publish("in between")
    bench.connect(out="/x", into="/a")
    bench.send("/a", "new")
    assert bench.received() == ["new"]
    bench.transport.on_register = lambda topic: None
    bench.connect(into="/x")
    assert bench.received() == ["new", "in between"]


def test_messages_of_a_latching_port_during_its_registration_go_outside_in_order(bench):
    bench.probe.Subscriber("/new", Message, print)
    for handle in (bench.out, bench.spare):
        handle.unregister()
    bench.out = bench.nh.Publisher("out", Message, latch=True, queue_size=2)
    bench.out.publish(0)
    got = []
    bench.transport.listen("/new", lambda message: got.append(message.number))
    bench.transport.on_register = lambda topic: [bench.out.publish(n) for n in (1, 2)]
    bench.connect(out="/new")
    bench.out.publish(3)
    assert got == [1, 2, 3]


def test_a_latched_message_published_at_the_switch_goes_outside_once(bench):
    """As when the reconfigure callback publishes while the in-port is being registered."""
    bench.probe.Publisher("/y", Message, queue_size=1)  # so that this is done after the switch
    state, got = Message("state"), []
    bench.out.publish(state)
    bench.transport.listen("/b", lambda message: got.append(message.number))
    bench.transport.on_register = lambda topic: topic == "/y" and bench.out.publish(state)
    bench.connect(into="/y", out="/b")
    assert got == ["state"]
    bench.connect(into="/x", out="/a")
    bench.connect(out="/b")
    assert got == ["state", "state"], "one that is not published again is owed"


def test_a_handle_that_goes_amid_the_switch_goes_alone(bench):
    bench.drained_by(lambda: join(in_thread(bench.spare.unregister)))
    bench.connect(out="/b", into="/y")
    assert bench.world.registrations == [("publisher", "/b"), ("subscriber", "/y")]
    bench.transport.send("/y", Message(1))
    assert bench.received() == [1]


@pytest.mark.parametrize("moment", ["waiting for peers", "last words", "registering"])
def test_a_nodelet_unloaded_amid_its_switch_leaves_nothing(bench, moment):
    seen, world = [], bench.world

    def unload(*args):
        seen.append(len(world.registrations))
        join(in_thread(bench.context.close))
        seen.append(len(world.registrations))

    def wait(*args):
        assert moment == "waiting for peers", "no peer is waited for after the unload"
        if not seen:
            unload()

    if moment == "last words":
        bench.drained_by(unload)
    else:
        world.transport.on_made = lambda made: setattr(made, "wait", wait)
    if moment == "registering":
        world.transport.on_register = unload
    with pytest.raises(UnloadedMeanwhile, match="/ns/nodelet"):
        bench.connect(into="/c", out="/b")
    assert seen == [2 if moment == "registering" else 4, 0]
    assert world.registrations == []
    assert world.bus._topics == {}


def test_a_nodelet_unloaded_while_a_live_topic_is_registered_leaves_nothing(bench):
    bench.probe.Subscriber("/b", Message, print)
    bench.transport.on_register = lambda topic: join(in_thread(bench.context.close))
    bench.connect(out="/b")
    assert bench.world.registrations == [("subscriber", "/b")]
    with pytest.raises(HandleClosed):
        bench.out.publish(1)


def test_a_registration_that_this_process_has_is_shared_before_the_switch(bench):
    for topic in ("/b", "/y"):
        bench.probe.Subscriber(topic, Message, print)
        bench.probe.Publisher(topic, Message, queue_size=1)
    seen, waits = [], []
    bench.transport.on_register = lambda topic: seen.append((topic, bench.topics()))
    bench.transport.on_made = lambda made: setattr(made, "wait", lambda *args: waits.append(args))
    bench.connect(out="/b", into="/y")
    former = {"out": "/a", "into": "/x"}
    assert seen == [("/b", former), ("/y", former)]
    assert waits == [(0.0,)], "the publisher's alone: there are peers here, so nobody is awaited"


def test_messages_are_kept_for_late_subscribers_though_no_time_is_left(bench):
    waits = []

    def made(registration):
        bench.clock.seconds += 10.0
        registration.wait = lambda *args: waits.append(args)

    bench.transport.on_made = made
    bench.connect(out="/b", into="/y")
    assert waits == [(0.0,)]


# A topic that is alive in this process, and not registered yet


class Live(Ported):
    """An out-port on /a that does not latch; /b and /c have subscribers here and outside.

    Attributes:
        inside: numbers that came to each of /b and /c in this process.
        outside: numbers that went out on each topic.
    """

    def __init__(self):
        super().__init__()
        self.moving = self.nh.Publisher("plain", Message, queue_size=3)
        self.connect(plain="/a")
        self.inside, self.outside = {}, {}
        for topic in ("/a", "/b", "/c"):
            self.inside[topic], self.outside[topic] = [], []
            self.transport.listen(topic, lambda m, to=self.outside[topic]: to.append(m.number))
        for topic in ("/b", "/c"):
            keep = lambda m, to=self.inside[topic]: to.append(m.number)  # noqa: E731
            self.probe.Subscriber(topic, Message, keep)

    def publish(self, *numbers):
        for number in numbers:
            self.moving.publish(number)


@pytest.fixture(name="live")
def _live():
    return Live()


def test_messages_during_a_registration_go_outside_after_it_in_order(live):
    waits = []

    class Made(LocalPublisher):
        def wait(self, seconds):
            waits.append((seconds, list(live.outside["/b"])))

    live.transport.on_made = lambda made: setattr(made, "__class__", Made)
    live.transport.on_register = lambda topic: live.publish(*range(5))
    live.connect(plain="/b")
    live.publish(5)
    live.world.drain()
    assert live.inside["/b"] == [*range(6)]
    assert live.outside == {"/a": [], "/b": [2, 3, 4, 5], "/c": []}, "up to the queue size"
    assert waits == [(0.0, [])], "before anything is sent"


@pytest.mark.parametrize(("size", "kept"), [(-1, [0, 1, 2]), (2.0, [1, 2]), (0.5, [2])])
def test_a_port_moves_with_each_queue_size_that_rospy_takes(live, size, kept):
    live.moving.unregister()
    live.moving = live.nh.Publisher("plain", Message, queue_size=size)
    live.nh.Subscriber("into", Message, print, queue_size=size)
    live.transport.on_register = lambda topic: live.publish(*range(3))
    live.connect(plain="/b")
    assert live.outside["/b"] == kept
    live.context.close()
    assert [kind for kind, _ in live.world.registrations] == ["subscriber"] * 2, "of the probe"


def test_a_port_that_moves_on_during_its_registration_loses_nothing_outside(live):
    publication = live.moving.publication

    def move_on(topic):
        live.transport.on_register = lambda topic: live.publish(2)
        live.publish(1)
        join(in_thread(lambda: live.world.bus.rewire([(publication, "/c")])))
        live.publish(3)

    live.transport.on_register = move_on
    live.connect(plain="/b")
    live.publish(4)
    assert live.outside == {"/a": [], "/b": [1], "/c": [2, 3, 4]}
    eventually(lambda: ("publisher", "/b") not in live.world.registrations)
    live.context.close()
    assert [kind for kind, _ in live.world.registrations] == ["subscriber"] * 2
    assert live.world.bus._leaving == []


@pytest.mark.parametrize("why", ["unloaded", "registration failed", "lease lost"])
def test_messages_that_must_not_go_out_any_more_do_not(live, why):
    def prevent(topic):
        live.publish(1)
        if why == "unloaded":
            join(in_thread(live.context.close))
        elif why == "lease lost":
            live.world.bus.fence({"/b": lambda owner: False})

    live.transport.on_register = prevent
    if why == "registration failed":
        live.transport.refused["/b"] = PeerTimeout("the master", 1.0)
        live.transport.on_register = lambda topic: None
        with pytest.raises(PeerTimeout):
            live.connect(plain="/b")
        live.publish(2)
        assert live.moving.publication.outside is None
    else:
        live.connect(plain="/b")
    assert live.outside["/b"] == []


def test_messages_that_come_while_kept_ones_are_passed_on_follow_them():
    awaited, sent, threads = AwaitedPublisher("/t", 0), [], []

    class Successor(LocalPublisher):
        def __init__(self):
            pass

        def publish(self, message):
            if message == 1:
                awaited.publish("within")  # from a finalizer, say
                threads.append(in_thread(lambda: awaited.publish("after")))
            if message == 2:
                raise ValueError("a field")
            sent.append(message)

    for number in range(4):
        awaited.publish(number)
    assert not awaited.drain(0.0)
    awaited.pass_to(Successor())
    join(threads.pop())
    assert sent == [0, "within", 1, 3, "after"]
    assert awaited.drain(0.0)


def test_a_publication_whose_lease_has_run_out_gives_nobody_its_latched_message(live):
    live.out.publish(1)
    is_allowed = [False]
    live.world.bus.fence({"/b": lambda owner: is_allowed[0]})
    live.connect(out="/b")
    late = live.world.listen("/b")
    live.world.drain()
    assert (live.inside["/b"], live.outside["/b"], late) == ([], [], [])
    is_allowed[0] = True
    later = live.world.listen("/b")
    live.world.drain()
    assert (live.inside["/b"], late, later) == ([], [], [1])
    live.out.publish(2)
    live.world.drain()
    assert (live.inside["/b"], live.outside["/b"], late, later) == ([2], [2], [2], [1, 2])
