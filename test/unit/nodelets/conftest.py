"""Nodelets without ROS: on a local middleware with the few functions of rospy that they use."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, List

import genpy
import pytest

from dyknow.nodelet.context import Context, Runtime
from dyknow.nodelet.handle import NodeHandle
from dyknow.nodelet.loader import Loader
from dyknow.nodelet.local import LocalMiddleware
from dyknow.nodelet.scheduler import ManualExecutor


@dataclass
class RosTimeMiddleware(LocalMiddleware):
    """Adds time and the log to the local middleware; ROS time is that of the ticker."""

    log: List[str] = field(default_factory=list)

    def member(self, name: str, handle: Any) -> Any:
        members = {
            "Time": Clock(self),
            "Duration": genpy.Duration.from_sec,
            "get_time": self.ticker.now,
            "loginfo": lambda text, *args: self.log.append(text % args),
        }
        return members[name] if name in members else super().member(name, handle)

    def period(self, duration: Any) -> float:
        return duration.to_sec()


class Clock:
    def __init__(self, middleware: LocalMiddleware) -> None:
        self._middleware = middleware

    def now(self) -> genpy.Time:
        return genpy.Time.from_sec(self._middleware.ticker.now())


class World:
    """One process of nodelets whose time and threads are ours."""

    def __init__(self) -> None:
        self.middleware = RosTimeMiddleware()
        self.executor = ManualExecutor()
        self.runtime = Runtime.make(self.middleware, self.executor)
        probe = Context(self.runtime, "/probe")
        probe.start()
        self.handle = NodeHandle(probe, "/")

    def load(self, nodelet_class: type, **parameters: Any) -> Any:
        """Load /nodelet with its ports in, out on topics of those names."""
        for name, value in parameters.items():
            self.middleware.parameters[f"/nodelet/{name}"] = value
        loader = Loader(self.runtime, lambda name: nodelet_class)
        return loader.load("/nodelet", "test/Nodelet", {"/in": "/in", "/out": "/out"})

    def listen(self, topic: str, datatype: Any, receive: Callable[[Any], None]) -> None:
        self.handle.Subscriber(topic, datatype, receive)

    def publisher(self, topic: str, datatype: Any) -> Any:
        return self.handle.Publisher(topic, datatype, queue_size=1)

    def advance(self, seconds: float) -> None:
        """Let time pass, and timers and callbacks run that are due by then."""
        self.middleware.ticker.advance(seconds)
        self.runtime.timers.tick()
        self.executor.drain()


@pytest.fixture
def world():
    world = World()
    yield world
    world.runtime.close()
