# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Callbacks that do not return are announced, those of nodelets that were unloaded too."""

from __future__ import annotations

import logging
import threading
from typing import Iterator, List

import pytest
from clocks import Gate, eventually, in_thread, join, wait_for
from unit.nodelet.fakes import FakeClock, Message, World, make_pool_world

import dyknow
from dyknow.errors import DyKnowError, UnloadedMeanwhile
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.loading.leftovers import StuckCallbacks
from dyknow.nodelet.loading.loader import Loader
from dyknow.nodelet.streams.pubsub import Subscriber


class Hanging(Nodelet):
    """Its callbacks wait for the test."""

    started: threading.Event
    release: threading.Event
    beside: Subscriber

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.nh.Subscriber("in", Message, self.on_message)
        Hanging.beside = self.mt_node_handle.Subscriber("beside", Message, self.on_message)
        self.mt_node_handle.Service("ask", object, self.on_message)

    def on_message(self, message):
        self.started.set()
        wait_for(self.release)


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def world(clock: FakeClock) -> Iterator[World]:
    Hanging.started, Hanging.release = threading.Event(), threading.Event()
    world = make_pool_world(3, clock=clock)
    yield world
    Hanging.release.set()
    world.close()


@pytest.fixture
def loader(world: World) -> Loader:
    loader = world.loader(hanging=Hanging)
    loader.load("/n", "hanging", {"/in": "/a"})
    return loader


@pytest.mark.parametrize("topic", ["/a", "/beside"])
def test_a_callback_that_does_not_return_is_announced_each_time_its_age_has_doubled(
    world: World, loader: Loader, clock: FakeClock, topic: str
) -> None:
    told: List[str] = []
    stuck = StuckCallbacks(loader, "/manager", 10.0, told.append)
    world.transport.send(topic, Message())
    wait_for(Hanging.started)
    announced, details = [], []
    for _ in range(10):
        stuck.check()
        announced.append(len(told))
        details.append(stuck.detail("/n"))
        clock.seconds += 5.0
    assert announced == [0, 0, 1, 1, 2, 2, 2, 2, 3, 3]
    running = [f"a callback has been running for {seconds} s" for seconds in range(10, 50, 5)]
    assert details == ["", "", *running]
    Hanging.release.set()
    world.drain()
    eventually(lambda: loader.get("/n").context.callback_age() == 0.0)
    stuck.check()
    assert told == ["/n"] * 4, "its end is announced too"
    assert stuck.detail("/n") == ""
    stuck.check()
    assert len(told) == 4


def test_a_callback_that_outlives_its_nodelet_is_named_until_it_ends(
    world: World, loader: Loader, clock: FakeClock, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, "rosout.dyknow")
    told: List[str] = []
    stuck = StuckCallbacks(loader, "/manager", 10.0, told.append)
    world.transport.send("/a", Message())
    wait_for(Hanging.started)
    loader.unload("/n")
    clock.seconds += 12.0
    assert stuck.remains() == ["/n was unloaded, but code of it has been running for 12 s"]
    for _ in range(3):
        stuck.check()
    assert [each.getMessage() for each in caplog.records] == [
        "/n was unloaded, but code of it has been running for 12 s; it ends with its process "
        "alone: rosnode kill /manager, which a DyKnow manager starts again with the other "
        "nodelets; spawn such a nodelet isolated"
    ]
    assert told == []
    loader.load("/n", "hanging")
    assert stuck.detail("/n") == "", "that of its name is another one"
    Hanging.release.set()
    eventually(lambda: not stuck.remains())
    loader.close()


@pytest.mark.parametrize("kind", ["service", "subscriber"])
def test_a_callback_that_overlaps_with_others_outlives_its_strand(
    world: World, loader: Loader, clock: FakeClock, kind: str
) -> None:
    context, freed = loader.get("/n").context, []
    context.last_hooks.append(lambda: freed.append(Hanging.release.is_set()))
    if kind == "service":
        calling = in_thread(lambda: pytest.raises(DyKnowError, world.services.call, "/ask", None))
        wait_for(Hanging.started)
    else:
        world.transport.send("/beside", Message())
        wait_for(Hanging.started)
        calling = in_thread(Hanging.beside.unregister)
        join(calling)
    assert context.is_busy()
    loader.unload("/n")
    join(calling)
    clock.seconds += 12.0
    assert loader.leftovers.running() == {"/n": 12.0}
    Hanging.release.set()
    eventually(lambda: freed)
    assert freed == [True]
    loader.close()


def test_an_on_init_that_outlives_its_nodelet_is_named_until_it_ends(
    world: World, gate: Gate
) -> None:
    class Slow(Nodelet):
        on_init = gate.__call__

    loader = world.loader(slow=Slow)
    thread = in_thread(lambda: pytest.raises(UnloadedMeanwhile, loader.load, "/slow", "slow"))
    wait_for(gate.begun)
    loader.unload("/slow")
    join(thread)
    assert list(loader.leftovers.running()) == ["/slow"]
    gate.open()
    eventually(lambda: not loader.leftovers.running())
    loader.close()


def test_callbacks_that_got_no_thread_are_started_at_the_next_check(world: World) -> None:
    caught_up: List[bool] = []
    world.executor.catch_up = lambda: caught_up.append(True)
    StuckCallbacks(world.loader(), "/manager", 10.0, print).check()
    assert caught_up == [True]


def test_a_strand_that_is_dropped_during_on_init_leaves_nothing(world: World) -> None:
    context = Context(world.runtime, "/starting")
    strand = context.new_strand("test")
    strand.post(lambda: None)
    context.drop_strand(strand)
    assert context._strands == [context.strand]
    assert not strand.busy
