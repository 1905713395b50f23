# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the tests of the runtime: message types, a small world, ways to wait."""

from __future__ import annotations

import time
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence

import pytest
from clocks import PATIENCE, eventually

import dyknow
from dyknow.nodelet.context import Context, Runtime
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.loading.loader import Loader
from dyknow.nodelet.local import LocalMiddleware, LocalPublisher, LocalSubscriber, LocalTransport
from dyknow.nodelet.scheduler import Executor, ManualExecutor, WorkerPool


class Message:
    """A message type with one field."""

    _type = "test/Message"
    _md5sum = "message"

    def __init__(self, number: Any = 0) -> None:
        self.number = number

    def __repr__(self) -> str:
        return f"Message({self.number})"


class OtherMessage(Message):
    """A message type other than ``Message``."""

    _type = "test/OtherMessage"
    _md5sum = "other"


class AnyMessage(Message):
    """Stands for every type, as rospy.AnyMsg does."""

    _type = "*"
    _md5sum = "*"


class WithoutText(Exception):
    """An error whose text cannot be made."""

    def __str__(self) -> str:
        return 5  # type: ignore[return-value]


class ExitWithoutText(SystemExit):
    """The same of ``sys.exit``."""

    __str__ = WithoutText.__str__  # type: ignore[assignment]


class FakeClock:
    """Steady time that a test sets."""

    def __init__(self) -> None:
        self.seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


class RecordingTransport(LocalTransport):
    """Records registrations in order, and can refuse or pause at a topic."""

    def __init__(self) -> None:
        super().__init__()
        self.made: List[Any] = []
        self.refused: Dict[str, Exception] = {}
        self.on_register: Callable[[str], None] = lambda topic: None
        self.on_made: Callable[[Any], None] = lambda registration: None

    def advertise(self, *args: Any) -> LocalPublisher:
        return self._register(super().advertise, *args)

    def subscribe(self, *args: Any) -> LocalSubscriber:
        return self._register(super().subscribe, *args)

    def _register(self, register: Callable[..., Any], topic: str, *args: Any) -> Any:
        if topic in self.refused:
            raise self.refused[topic]
        self.on_register(topic)
        registration = register(topic, *args)
        self.made.append(registration)
        self.on_made(registration)
        return registration


class World:
    """A runtime on a local middleware, by default deterministic."""

    def __init__(
        self, executor: Optional[Executor] = None, clock: Any = time.monotonic, **options: Any
    ) -> None:
        self.executor: Any = executor or ManualExecutor(clock)
        self.transport = RecordingTransport()
        middleware = LocalMiddleware(self.transport)
        self.services, self.node = middleware.services, middleware.node
        self.ticker = middleware.ticker
        self.runtime = Runtime(middleware, self.executor, **options)
        self.bus = self.runtime.bus

    def context(self, name: str = "/probe", **options: Any) -> Context:
        """A nodelet's context, with callbacks enabled."""
        context = Context(self.runtime, name, **options)
        context.start()
        return context

    def handle(self, name: str = "/probe", concurrent: bool = False) -> PlainNodeHandle:
        """A plain handle in the root namespace, of a nodelet of its own."""
        return PlainNodeHandle(self.context(name), "/", concurrent)

    def publisher(self, topic: str, datatype: Any = Message, **options: Any) -> Any:
        """A publisher of a nodelet of its own."""
        return self.handle("/publisher").Publisher(topic, datatype, queue_size=1, **options)

    def listen(self, topic: str, **options: Any) -> List[Any]:
        """The numbers of all messages that a nodelet of its own receives on a topic."""
        received: List[Any] = []
        handle = self.handle("/listener")
        handle.Subscriber(topic, Message, lambda m: received.append(m.number), **options)
        return received

    def loader(self, **classes: Any) -> Loader:
        """A loader whose types are the keywords."""
        return Loader(self.runtime, lambda name, _: classes[name])

    def drain(self) -> None:
        """Run everything that can run."""
        assert self.executor.drain(PATIENCE), "callbacks have not ended"

    @property
    def registrations(self) -> List[Any]:
        """The registrations outside, sorted."""
        return self.transport.registrations

    def close(self) -> None:
        """End the threads."""
        self.runtime.close()


class Idle(dyknow.Nodelet):
    """A nodelet without ports or callbacks."""

    def on_init(self) -> None:
        pass


def make_pool_world(size: int = 4, **options: Any) -> World:
    """A world on real threads."""
    return World(WorkerPool(size, **options))


def pool_world(size: int) -> Any:
    """A fixture, by the name it is given to: a world on real threads, which end with the test."""

    @pytest.fixture
    def world() -> Iterator[World]:
        world = make_pool_world(size)
        yield world
        world.close()

    return world


def numbers(messages: Sequence[Message]) -> List[Any]:
    """The field of each message."""
    return [message.number for message in messages]


def paced(count: int, *sent: Callable[[], int]) -> Iterator[int]:
    """Numbers; every tenth waits until more messages were sent, so that the two overlap."""
    for number in range(count):
        yield number
        if number % 10 == 0:
            due = [each() + 20 for each in sent]
            eventually(lambda due=due: all(each() >= d for each, d in zip(sent, due)))
