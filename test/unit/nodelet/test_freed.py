# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""After its unload a nodelet's memory is free, without any garbage collection."""

from __future__ import annotations

import functools
import gc
import threading
import weakref
from typing import Any, Callable, Iterator, List, Type

import pytest
from clocks import eventually, in_thread, join, wait_for
from unit.nodelet.fakes import Message, World, pool_world

import dyknow
from dyknow.errors import LoadFailed
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.loading.memory import break_cycles

world = pool_world(3)


@pytest.fixture(autouse=True, scope="module")
def no_collections() -> Iterator[None]:
    gc.collect()
    gc.disable()
    yield
    gc.enable()


class Block:
    """Stands for much memory."""


class Filter:
    """Keeps its inputs and a callback, as those of message_filters."""

    def __init__(self, inputs: List[Any], callback: Callable[..., None]) -> None:
        self.callbacks = {0: (callback, ())}
        self.inputs = inputs
        self.numbers = [each.registerCallback(self.add, each) for each in inputs]

    def add(self, message: Any, source: Any) -> None:
        for callback, args in self.callbacks.values():
            callback(message, source, *args)


class Holding(Nodelet):
    """A nodelet that holds a block, and calls the `make` of a test."""

    make: Callable[[Any], Any]
    block: Any
    blocks: Any

    def on_init(self):
        self.block = Block()
        type(self).blocks = weakref.ref(self.block)
        type(self).make(self)

    def on_message(self, *args):
        pass

    on_two = peer_subscribe = peer_unsubscribe = on_message


def holding(make: Callable[[Any], Any], base: Type[Holding] = Holding) -> Type[Holding]:
    return type("Some", (base,), {"make": make})


class Hanging(Holding):
    """Its callback waits for the test."""

    started: threading.Event
    release: threading.Event

    def on_message(self, *args):
        self.started.set()
        wait_for(self.release)
        assert self.block is not None, "it has all that it needs until its end"


@pytest.fixture(autouse=True)
def hanging() -> Iterator[None]:
    Hanging.started, Hanging.release = threading.Event(), threading.Event()
    yield
    Hanging.release.set()


def keep(**made: Callable[[Any], Any]) -> Callable[[Any], None]:
    def make(nodelet: Any) -> None:
        for name, call in made.items():
            setattr(nodelet, name, call(nodelet))

    return make


def port(nodelet: Any) -> Any:
    nodelet.nh = dyknow.NodeHandle(nodelet.node_handle)
    return nodelet.nh


def filtered(nodelet: Any) -> Any:
    nh = port(nodelet)
    inputs = [nh.Subscriber(name, Message) for name in "ab"]
    return Filter(inputs, nodelet.on_two)


def reconfigured(nodelet: Any) -> None:
    port(nodelet).set_reconfigure_callback(nodelet.on_message)


def latched(nodelet: Any) -> Any:
    publisher = nodelet.node_handle.Publisher("out", Message, latch=True)
    publisher.publish(Message(nodelet.block))
    return publisher


KINDS = {
    "nothing": keep(),
    "subscriber": keep(sub=lambda n: n.node_handle.Subscriber("in", Message, n.on_message)),
    "arguments": keep(sub=lambda n: n.node_handle.Subscriber("in", Message, n.on_message, n)),
    "further callback": keep(
        sub=lambda n: n.node_handle.Subscriber("in", Message),
        number=lambda n: n.sub.registerCallback(n.on_message, n),
    ),
    "overlapping": keep(sub=lambda n: n.mt_node_handle.Subscriber("in", Message, n.on_message)),
    "in-port": keep(sub=lambda n: port(n).Subscriber("in", Message, n.on_message)),
    "out-port": keep(pub=lambda n: port(n).Publisher("out", Message, n)),
    "listener": keep(pub=lambda n: n.node_handle.Publisher("out", Message, n)),
    "latched message": keep(pub=latched),
    "timer": keep(timer=lambda n: n.node_handle.Timer(1.0, n.on_message)),
    "single timer": keep(timer=lambda n: n.node_handle.Timer(1.0, n.on_message, oneshot=True)),
    "service": keep(service=lambda n: n.node_handle.Service("service", object, n.on_message)),
    "reconfigure callback": reconfigured,
    "shutdown hook": keep(hook=lambda n: n.node_handle.on_shutdown(n.on_message)),
    "message filter": keep(both=filtered),
    "lambda": keep(call=lambda n: lambda: n.block),
    "partial": keep(call=lambda n: [functools.partial(n.on_message, n)]),
    "itself": keep(me=lambda n: {"me": n}),
    "unregistered": keep(
        sub=lambda n: n.node_handle.Subscriber("in", Message, n.on_message),
        end=lambda n: n.sub.unregister(),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_an_unload_frees_the_nodelet(world: World, kind: str) -> None:
    some = holding(KINDS[kind])
    loader = world.loader(some=some)
    loader.load("/n", "some")
    world.transport.send("/in", Message())
    world.ticker.advance(1.5)
    world.drain()
    assert some.blocks() is not None
    loader.unload("/n")
    assert some.blocks() is None


def look_up(nodelet: Any) -> Any:
    return {}[nodelet.name]


@pytest.mark.parametrize("kind", KINDS)
def test_a_load_that_fails_frees_the_nodelet(world: World, kind: str) -> None:
    def make(nodelet: Any) -> None:
        KINDS[kind](nodelet)
        try:
            look_up(nodelet)
        except KeyError:
            raise RuntimeError("injected") from ValueError("first")

    some = holding(make)
    loader = world.loader(some=some)
    with pytest.raises(LoadFailed) as failure:
        loader.load("/n", "some")
    assert some.blocks() is None, "although the error is still there, with its causes"
    assert "injected" in str(failure.value)


def test_callbacks_that_raise_hold_nothing(world: World) -> None:
    class Raising(Holding):
        def on_message(self, *args):
            raise RuntimeError("injected")

    def make(nodelet: Any) -> None:
        for kind in ("subscriber", "timer", "service"):
            KINDS[kind](nodelet)

    some = holding(make, Raising)
    loader = world.loader(some=some)
    loader.load("/n", "some")
    world.transport.send("/in", Message())
    world.ticker.advance(1.5)
    with pytest.raises(RuntimeError):
        world.services.call("/service", object())
    world.drain()
    loader.unload("/n")
    assert some.blocks() is None


def test_a_callback_that_outlives_the_nodelet_frees_it_at_its_end(world: World) -> None:
    def make(nodelet: Any) -> None:
        KINDS["message filter"](nodelet)
        KINDS["subscriber"](nodelet)

    some = holding(make, Hanging)
    loader = world.loader(some=some)
    loader.load("/n", "some")
    message = Message()
    waiting = weakref.ref(message)
    world.transport.send("/in", Message())
    wait_for(Hanging.started)
    world.transport.send("/in", message)
    del message
    loader.unload("/n")
    assert waiting() is None, "messages that wait go with the nodelet"
    assert some.blocks() is not None
    Hanging.release.set()
    eventually(lambda: some.blocks() is None)


def test_a_callback_may_unload_its_own_nodelet(world: World) -> None:
    class Ending(Holding):
        def on_message(self, *args):
            self.node_handle.signal_shutdown()

    some = holding(KINDS["subscriber"], Ending)
    world.loader(some=some).load("/n", "some")
    world.transport.send("/in", Message())
    eventually(lambda: some.blocks() is None)


def test_what_a_thread_still_uses_is_left_alone(world: World) -> None:
    release, seen = threading.Event(), []

    def make(nodelet: Any) -> None:
        def work() -> None:
            wait_for(release)
            seen.append(nodelet.block is not None)

        nodelet.thread = in_thread(work)
        nodelet.me = nodelet

    some = holding(make)
    loader = world.loader(some=some)
    loader.load("/n", "some")
    loaded: Any = loader.get("/n")
    thread = loaded.thread
    del loaded
    loader.unload("/n")
    assert some.blocks() is not None
    release.set()
    join(thread)
    assert seen == [True]


def test_an_object_with_a_finalizer_is_left_to_python() -> None:
    class Finalized:
        def __del__(self) -> None:
            pass

    each: Any = Finalized()
    each.me = each
    reference = weakref.ref(each)
    del each
    assert not break_cycles(reference)
    each = reference()
    assert each is not None
    del each.me
