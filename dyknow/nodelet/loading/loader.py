# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Loads nodelets into this process and unloads them.

Ownership: the loader owns a table of names; an entry owns one nodelet and its context. A name
is taken from the first moment of its load to the last of its unload. No lock is held while code
of a nodelet runs, so a slow ``on_init`` blocks neither ``list`` nor other loads.
"""

from __future__ import annotations

import builtins
import enum
import functools
import logging
import threading
import time
import traceback
import weakref
from dataclasses import dataclass, field
from typing import Any, Callable, Mapping, Sequence

from dyknow.errors import LoadFailed, NameTaken, UnknownNodelet, UnloadedMeanwhile
from dyknow.locks import state_condition
from dyknow.nodelet.context import Context, Runtime
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.loading.leftovers import Leftovers
from dyknow.nodelet.loading.memory import clear_frames
from dyknow.nodelet.middleware import Closable
from dyknow.periodic import NO_THREAD, in_background

SHUTDOWN_PATIENCE = 1.0  # seconds that an unload waits for ``on_shutdown``
#: Seconds that a load waits for a nodelet of that name which is being unloaded.
_UNLOAD_PATIENCE = 3.0
#: Seconds that a nodelet has for itself when all are unloaded, before the next one's turn.
_HEAD_START = 0.05

_log = logging.getLogger("rosout.dyknow")


class _State(enum.Enum):
    LOADING = "being loaded"
    RUNNING = "already loaded"
    UNLOADING = "still being unloaded"


class _Run(Closable):
    """Code of a nodelet on a thread of its own, which the caller may stop waiting for."""

    def __init__(
        self,
        call: Callable[[], Any],
        name: str,
        start: Callable[[str, Callable[[], object]], object] = in_background,
    ) -> None:
        self.error: BaseException | None = None
        self._began = time.monotonic()
        self._is_running = True
        self._over = threading.Event()
        start(name, functools.partial(self._run, [call]))

    @property
    def age(self) -> float:
        """Seconds for which it has been running; 0.0 once it has ended."""
        return time.monotonic() - self._began if self._is_running else 0.0

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until it ends or is closed, at most until so many seconds after it began."""
        left = None if seconds is None else max(0.0, self._began + seconds - time.monotonic())
        return self._over.wait(left)

    def close(self) -> None:
        self._over.set()

    def _run(self, calls: list[Callable[[], Any]]) -> None:
        call = calls.pop()
        try:
            call()
        except BaseException as error:  # the boundary of the thread; the waiting one raises it
            clear_frames(error)
            trace = error.__traceback__
            # Without this frame, which refers to the error again.
            self.error = error.with_traceback(trace.tb_next if trace is not None else None)
            del trace
        finally:
            del call  # first: after the end, no reference to the nodelet is left here
            self._is_running = False
            self._over.set()


@dataclass(eq=False)
class _Entry:
    """One taken name."""

    context: Context
    state: _State = _State.LOADING
    nodelet: Nodelet | None = None
    runs: list[_Run] = field(default_factory=list)
    shutdown: _Run | None = None  # runs ``on_shutdown``; None for a nodelet that never ran

    def age(self) -> float:
        """Seconds for which code of the nodelet has been running; 0.0 if none runs."""
        return max([self.context.callback_age(), *(run.age for run in self.runs)])


class Loader:
    """The nodelets of this process, by name."""

    def __init__(
        self,
        runtime: Runtime,
        find_class: Callable[[str, Context], type[Nodelet]],
        on_attach: Callable[[Context, Any], Closable | None] = lambda context, thing: None,
        on_unloaded: Callable[[Context], None] = lambda context: None,
    ) -> None:
        """Make an empty loader.

        ``find_class`` imports the class of a declared type, for a nodelet; ``on_attach`` opens the
        services of its proxy, and ``on_unloaded`` is called after a running one was unloaded,
        when another one may have its name.
        """
        self.runtime = runtime
        self._find_class = find_class
        self._on_attach = on_attach
        self._on_unloaded = on_unloaded
        self._changed = state_condition("loader")
        self._entries: dict[str, _Entry] = {}
        self.leftovers = Leftovers()  # nodelets that were unloaded and are not gone yet

    def list(self) -> builtins.list[str]:
        """Names of the running nodelets, sorted."""
        return [context.name for context in self.contexts()]

    def contexts(self) -> builtins.list[Context]:
        """Contexts of the running nodelets, sorted by name."""
        with self._changed:
            running = [each for each in self._entries.values() if each.state is _State.RUNNING]
        return sorted((each.context for each in running), key=lambda context: context.name)

    def find(self, name: str) -> Context | None:
        """Return the context of a running nodelet; None if none has the name."""
        with self._changed:
            entry = self._entries.get(name)
        return entry.context if entry is not None and entry.state is _State.RUNNING else None

    def known(self, name: str) -> Context | None:
        """Return the context of a nodelet that starts, runs or ends; None if there is none."""
        with self._changed:
            entry = self._entries.get(name)
        return entry.context if entry is not None else None

    def get(self, name: str) -> Nodelet:
        """Return the running nodelet of that name, or raise UnknownNodelet."""
        with self._changed:
            entry = self._entries.get(name)
            if entry is not None and entry.state is _State.RUNNING and entry.nodelet is not None:
                return entry.nodelet
        raise UnknownNodelet(name, self.list())

    def load(
        self,
        name: str,
        type_name: str,
        remappings: Mapping[str, str] | None = None,
        my_argv: Sequence[str] = (),
    ) -> Nodelet:
        """Make a nodelet of a declared type and return it once its ``on_init`` has returned.

        All names are global. One of that name that is being unloaded is waited for.

        Raises:
            NameTaken: the name is in use.
            UnknownNodeletType: no package declares the type.
            BrokenPlugin: the declared class cannot be used.
            LoadFailed: the nodelet raised; nothing of it is left.
            UnloadedMeanwhile: it was unloaded before it was up.
        """

        def is_ending() -> bool:
            return name in self._entries and self._entries[name].state is _State.UNLOADING

        with self._changed:
            self._changed.wait_for(lambda: not is_ending(), _UNLOAD_PATIENCE)
            if name in self._entries:
                raise NameTaken(name, self._entries[name].state.value)
            context = Context(self.runtime, name, remappings, my_argv)
            entry = self._entries[name] = _Entry(context)
        context.on_attach = self._on_attach
        context.unload = lambda: self._unload_self(context)
        try:
            with self.runtime.executor.record.noting(context.mark):  # its import is its code too
                nodelet_class = self._find_class(type_name, context)
            if context.closed:
                raise UnloadedMeanwhile(name, "load")
            run = _Run(lambda: self._start(entry, nodelet_class), f"{name} on_init")
            entry.runs.append(run)
            context.close_with(run)  # an unload ends the wait
            run.wait()
            error, run.error = run.error, None
            if error is not None and not context.closed:
                raise LoadFailed(name, type_name, error) from error
            with self._changed:
                nodelet = entry.nodelet
                if entry.state is not _State.LOADING or nodelet is None:
                    raise UnloadedMeanwhile(name, "load")
                entry.state = _State.RUNNING
            context.start()
            return nodelet
        except UnloadedMeanwhile:
            raise
        except BaseException:
            context.close()
            self._free(name, entry)
            raise

    def unload(self, name: str, only: Context | None = None) -> None:
        """Unload a nodelet: when this returns nothing of it is registered and the name is free.

        Queued messages are dropped. A running callback is not waited for: its late publishes
        are refused. A nodelet that is still in its ``on_init`` can be unloaded too.

        Raises:
            UnknownNodelet: no nodelet of that name is loaded, or not the ``only`` one meant.
        """
        self._finish(name, self._shut_down(name, only))

    def close(self) -> None:
        """Unload everything, the newest first.

        Each has its time for ``on_shutdown``, but those that take long take it together.
        """
        with self._changed:
            loaded = list(self._entries)
        entries = {}
        for name in reversed(loaded):
            try:
                entry = entries[name] = self._shut_down(name, None, wanted=False)
            except UnknownNodelet:
                continue  # another unload was faster
            if entry.shutdown is not None:
                entry.shutdown.wait(_HEAD_START)
        for name, entry in entries.items():
            self._finish(name, entry)
        self.leftovers.close()

    def _shut_down(self, name: str, only: Context | None, wanted: bool = True) -> _Entry:
        """Stop callbacks, call ``on_shutdown``: for an unload or (not ``wanted``) at the end."""
        with self._changed:
            entry = self._entries.get(name)
            known = [each for each, one in self._entries.items() if one.state is _State.RUNNING]
            is_meant = entry is not None and only in (None, entry.context)
            if entry is None or entry.state is _State.UNLOADING or not is_meant:
                raise UnknownNodelet(name, known)
            was_running = entry.state is _State.RUNNING
            entry.state = _State.UNLOADING
        entry.context.stop()
        if was_running and entry.nodelet is not None:
            hooks = [entry.nodelet.on_shutdown, *entry.context.shutdown_hooks]
            call = functools.partial(self._call_hooks, entry.context, hooks, wanted)
            try:
                entry.shutdown = _Run(call, f"{name} on_shutdown")
            except NO_THREAD as error:
                _log.warning("%s: the unload itself calls on_shutdown: %s", name, error)
                entry.shutdown = _Run(call, f"{name} on_shutdown", lambda _, run: run())
            entry.runs.append(entry.shutdown)
        return entry

    def _finish(self, name: str, entry: _Entry) -> None:
        context, shutdown = entry.context, entry.shutdown
        if shutdown is not None and not shutdown.wait(SHUTDOWN_PATIENCE):
            _log.warning(
                "%s: on_shutdown has not returned after %g s; it is not waited for any longer",
                name,
                SHUTDOWN_PATIENCE,
            )
        if shutdown is not None and context.callback_age() > 0.0:
            _log.info("%s: unloaded while a callback runs; it is not waited for", name)
        context.close()
        self._free(name, entry)
        if shutdown is not None:
            self._on_unloaded(context)

    @staticmethod
    def _start(entry: _Entry, nodelet_class: type[Nodelet]) -> None:
        context = entry.context
        with context.runtime.executor.record.noting(context.mark):
            nodelet = entry.nodelet = nodelet_class()
            nodelet.bind(context)
            nodelet.on_init()

    @staticmethod
    def _call_hooks(
        context: Context, hooks: builtins.list[Callable[[], None]], wanted: bool
    ) -> None:
        with context.runtime.executor.record.noting(context.mark, unloading=wanted):
            while hooks:
                try:
                    hooks.pop(0)()
                except BaseException:  # the boundary: the other hooks and the unload go on
                    trace = traceback.format_exc()
                    _log.error("%s: on_shutdown raised\n%s", context.name, trace)

    def _free(self, name: str, entry: _Entry) -> None:
        """Free the name, and the nodelet's memory."""
        with self._changed:
            if self._entries.get(name) is entry:
                del self._entries[name]
                self._changed.notify_all()
        if entry.nodelet is not None:
            nodelet, entry.nodelet = weakref.ref(entry.nodelet), None
            self.leftovers.add(name, nodelet, entry.age, entry.context.last_hooks)

    def _unload_self(self, context: Context) -> None:
        try:
            self.unload(context.name, context)  # another nodelet may have the name by now
        except UnknownNodelet:
            _log.info("%s: a second request to unload it", context.name)
