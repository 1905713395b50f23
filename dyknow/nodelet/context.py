# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What one nodelet owns in the runtime, and returns when it is unloaded.

Who owns what: the ``Runtime`` is one for the process; a ``Context`` is one for a nodelet and owns
its strands, endpoints, services and timers. Handles only refer to it.
"""

from __future__ import annotations

import logging
import threading
import time
import traceback
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, TypeVar

from dyknow import names
from dyknow.errors import NoMessageClass
from dyknow.guards import NO_GUARDS, Guards
from dyknow.locks import state_lock
from dyknow.nodelet.bus import Bus, Endpoint
from dyknow.nodelet.endpoints import Callback, Publication, Subscription
from dyknow.nodelet.middleware import Closable, Middleware, Node, Services, Transport
from dyknow.nodelet.scheduler import Clock, Executor, Strand
from dyknow.nodelet.timers import Timer, TimerQueue

#: Seconds between two log entries of the same error at the same place.
_LOG_PAUSE = 1.0
#: Errors that are told apart; with one more the counts start again.
_LOG_PLACES = 100

Part = TypeVar("Part", bound=Closable)

_log = logging.getLogger("rosout.dyknow")


def _no_callback(message: Any) -> None:
    """Receive a message that no callback is for."""


def check_message_class(what: str, datatype: Any) -> None:
    """Raise NoMessageClass unless ``datatype`` is a class of messages."""
    if not isinstance(datatype, type) or not hasattr(datatype, "_md5sum"):
        raise NoMessageClass(what, datatype)


@dataclass(frozen=True)
class Runtime:
    """The parts of the process that all nodelets share."""

    node: Node
    services: Services
    transport: Transport
    bus: Bus
    executor: Executor
    timers: TimerQueue
    #: Runs callbacks that may block for long.
    blocking: Executor
    clock: Clock = time.monotonic
    #: Returns what must not be done at this moment.
    guards: Callable[[], Guards] = lambda: NO_GUARDS

    @classmethod
    def make(
        cls,
        middleware: Middleware,
        executor: Executor,
        clock: Clock = time.monotonic,
        guards: Callable[[], Guards] = lambda: NO_GUARDS,
        blocking: Optional[Executor] = None,
        bound: bool = True,
    ) -> Runtime:
        """Put a runtime together.

        Args:
            middleware: the outside.
            executor: runs callbacks.
            clock: steady time.
            guards: returns what may not be done at this moment.
            blocking: runs callbacks that may block for long; by default the ``executor`` does.
            bound: whether the guards bind every endpoint, not only what ``set_config`` connects.
        """
        check = (lambda topic: guards().check_topic(topic)) if bound else None
        transport = middleware.transport
        return cls(
            middleware.node,
            middleware.services,
            transport,
            Bus(transport, clock, check),
            executor,
            TimerQueue(middleware.ticker),
            blocking or executor,
            clock,
            guards,
        )

    def close(self) -> None:
        """End the threads."""
        self.timers.close()
        self.executor.close()
        self.blocking.close()


class Context:
    """One nodelet's share of the runtime."""

    def __init__(
        self,
        runtime: Runtime,
        name: str,
        remappings: Optional[Mapping[str, str]] = None,
        my_argv: Sequence[str] = (),
    ) -> None:
        """Prepare a nodelet's share; its callbacks wait until ``start``."""
        self.runtime = runtime
        #: Runs the strands that are made from now on.
        self.executor = runtime.executor
        self.name = name
        self.remappings = dict(remappings or {})
        self.my_argv = tuple(my_argv)
        self.mark = names.mark(name)
        self.strand = Strand(runtime.executor, name, held=True, mark=self.mark)
        self.callback_errors = 0
        self._failures: Dict[Tuple[str, type, str], Tuple[float, int]] = {}
        self.closed = False
        self.closed_at = 0.0
        #: Threads of its own that have not ended at the unload.
        self.late_threads: List[threading.Thread] = []
        self.started_at = runtime.clock()
        #: Set by the host: unloads this nodelet.
        self.unload: Callable[[], None] = self.close
        #: Set by the host: called with what is attached, returns what it opened for it.
        self.on_attach: Callable[[Context, Any], Optional[Closable]] = lambda context, thing: None
        self.attached: Any = None
        self.shutdown_hooks: List[Callable[[], None]] = []
        #: Called when the nodelet is unloaded and none of its callbacks runs any more.
        self.last_hooks: List[Callable[[], None]] = []
        self._lock = state_lock("context")
        self._strands = [self.strand]
        self._endpoints: List[Endpoint] = []
        self._timers: List[Timer] = []
        self._closables: List[Closable] = []

    def start(self) -> None:
        """Let callbacks run: those that came during ``on_init`` first."""
        with self._lock:
            strands = list(self._strands)
            self._held = False
        for strand in strands:
            strand.resume()

    _held = True

    def new_strand(self, what: str, at_once: bool = False) -> Strand:
        """Make a further strand, for what may overlap with the nodelet's other callbacks.

        Args:
            what: names it in the log.
            at_once: whether it runs during ``on_init`` too.
        """
        with self._lock:
            held = self._held and not at_once
            strand = Strand(self.executor, f"{self.name} ({what})", held, self.mark)
            if self.closed:
                strand.kill()
            self._strands.append(strand)
        return strand

    def drop_strand(self, strand: Strand) -> None:
        """End a strand that ``new_strand`` made; the nodelet's own stays."""
        if strand is self.strand:
            return
        strand.kill()
        with self._lock:
            if strand in self._strands:
                self._strands.remove(strand)

    def failed(self, what: str, error: BaseException) -> None:
        """Count and log what a callback raised; the nodelet lives on.

        The same error at the same place is logged once a second, with the number of those that
        were not: a callback that fails on every message must not fill the disk.
        """
        self.callback_errors += 1
        now = self.runtime.clock()
        place = (what, type(error), str(error))
        since, unlogged = self._failures.get(place, (now - _LOG_PAUSE, 0))
        if now - since < _LOG_PAUSE:
            self._failures[place] = (since, unlogged + 1)
            return
        if len(self._failures) > _LOG_PLACES:
            self._failures.clear()
        self._failures[place] = (now, 0)
        lines = traceback.format_exception(type(error), error, error.__traceback__)
        more = f" (and {unlogged} times more since)" if unlogged else ""
        _log.error("%s: the callback of %s raised%s\n%s", self.name, what, more, "".join(lines))

    def publication(
        self, what: str, datatype: Any, latch: bool, queue_size: Optional[int], **options: Any
    ) -> Publication:
        """Make a publication that this nodelet owns, not connected yet."""
        check_message_class(what, datatype)
        publication = Publication(
            datatype,
            latch,
            queue_size,
            self.runtime.transport.build,
            self.runtime.clock,
            lambda: self.runtime.node.closed(f"publisher '{what}' of {self.name}"),
            options,
            self.runtime.transport.age_of,
        )
        self._keep(publication)
        return publication

    def subscription(
        self,
        what: str,
        datatype: Any,
        callbacks: Sequence[Callback],
        queue_size: Optional[int],
        strand: Strand,
        **options: Any,
    ) -> Subscription:
        """Make a subscription that this nodelet owns, not connected yet."""
        check_message_class(what, datatype)
        subscription = Subscription(
            datatype,
            _no_callback,
            queue_size,
            strand,
            lambda error: self.failed(f"'{what}'", error),
            self.runtime.clock,
            options,
        )
        for callback in callbacks:
            self.add_callback(subscription, callback)
        self._keep(subscription)
        return subscription

    def add_callback(self, subscription: Subscription, callback: Callback) -> int:
        """Have a subscription call this back too; returns the number of the callback."""
        subscription.callbacks = (*subscription.callbacks, callback)
        function, args = callback
        alone = len(subscription.callbacks) == 1 and not args
        receive = function if alone else subscription.spread
        subscription.receive = self.runtime.transport.adapt(subscription.datatype, receive)
        return len(subscription.callbacks) - 1

    def timer(
        self, period: float, callback: Callable[[Any], None], strand: Strand, oneshot: bool
    ) -> Timer:
        """Start a timer that this nodelet owns; the period is in seconds."""
        timer = self.runtime.timers.add(
            period, callback, strand, oneshot, lambda error: self.failed("a timer", error)
        )
        with self._lock:
            ended = [each for each in self._timers if not each.is_alive()]
            self._timers = [each for each in self._timers if each.is_alive()]
            self._timers.append(timer)
            late = self.closed
        for each in ended:
            self.drop_strand(each.strand)
        if late:
            timer.shutdown()
        return timer

    def _keep(self, endpoint: Endpoint) -> None:
        endpoint.owner = self.name
        with self._lock:
            if self.closed:
                raise self.runtime.node.closed(f"nodelet {self.name}")
            self._endpoints.append(endpoint)

    def release(self, *endpoints: Endpoint) -> None:
        """Take endpoints of this nodelet off the bus for good."""
        with self._lock:
            self._endpoints = [each for each in self._endpoints if each not in endpoints]
        self._withdraw(endpoints)

    def _withdraw(self, endpoints: Sequence[Endpoint]) -> None:
        self.runtime.bus.release(endpoints)
        for endpoint in endpoints:
            endpoint.let_go()

    def close_with(self, closable: Closable) -> None:
        """Close this together with the nodelet."""
        with self._lock:
            late = self.closed
            if not late:
                self._closables.append(closable)
        if late:
            closable.close()

    def forget(self, closable: Closable) -> None:
        """Close it no more with the nodelet: it is closed already."""
        with self._lock:
            if closable in self._closables:
                self._closables.remove(closable)

    def attachment(self, kind: Callable[[Context], Part]) -> Part:
        """Return the part of the nodelet that lies above this layer, its proxy.

        The first call makes it from the context, and lets the host open what belongs to it.
        """
        with self._lock:
            part: Optional[Part] = self.attached
            is_new = part is None
            if part is None:
                part = self.attached = kind(self)
        if is_new:
            self.close_with(part)
            opened = self.on_attach(self, part)
            if opened is not None:
                self.close_with(opened)
        return part

    def callback_age(self) -> float:
        """Seconds that the callback has been running which began first; 0.0 if none runs."""
        with self._lock:
            strands = list(self._strands)
        running = ((strand.began, strand.clock()) for strand in strands)
        ages = [now - began for began, now in running if began > 0.0]
        if any(thread.is_alive() for thread in self.late_threads):
            ages.append(self.runtime.clock() - self.closed_at)
        return max(ages, default=0.0)

    def stop(self) -> None:
        """Drop what is queued and run no further callback; publishing is still possible."""
        with self._lock:
            strands = list(self._strands)
        for strand in strands:
            strand.kill(noted=True)

    def close(self) -> None:
        """Return everything; late publishes are refused from now on."""
        self.stop()
        with self._lock:
            self.closed, self.closed_at = True, self.runtime.clock()
            endpoints, self._endpoints = self._endpoints, []
            timers, self._timers = self._timers, []
            closables, self._closables = self._closables, []
        steps: List[Tuple[str, Callable[[], None]]] = [
            ("topics", lambda: self._withdraw(endpoints))
        ]
        steps += [("a timer", timer.shutdown) for timer in timers]
        steps += [("a registration", closable.close) for closable in reversed(closables)]
        for what, step in steps:
            try:
                step()
            except Exception:  # the boundary: one failure must not leave the rest behind
                _log.exception("%s: closing %s failed", self.name, what)
        self.shutdown_hooks.clear()
