# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The possessions of one nodelet in the runtime, which its unload returns.

Ownership: there is one ``Runtime`` for the process; a ``Context`` is one for a nodelet and
owns its strands, endpoints, services and timers. Handles only refer to it.
"""

from __future__ import annotations

import functools
import logging
import math
import threading
import traceback
from typing import Any, Callable, Mapping, Sequence, TypeVar

from dyknow import names
from dyknow.errors import BadQueueSize, NoMessageClass, described
from dyknow.guards import NO_GUARDS, Guards
from dyknow.locks import state_lock
from dyknow.nodelet.middleware import Closable, Codec, Middleware, Receive
from dyknow.nodelet.scheduler import Executor, Strand
from dyknow.nodelet.streams.bus import Bus, Endpoint
from dyknow.nodelet.streams.endpoints import Publication, Subscription
from dyknow.nodelet.texts import encodable, sendable
from dyknow.nodelet.timers import Timer, TimerQueue

_LOG_PAUSE = 1.0  # seconds between two log entries of errors of one type at the same place
_RECENT = 30.0  # seconds for which the last error of a callback is reported
_LOG_PLACES = 100  # errors that are counted apart; with one more the counts start again

Part = TypeVar("Part", bound=Closable)

_log = logging.getLogger("rosout.dyknow")


def check_message_class(what: str, datatype: Any) -> None:
    """Raise NoMessageClass unless ``datatype`` is a class of messages."""
    if not isinstance(datatype, type) or not hasattr(datatype, "_md5sum"):
        raise NoMessageClass(what, datatype)


def _bound(what: str, queue_size: Any) -> int | None:
    """Return the bound of a queue as a whole number; rospy takes 10.0 and -1 (for none) too."""
    try:
        return None if queue_size is None else max(0, math.ceil(queue_size))
    except (TypeError, ValueError, OverflowError):
        raise BadQueueSize(what, queue_size) from None


def _origin(error: BaseException) -> tuple[str, int]:
    """Return the file and line in which an error was raised."""
    place = "", 0
    for frame, line in traceback.walk_tb(error.__traceback__):
        place = frame.f_code.co_filename, line
    return place


class Runtime:
    """The parts of the process that all nodelets share."""

    def __init__(
        self,
        middleware: Middleware,
        executor: Executor,
        guards: Callable[[], Guards] = lambda: NO_GUARDS,
        blocking: Executor | None = None,
        bound: bool = True,
    ) -> None:
        """Put a runtime together, with the clock of its ``executor``.

        Callbacks that may block for long run on ``blocking``, by default the same. The ``guards``
        currently in force bind ``set_config`` and, if ``bound``, every endpoint.
        """
        self.node = middleware.node
        self.services = middleware.services
        self.transport = middleware.transport
        self.executor = executor
        self.blocking = blocking or executor
        self.guards = guards
        self.clock = executor.clock
        check = (lambda topic: guards().check_topic(topic)) if bound else None
        self.bus = Bus(self.transport, self.clock, check)
        self.timers = TimerQueue(middleware.ticker)

    def catch_up(self) -> None:
        """Start callbacks that wait for a thread which the system refused."""
        for executor in {self.executor, self.blocking}:
            executor.catch_up()

    def close(self) -> None:
        """End the threads."""
        self.timers.close()
        self.executor.close()
        self.blocking.close()


class Context:
    """One nodelet's share of the runtime; its callbacks wait until ``start``."""

    def __init__(
        self,
        runtime: Runtime,
        name: str,
        remappings: Mapping[str, str] | None = None,
        my_argv: Sequence[str] = (),
    ) -> None:
        self.runtime = runtime
        self.executor = runtime.executor  # runs the strands that are made from now on
        self.name = name
        self.remappings = dict(remappings or {})
        self.my_argv = tuple(my_argv)
        self.mark = names.mark(name)
        self.strand = Strand(runtime.executor, name, held=True, mark=self.mark)
        self.callback_errors = 0
        self._last_error: tuple[float, str] | None = None
        self.closed = False
        #: Whether it is being given to another process, so that nothing is to be connected here.
        self.is_leaving = False
        self.closed_at = 0.0
        #: Threads of its own that have not ended at the unload.
        self.late_threads: list[threading.Thread] = []
        self.started_at = runtime.clock()
        self.unload: Callable[[], None] = self.close  # set by the host: unloads this nodelet
        #: Set by the host: opens services for the attachment.
        self.on_attach: Callable[[Context, Any], Closable | None] = lambda context, thing: None
        self.attached: Any = None
        self.shutdown_hooks: list[Callable[[], None]] = []
        #: Called when the nodelet is unloaded and none of its callbacks runs any more.
        self.last_hooks: list[Callable[[], None]] = []
        #: By place: when it was last logged, and how many were not logged since.
        self._failures: dict[tuple[str, type, tuple[str, int]], tuple[float, int]] = {}
        self._lock = state_lock("context")
        self._held = True
        self._strands = [self.strand]
        self._endpoints: list[Endpoint] = []
        self._timers: list[Timer] = []
        #: Seconds in callbacks of timers, of services, and of subscriptions that have ended.
        self._spent = 0.0
        self._closables: list[Closable] = []

    def start(self) -> None:
        """Let callbacks run: those that came during ``on_init`` first."""
        with self._lock:
            strands = list(self._strands)
            self._held = False
        for strand in strands:
            strand.resume()

    def new_strand(self, what: str, at_once: bool = False) -> Strand:
        """Make a further strand, for callbacks that may overlap with the nodelet's other ones.

        ``what`` names it in the log; it runs ``at_once``, or after ``on_init``.
        """
        with self._lock:
            held = self._held and not at_once
            strand = Strand(self.executor, f"{self.name} ({what})", held, self.mark)
            if self.closed:
                strand.kill()
            self._strands.append(strand)
        return strand

    def drop_strand(self, strand: Strand) -> None:
        """End a strand that ``new_strand`` made; the nodelet's own stays.

        It counts until its running callback has returned.
        """
        if strand is self.strand:
            return
        strand.kill()
        with self._lock:
            self._strands = [
                each for each in self._strands if each is self.strand or each.alive or each.busy
            ]

    def note_error(self, text: str, now: float) -> None:
        """Count an error of a callback."""
        self.callback_errors += 1
        self._last_error = now, sendable(text)

    def recent_error(self) -> str:
        """Return the last error of a callback, unless it was long ago; empty for none."""
        when, text = self._last_error or (-math.inf, "")
        return text if self.runtime.clock() - when < _RECENT else ""

    def failed(self, what: str, error: BaseException) -> None:
        """Count and log an error of a callback; the nodelet lives on.

        Errors of one type and line are logged once a second, with the number of repetitions: a
        callback that fails on every message must not fill the disk, whatever differs in the texts.
        """
        now = self.runtime.clock()
        self.note_error(f"{what}: {described(error)}", now)
        place = (what, type(error), _origin(error))
        since, unlogged = self._failures.get(place, (now - _LOG_PAUSE, 0))
        if now - since < _LOG_PAUSE:
            self._failures[place] = (since, unlogged + 1)
            return
        if len(self._failures) > _LOG_PLACES:
            self._failures.clear()
        self._failures[place] = (now, 0)
        lines = traceback.format_exception(type(error), error, error.__traceback__)
        more = f" (and {unlogged} times more since)" if unlogged else ""
        text = encodable("".join(lines))
        by = {"nodelet": self.name}
        _log.error("%s: the callback of %s raised%s\n%s", self.name, what, more, text, extra=by)

    def publication(
        self, what: str, datatype: Any, latch: bool, queue_size: int | None, **options: Any
    ) -> Publication:
        """Make a publication that this nodelet owns, not connected yet."""
        check_message_class(what, datatype)
        runtime = self.runtime
        publication = Publication(
            datatype,
            latch,
            _bound(what, queue_size),
            runtime.transport,
            runtime.clock,
            lambda: runtime.node.closed(f"publisher '{what}' of {self.name}"),
            options,
            self.name,
        )
        self._keep(publication)
        return publication

    def subscription(
        self,
        what: str,
        datatype: Any,
        queue_size: int | None,
        strand: Strand,
        codec: Codec | None = None,
        **options: Any,
    ) -> Subscription:
        """Make a subscription that this nodelet owns, without callbacks and not connected yet.

        With a ``codec`` the messages on its topic are encoded, and ``datatype`` is that of the
        decoded ones, which callbacks get.
        """
        failed = functools.partial(self.failed, f"'{what}'")
        adapt: Callable[[Receive], Receive] = functools.partial(
            self.runtime.transport.adapt, datatype
        )
        if codec is not None:
            adapt, datatype = codec.decoding, codec.datatype
        subscription = Subscription(
            datatype, _bound(what, queue_size), strand, failed, options, self.name, adapt
        )
        self._keep(subscription)
        return subscription

    def timer(
        self, period: float, callback: Callable[[Any], None], strand: Strand, oneshot: bool
    ) -> Timer:
        """Start a timer that this nodelet owns; the period is in seconds."""
        queue = self.runtime.timers
        failed = functools.partial(self.failed, "a timer")
        timer = Timer(queue, period, callback, strand, oneshot, failed, self.spend)
        queue.add(timer)
        with self._lock:
            ended = [each for each in self._timers if not each.is_alive()]
            self._timers = [*(each for each in self._timers if each.is_alive()), timer]
            late = self.closed
        for each in ended:
            self.drop_strand(each.strand)
        if late:
            timer.shutdown()
        return timer

    def _keep(self, endpoint: Endpoint) -> None:
        with self._lock:
            if self.closed:
                raise self.runtime.node.closed(f"nodelet {self.name}")
            self._endpoints.append(endpoint)

    def release(self, *endpoints: Endpoint) -> None:
        """Take endpoints of this nodelet off the bus for good."""
        with self._lock:
            ended = [each for each in self._endpoints if each in endpoints]
            self._spent += sum(each.traffic.settle() for each in ended)
            self._endpoints = [each for each in self._endpoints if each not in endpoints]
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
        """Undo ``close_with``: it is closed already."""
        with self._lock:
            if closable in self._closables:
                self._closables.remove(closable)

    def attachment(self, kind: Callable[[Context], Part]) -> Part:
        """Return the part of the nodelet that lies above this layer, its proxy.

        The first call makes it from the context, and lets the host open its services.
        """
        with self._lock:
            part: Part | None = self.attached
            is_new = part is None
            if part is None:
                part = self.attached = kind(self)
        if is_new:
            self.close_with(part)
            opened = self.on_attach(self, part)
            if opened is not None:
                self.close_with(opened)
        return part

    def endpoints(self) -> list[Endpoint]:
        """Return its publications and subscriptions, of ports and of plain handles."""
        with self._lock:
            return list(self._endpoints)

    def is_busy(self) -> bool:
        """Whether a callback of it runs or is queued."""
        with self._lock:
            return any(strand.busy for strand in self._strands)

    def spend(self, seconds: float) -> None:
        """Count the time that a callback of a timer or service took."""
        with self._lock:
            self._spent += seconds

    def busy(self, with_running: bool = False) -> float:
        """Seconds that its callbacks have taken so far; on request with those that still run."""
        with self._lock:
            ended = self._spent + sum(each.traffic.unsettled for each in self._endpoints)
            return ended + (sum(each.age for each in self._strands) if with_running else 0.0)

    def callback_age(self) -> float:
        """Seconds for which the oldest running callback has been running; 0.0 if none runs."""
        with self._lock:
            ages = [strand.age for strand in self._strands]
        if any(thread.is_alive() for thread in self.late_threads):
            ages.append(self.runtime.clock() - self.closed_at)
        return max(ages, default=0.0)

    def stop(self) -> None:
        """Drop the queued callbacks and run no further one; publishing is still possible."""
        with self._lock:
            strands = list(self._strands)
        for strand in strands:
            strand.kill(log_end=True)

    def close(self) -> None:
        """Return everything; late publishes are refused from now on."""
        self.stop()
        with self._lock:
            self.closed, self.closed_at = True, self.runtime.clock()
            endpoints = list(self._endpoints)
            timers, self._timers = self._timers, []
            closables, self._closables = self._closables, []
        steps: list[Callable[[], None]] = [lambda: self.release(*endpoints)]
        steps += [timer.shutdown for timer in timers]
        steps += [closable.close for closable in reversed(closables)]
        for step in steps:
            try:
                step()
            except Exception:  # the boundary: one failure must not leave the rest behind
                _log.exception("%s: a step of its unload failed", self.name)
        self.shutdown_hooks.clear()
