# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Unloading: removed registrations, refused calls, and callbacks that are not awaited."""

from __future__ import annotations

import logging
import threading
import time
from functools import partial
from typing import Any

import pytest
from clocks import eventually, in_thread, wait_for
from unit.nodelet.fakes import FakeClock, Idle, Message, World, numbers, pool_world

from dyknow.errors import HandleClosed, UnknownNodelet
from dyknow.nodelet.handle import Nodelet, PlainNodeHandle
from dyknow.nodelet.loading import loader as loader_module
from dyknow.nodelet.loading.loader import SHUTDOWN_PATIENCE, Loader
from dyknow.nodelet.local import LocalPublisher

world = pool_world(3)


class Hanging(Nodelet):
    """A nodelet whose callback blocks until the test releases it, then publishes."""

    def on_init(self):
        self.started, self.release = threading.Event(), threading.Event()
        self.ended, self.raised, self.got = threading.Event(), [], []
        self.pub = self.node_handle.Publisher("out", Message)
        self.node_handle.Subscriber("in", Message, self.on_message)

    def on_message(self, message):
        self.got.append(message)
        self.started.set()
        wait_for(self.release)
        try:
            self.pub.publish(1)
        except HandleClosed as error:
            self.raised.append(error)
        self.ended.set()


def test_everything_is_unregistered_before_it_returns_though_a_part_fails(world, caplog):
    class Full(Nodelet):
        def on_init(self):
            for nh in (self.node_handle, self.mt_private_node_handle):
                nh.Publisher("p", Message)
                nh.Subscriber("s", Message, print)
                for name in ("a", "b", "c"):
                    nh.Service(name, object, print)
                nh.Timer(1.0, print)

    offer, unloaded = world.services.offer, []

    def offer_one_that_fails(name, *args):
        offered = offer(name, *args)
        if name == "/b":
            offered.close = lambda: 1 / 0
        return offered

    world.services.offer = offer_one_that_fails
    loader = Loader(world.runtime, lambda name, _: Full, on_unloaded=unloaded.append)
    context = loader.load("/n", "full").context
    assert len(world.registrations) == 4
    loader.unload("/n")
    assert world.registrations == []
    assert sorted(world.services.handlers) == ["/b"]
    assert world.runtime.timers._heap == []
    assert unloaded == [context]
    assert loader.list() == []
    assert "ZeroDivisionError" in caplog.text
    assert "callback" not in caplog.text, "none was running"
    loader.load("/n", "full")


def test_a_running_callback_is_not_waited_for_and_its_late_publish_refused(world, caplog):
    caplog.set_level(logging.INFO)
    loader = world.loader(hanging=Hanging)
    nodelet = loader.load("/n", "hanging")
    got, nh = [], world.handle()
    nh.Subscriber("/out", Message, got.append)
    publisher = nh.Publisher("/in", Message)
    for number in range(3):
        publisher.publish(number)
    wait_for(nodelet.started)
    loader.unload("/n")
    assert loader.list() == []
    assert "/n: unloaded while a callback runs" in caplog.text
    again = loader.load("/n", "hanging")
    nodelet.release.set()
    wait_for(nodelet.ended)
    eventually(lambda: "/n: the callback that ran at the unload has ended" in caplog.text)
    again.release.set()
    world.drain()
    assert len(nodelet.raised) == 1
    assert "publisher 'out' of /n is closed" in str(nodelet.raised[0])
    assert numbers(nodelet.got) == [0], "queued messages are dropped"
    assert got == []


def test_late_services_leave_those_of_the_next_nodelet_alone(world):
    loader = world.loader(idle=Idle)
    gone = loader.load("/n", "idle").private_node_handle
    service = gone.Service("~s", object, print)
    loader.unload("/n")
    loader.load("/n", "idle").private_node_handle.Service("~s", object, print)
    service.shutdown()
    with pytest.raises(HandleClosed, match="nodelet /n is closed"):
        gone.Service("~s", object, print)
    assert list(world.services.handlers) == ["/n/s"]


@pytest.mark.parametrize("how", ["subscriber", "timer", "service", "mt"])
def test_a_callback_may_unload_its_own_nodelet(world, how):
    loader: Any = None
    done = threading.Event()

    class Suicidal(Nodelet):
        def on_init(self):
            nh = self.mt_node_handle if how == "mt" else self.node_handle
            self.pub = nh.Publisher("p", Message)
            if how == "timer":
                nh.Timer(1.0, self.end)
            elif how == "service":
                nh.Service("end", object, self.end)
            else:
                nh.Subscriber("in", Message, self.end)

        def end(self, _):
            loader.unload(self.name)
            with pytest.raises(HandleClosed):
                self.pub.publish()
            done.set()

    loader = world.loader(suicidal=Suicidal)
    loader.load("/n", "suicidal")
    if how == "timer":
        world.ticker.advance(1.0)
    elif how == "service":
        in_thread(partial(world.services.call, "/end", None))
    else:
        world.handle().Publisher("/in", Message).publish()
    wait_for(done)
    assert loader.list() == []
    assert world.registrations in ([], [("publisher", "/in")])
    loader.load("/n", "suicidal")


def test_signal_shutdown_unloads_its_own_nodelet_and_no_successor(world):
    loader = world.loader(idle=Idle)
    nodelet = loader.load("/going", "idle")
    loader.load("/staying", "idle")
    nodelet.node_handle.signal_shutdown("enough")
    assert loader.list() == ["/staying"]
    assert nodelet.node_handle.is_shutdown()
    new = loader.load("/going", "idle")
    nodelet.node_handle.signal_shutdown("late")  # says so in the log, raises nothing
    assert loader.get("/going") is new
    assert not new.node_handle.is_shutdown()


class TestOnShutdown:
    @pytest.mark.parametrize("by_itself", [False, True])
    def test_runs_once_after_all_callbacks_and_can_still_publish(self, world, by_itself):
        order, got = [], []

        class Polite(Nodelet):
            def on_init(self):
                self.pub = self.node_handle.Publisher("bye", Message)
                self.node_handle.Subscriber("in", Message, lambda m: order.append("callback"))

            def on_shutdown(self):
                assert not self.node_handle.is_shutdown()
                publisher.publish()
                assert world.executor.drain()
                order.append("on_shutdown")
                self.pub.publish(1)

        nh = world.handle()
        nh.Subscriber("/bye", Message, got.append)
        publisher = nh.Publisher("/in", Message)
        loader = world.loader(polite=Polite)
        nodelet = loader.load("/n", "polite")
        publisher.publish()
        world.drain()
        if by_itself:
            nodelet.node_handle.signal_shutdown()
        else:
            loader.unload("/n")
        with pytest.raises(UnknownNodelet):
            loader.unload("/n")
        loader.close()
        publisher.publish()
        world.drain()
        assert order == ["callback", "on_shutdown"]
        assert numbers(got) == [1]

    def test_is_waited_for_a_second_at_most(self, world, caplog, monkeypatch):
        assert SHUTDOWN_PATIENCE == 1.0
        monkeypatch.setattr(loader_module, "SHUTDOWN_PATIENCE", SHUTDOWN_PATIENCE)
        release = threading.Event()

        class Stubborn(Nodelet):
            def on_init(self):
                self.node_handle.Publisher("p", Message)

            def on_shutdown(self):
                wait_for(release)

        loader = world.loader(stubborn=Stubborn)
        loader.load("/n", "stubborn")
        start = time.monotonic()
        loader.unload("/n")
        assert time.monotonic() - start > 0.9
        assert world.registrations == []
        assert "/n: on_shutdown has not returned after 1 s" in caplog.text
        loader.load("/n", "stubborn")
        release.set()
        loader.unload("/n")

    def test_and_each_hook_run_though_others_raise(self, world, caplog):
        ran = []

        class Failing(Nodelet):
            def on_init(self):
                self.node_handle.on_shutdown(lambda: ran.append("first hook"))
                self.node_handle.on_shutdown(lambda: [][0])
                self.node_handle.on_shutdown(lambda: ran.append("last hook"))

            def on_shutdown(self):
                ran.append("on_shutdown")
                raise SystemExit

        loader = world.loader(failing=Failing)
        loader.load("/n", "failing")
        loader.unload("/n")
        assert ran == ["on_shutdown", "first hook", "last hook"]
        assert "/n: on_shutdown raised" in caplog.text
        assert "IndexError" in caplog.text


def test_a_subscriber_that_reads_no_last_words_holds_up_one_nodelet_and_not_all(monkeypatch):
    clock = FakeClock()
    world = World(clock=clock)
    waited = []

    def drain(registration, seconds):
        waited.append(seconds)
        clock.seconds += seconds
        return False

    monkeypatch.setattr(LocalPublisher, "drain", drain)
    contexts = [world.context(f"/{name}") for name in "abc"]
    for context, name in zip(contexts, "abc"):
        handle = PlainNodeHandle(context, f"/{name}")
        for port in ("one", "two"):
            handle.Publisher(port, Message)
    for context in contexts[:2]:
        context.close()
    clock.seconds += 2.0
    contexts[2].close()
    assert waited == pytest.approx([0.2, 0.0, 0.0, 0.0, 0.2, 0.0])
    assert world.registrations == []
