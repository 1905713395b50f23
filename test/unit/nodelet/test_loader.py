# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Loading: names, failures, and nodelets that start independently of each other."""

from __future__ import annotations

from contextlib import suppress
from typing import Any
from unittest import mock

import pytest
from clocks import PATIENCE, eventually, in_thread, join, wait_for
from unit.nodelet.fakes import Idle, Message, WithoutText, numbers, pool_world

from dyknow.errors import (
    BrokenPlugin,
    HandleClosed,
    LoadFailed,
    NameTaken,
    UnknownNodelet,
    UnloadedMeanwhile,
)
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.loading import loader as loader_module
from dyknow.nodelet.loading.loader import Loader

world = pool_world(3)


@pytest.fixture(name="slow")
def _slow(gate):
    """A nodelet whose ``on_init`` waits at the gate."""

    class Slow(Nodelet):
        def on_init(self):
            self.pub = self.node_handle.Publisher("early", Message)
            gate()
            self.late = self.node_handle.Publisher("late", Message)

    return Slow


def load_in_thread(loader, *args):
    outcome = []

    def load():
        try:
            outcome.append(loader.load(*args))
        except Exception as error:
            outcome.append(error)

    return in_thread(load), outcome


def test_a_loaded_nodelet_has_its_name_arguments_and_callbacks(world):
    class Echo(Nodelet):
        def on_init(self):
            self.pub = self.node_handle.Publisher("out", Message)
            self.node_handle.Subscriber("in", Message, self.pub.publish)

    loader = world.loader(echo=Echo)
    nodelet = loader.load("/ns/echo", "echo", {"/ns/out": "/result"}, ["-v", "x"])
    assert nodelet.name == "/ns/echo"
    assert nodelet.my_argv == ["-v", "x"]
    assert loader.get("/ns/echo") is nodelet
    got, nh = [], world.handle()
    nh.Subscriber("/result", Message, got.append)
    nh.Publisher("/ns/in", Message).publish(3)
    world.drain()
    assert numbers(got) == [3]


@pytest.mark.parametrize("concurrent", [False, True])
def test_what_comes_during_on_init_is_called_back_after_it(world, slow, gate, concurrent):
    got = []

    class Late(slow):  # type: ignore[valid-type]
        def on_init(self):
            handle = self.mt_node_handle if concurrent else self.node_handle
            handle.Subscriber("in", Message, got.append)
            handle.Timer(1.0, lambda event: got.append("timer"), oneshot=True)
            super().on_init()
            got.append("on_init has returned")

    loader = world.loader(late=Late)
    thread, _ = load_in_thread(loader, "/late", "late")
    wait_for(gate.begun)
    message = Message()
    world.handle().Publisher("/in", Message).publish(message)
    world.ticker.advance(1.0)
    eventually(lambda: not world.runtime.timers._heap)
    # Everything that could run by now was given to the workers before this one.
    others = [world.context(f"/other{n}").strand for n in range(20)]
    for strand in others:
        strand.post(lambda: None)
    eventually(lambda: not any(strand.busy for strand in others))
    gate.open()
    join(thread)
    eventually(lambda: len(got) == 3)
    assert got[0] == "on_init has returned"
    assert message in got


def test_nodelets_are_listed_by_name_and_closed_from_the_newest(world):
    gone = []
    loader = Loader(world.runtime, lambda name, _: Idle, on_unloaded=gone.append)
    for name in ("/b", "/a", "/c"):
        loader.load(name, "idle")
    assert loader.list() == ["/a", "/b", "/c"]
    for call in (loader.get, loader.unload):
        with pytest.raises(UnknownNodelet, match="'/gone' is loaded; loaded: /a, /b, /c"):
            call("/gone")
    loader.close()
    assert [context.name for context in gone] == ["/c", "/a", "/b"]
    assert loader.list() == []


def test_a_name_that_is_being_unloaded_is_waited_for_a_while(world, gate, monkeypatch):
    class Leaving(Idle):
        on_shutdown = gate.__call__

    loader = world.loader(leaving=Leaving, idle=Idle)
    loader.load("/n", "leaving")
    unloading = in_thread(lambda: loader.unload("/n"))
    wait_for(gate.begun)
    with pytest.raises(UnknownNodelet):
        loader.unload("/n")
    monkeypatch.setattr(loader_module, "_UNLOAD_PATIENCE", 0.05)
    with pytest.raises(NameTaken, match="'/n' is still being unloaded"):
        loader.load("/n", "idle")
    monkeypatch.setattr(loader_module, "_UNLOAD_PATIENCE", PATIENCE)
    loading, outcome = load_in_thread(loader, "/n", "idle")
    assert not outcome
    gate.open()
    join(unloading, loading)
    assert type(outcome[0]) is Idle


class TestFailure:
    def test_a_type_that_cannot_be_found_or_made_leaves_the_name_free(self, world):
        class Broken(Idle):
            def __init__(self):
                raise OSError("no camera")

        class Empty(Nodelet):
            pass

        not_found = BrokenPlugin("pkg/X", "does not import")
        loader = Loader(world.runtime, mock.Mock(side_effect=[not_found, Broken, Empty, Idle]))
        for error, text in (
            (BrokenPlugin, "does not import"),
            (LoadFailed, "OSError: no camera"),
            (LoadFailed, r"Empty does not define on_init\(\)"),
        ):
            with pytest.raises(error, match=text):
                loader.load("/n", "pkg/X")
            assert loader.list() == []
        loader.load("/n", "pkg/X")

    @pytest.mark.parametrize(
        "error", [ValueError("bad rate"), SystemExit(1), KeyboardInterrupt(), WithoutText()]
    )
    def test_an_error_of_on_init_fails_the_load_and_leaves_nothing(self, world, error):
        kept: list[Any] = []

        class Failing(Nodelet):
            def on_init(self):
                nh = self.node_handle
                kept.append(nh.Publisher("p", Message, latch=True))
                kept[0].publish(1)
                nh.Subscriber("s", Message, print)
                self.mt_node_handle.Subscriber("m", Message, print)
                nh.Service("service", object, print)
                nh.Timer(1.0, print)
                raise error

            def on_shutdown(self):
                kept.append("it did not start")

        loader = world.loader(failing=Failing, idle=Idle)
        with pytest.raises(LoadFailed) as caught:
            loader.load("/n", "failing")
        assert caught.value.cause is caught.value.__cause__ is error
        assert f"cannot load '/n' of type failing: {type(error).__name__}" in str(caught.value)
        assert loader.list() == []
        assert world.registrations == []
        assert world.services.handlers == {}
        assert world.runtime.timers._heap == []
        assert world.bus._topics == {}
        with pytest.raises(HandleClosed):
            kept[0].publish()
        assert len(kept) == 1
        loader.load("/n", "idle")


class TestSlowStart:
    def test_takes_its_name_and_blocks_neither_list_nor_other_loads_and_unloads(
        self, world, slow, gate
    ):
        loader = world.loader(slow=slow, idle=Idle)
        thread, outcome = load_in_thread(loader, "/slow", "slow")
        wait_for(gate.begun)
        assert loader.list() == []
        loader.load("/other", "idle")
        assert loader.list() == ["/other"]
        loader.unload("/other")
        with pytest.raises(UnknownNodelet):
            loader.get("/slow")
        with pytest.raises(NameTaken, match="'/slow' is being loaded"):
            loader.load("/slow", "idle")
        assert outcome == []
        gate.open()
        join(thread)
        assert loader.list() == ["/slow"]
        with pytest.raises(NameTaken, match="'/slow' is already loaded"):
            loader.load("/slow", "idle")
        assert loader.get("/slow") is outcome[0]
        assert not outcome[0].context.closed

    def test_can_be_unloaded_in_the_middle(self, world, slow, gate):
        loader = world.loader(slow=slow)
        thread, outcome = load_in_thread(loader, "/slow", "slow")
        wait_for(gate.begun)
        assert world.registrations == [("publisher", "/early")]
        loader.unload("/slow")
        assert world.registrations == []
        join(thread)
        assert isinstance(outcome[0], UnloadedMeanwhile)
        again, _ = load_in_thread(loader, "/slow", "slow")
        gate.open()
        join(again)
        assert loader.list() == ["/slow"]
        eventually(
            lambda: world.registrations == [("publisher", "/early"), ("publisher", "/late")]
        )

    @pytest.mark.parametrize("fails", [False, True])
    def test_unloaded_while_its_class_is_imported_is_never_started(self, world, gate, fails):
        started = []

        class Started(Nodelet):
            def on_init(self):
                started.append(self.name)

        def find(name, _):
            if name == "idle":
                return Idle
            gate()
            if fails:
                raise BrokenPlugin("slow", "does not import")
            return Started

        loader = Loader(world.runtime, find)
        thread, outcome = load_in_thread(loader, "/n", "started")
        wait_for(gate.begun)
        loader.unload("/n")
        successor = loader.load("/n", "idle")
        gate.open()
        join(thread)
        assert isinstance(outcome[0], BrokenPlugin if fails else UnloadedMeanwhile)
        assert loader.get("/n") is successor
        world.drain()
        assert started == []

    def test_may_unload_itself(self, world):
        class Unwilling(Nodelet):
            def on_init(self):
                self.node_handle.Publisher("p", Message)
                self.node_handle.signal_shutdown("not today")

        loader = world.loader(unwilling=Unwilling)
        with pytest.raises(UnloadedMeanwhile):
            loader.load("/n", "unwilling")
        assert loader.list() == []
        assert world.registrations == []


def test_loads_and_unloads_of_one_name_from_many_threads_end_clean(world):
    class Busy(Nodelet):
        def on_init(self):
            self.pub = self.node_handle.Publisher("t", Message)
            self.node_handle.Subscriber("t", Message, lambda message: None)
            self.pub.publish()

    loader = world.loader(busy=Busy)
    loaded = []

    def run():
        for _ in range(60):
            with suppress(NameTaken, UnloadedMeanwhile):
                loaded.append(loader.load("/n", "busy"))
            with suppress(UnknownNodelet):
                loader.unload("/n")

    join(*[in_thread(run) for _ in range(4)])
    loader.close()
    world.drain()
    assert loaded
    assert loader.list() == []
    assert world.registrations == []
    assert world.bus._topics == {}
