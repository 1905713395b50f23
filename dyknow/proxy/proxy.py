# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet proxy: one for a nodelet, it maps ports to topics and changes that map.

A change is checked as a whole, then applied as a whole. Reconfigurations and declarations of ports
of one nodelet take turns. A turn lasts as long as its registrations and ``PATIENCE``; it waits for
no callback, and looking at ports and statistics needs no turn.
"""

from __future__ import annotations

import collections
import functools
from typing import Any, Callable, Dict, Sequence, Tuple

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.errors import (
    DuplicatePort,
    DyKnowError,
    HandleClosed,
    InvalidConfiguration,
    InvalidName,
    PortConflict,
    RemappedTopic,
    TypeMismatch,
    UnknownPort,
    UnloadedMeanwhile,
)
from dyknow.locks import turn_lock
from dyknow.model.graph import PortState
from dyknow.model.statistics import NodeletStatistics
from dyknow.model.transformation import IN, OUT
from dyknow.nodelet.context import Context, check_message_class
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.middleware import Closable
from dyknow.proxy.port import InPort, OutPort, PortPublisher, PortSubscriber, ProxyPort

PATIENCE = 0.5  # seconds that a reconfiguration waits for peers outside

Change = Tuple[ProxyPort, str]
ReconfigureCallback = Callable[[Dict[str, str], Dict[str, str]], None]


class NodeletProxy(Closable):
    """Ports of one nodelet and where they are connected."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._ports: dict[str, ProxyPort] = {}
        self._turn = turn_lock("reconfiguration")
        self._reconfigurations = 0
        self._callback: ReconfigureCallback | None = None
        #: Called after every change of a port, on the thread that made it.
        self.on_change: Callable[[], None] = lambda: None

    @classmethod
    def of(cls, context: Context) -> NodeletProxy:
        """Return the proxy of a nodelet; the first call makes it."""
        return context.attachment(cls)

    @property
    def name(self) -> str:
        return self._context.name

    def close(self) -> None:
        self._callback = None
        self.on_change = lambda: None

    # For the services

    def get_config(self) -> list[PortState]:
        """Return the ports, in the order of their declaration."""
        return [port.state for port in list(self._ports.values())]

    def set_config(self, config: Sequence[tuple[str, str]]) -> None:
        """Connect ports to topics, all or none; an empty topic disconnects.

        Raises:
            InvalidConfiguration: something is wrong with an entry; nothing was changed.
            LimitExceeded: the request is beyond the limits.
            UnloadedMeanwhile: the nodelet was unloaded; nothing is connected any more.
        """
        before = self._reconfigurations
        try:
            with self._turn:
                changes = self._checked(config)
                if all(port.topic == topic for port, topic in changes):
                    return
                while not self._switched(changes):
                    pass  # a handle was unregistered meanwhile; its port goes on without it
        finally:
            if self._reconfigurations != before:
                self.on_change()

    def get_statistics(self) -> NodeletStatistics:
        context = self._context
        return NodeletStatistics(
            uptime=context.runtime.clock() - context.started_at,
            reconfigurations=self._reconfigurations,
            callback_errors=context.callback_errors,
            ports=tuple(port.statistics() for port in list(self._ports.values())),
            recent_error=context.recent_error(),
        )

    # For the handle

    def set_reconfigure_callback(self, callback: ReconfigureCallback | None) -> None:
        """Call back after every reconfiguration with the maps of in-ports and of out-ports."""
        self._callback = callback

    def publisher(
        self,
        handle: PlainNodeHandle,
        name: str,
        datatype: Any,
        latch: bool,
        queue_size: int | None,
        listener: Any,
        **options: Any,
    ) -> PortPublisher:
        """Declare an out-port, or share one that is there.

        The first handle decides about ``queue_size`` and ``options``; each may have a subscriber
        ``listener``. PortConflict is raised for another direction, type or latch.
        """
        with self._turn:
            port: OutPort = self._declare(OutPort, handle, name, datatype)
            with port.lock:
                if port.publication is None:
                    port.open(self._context, latch, queue_size, options)
                elif port.publication.latch != latch:
                    wanted = "latched" if latch else "not latched"
                    raise PortConflict(name, port.kind, wanted)
                publisher = PortPublisher(self._context, port, listener)
            publisher.connect(port.topic)
            self._add(port)
        self.on_change()
        return publisher

    def subscriber(
        self, handle: PlainNodeHandle, name: str, datatype: Any, *args: Any, **options: Any
    ) -> PortSubscriber:
        """Declare an in-port, or share one that is there; ``args`` are those of ``Subscriber``."""
        with self._turn:
            port = self._declare(InPort, handle, name, datatype)
            subscriber = PortSubscriber(self._context, port, datatype, *args, **options)
            subscriber.connect(port.topic)
            self._add(port)
        self.on_change()
        return subscriber

    # Scripts have other rules.

    def _find(self, name: str) -> ProxyPort | None:
        return self._ports.get(name)

    def _declare(self, kind: Any, handle: PlainNodeHandle, name: str, datatype: Any) -> Any:
        name = names.check(name, "port name")
        check_message_class(name, datatype)
        port = self._ports.get(name)
        if port is None:
            resolved = names.resolve(name, handle.namespace, self._context.name)
            port = kind(name, datatype, self._context.remappings.get(resolved, ""))
            parameter = functools.partial(_parameter, handle, name)
            codec = self._context.runtime.transport.codec(datatype, parameter)
            if codec is not None:
                port.accompany(codec)
                beside = names.below(resolved, codec.form)
                companion = port.companion
                companion.topic = self._context.remappings.get(beside, companion.topic)
                taken = self._ports.get(port.companion.name)
                if taken is not None:
                    raise PortConflict(taken.name, taken.kind, f"the companion of '{name}'")
        elif port.is_companion:
            raise PortConflict(name, "the companion of an image", "a port of its own")
        elif port.direction != kind.direction or port.datatype._md5sum != datatype._md5sum:
            raise PortConflict(name, port.kind, f"{kind.direction}-port of type {datatype._type}")
        return port

    # Inside

    def _add(self, port: ProxyPort) -> None:
        self._ports.update({part.name: part for part in port.parts})

    def _checked(self, config: Sequence[tuple[str, str]]) -> list[Change]:
        guards = self._context.runtime.guards()
        guards.check_sizes((text for pair in config for text in pair), len(config))
        found = [(self._find(name), name, text) for name, text in config]
        counts = collections.Counter(port.name if port else name for port, name, _ in found)
        problems: list[DyKnowError] = [DuplicatePort(name) for name in counts if counts[name] > 1]
        changes: list[Change] = []
        types: dict[str, str] = {}
        for port, name, text in found:
            if port is None:
                problems.append(UnknownPort(name, self._ports))
                continue
            try:
                topic = self._topic(text)
                together = [(port, topic)]
                along = port.takes_along(topic)
                if along is not None and port.companion.name not in counts:
                    together.append((port.companion, along))
                for part, there in together:
                    if there:
                        guards.check_topic(there)
                        self._check_type(part, there, types)
                changes += together
            except DyKnowError as problem:
                problems.append(problem)
        if problems:
            raise InvalidConfiguration(self.name, problems)
        return changes

    def _topic(self, text: str) -> str:
        if not text:
            return ""
        topic = names.resolve(text, names.parent(self.name), self.name, "topic name")
        if topic == "/" or topic.endswith("/"):
            raise InvalidName(text, "topic name")
        target = self._context.runtime.node.remap(topic)
        if target != topic:
            raise RemappedTopic(topic, target)
        return topic

    def _check_type(self, port: ProxyPort, topic: str, types: dict[str, str]) -> None:
        # ``types`` has the type of each topic, or of the first port that comes to it.
        wanted = port.datatype._type
        if wanted == "*":
            return
        if topic not in types and topic != port.topic:
            types[topic] = self._context.runtime.bus.datatype_of(topic)
        present = types.get(topic) or wanted
        types[topic] = present
        if not types_fit(present, wanted):
            raise TypeMismatch(topic, f"{wanted} (port '{port.name}')", present)

    def _maps(self, changes: Sequence[Change]) -> tuple[dict[str, str], dict[str, str]]:
        topics = {port.name: topic for port, topic in changes}
        maps: dict[str, dict[str, str]] = {IN: {}, OUT: {}}
        for port in self._ports.values():
            if port.is_companion:  # the author declared none
                continue
            maps[port.direction][port.name] = topics.get(port.name, port.topic)
        return maps[IN], maps[OUT]

    def _switched(self, changes: Sequence[Change]) -> bool:
        context, callback = self._context, self._callback
        maps = self._maps(changes)
        moves = [(endpoint, topic) for port, topic in changes for endpoint in port.endpoints()]
        if context.closed or context.is_leaving:
            raise UnloadedMeanwhile(self.name, "reconfiguration")

        def notify() -> None:
            assert callback is not None
            try:
                callback(*maps)
            except BaseException as error:  # the boundary: the switch stands all the same
                context.failed("a reconfiguration", error)

        def on_switch() -> None:
            for port, topic in changes:
                port.topic = topic
                self._ports.setdefault(port.name, port)  # a script may name one before it is made
            self._reconfigurations += 1
            if callback is not None:
                context.strand.post(notify)

        try:
            context.runtime.bus.rewire(moves, on_switch, PATIENCE)
        except HandleClosed as closed:
            if context.closed:
                raise UnloadedMeanwhile(self.name, "reconfiguration") from closed
            return False
        except TypeMismatch as problem:
            raise InvalidConfiguration(self.name, [problem]) from problem
        return True


def _parameter(handle: PlainNodeHandle, port: str, key: str, default: Any) -> Any:
    """Return a parameter of a port, else that of the nodelet."""
    of_port = f"~{port.lstrip('~/')}/{key}"
    return handle.get_param(of_port, handle.get_param(f"~{key}", default))
