# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Loads nodelets into this process and unloads them.

Who owns what: the loader owns a table of names; an entry owns one nodelet and its context. A name
is taken from the first moment of its load to the last of its unload. No lock is held while code
of a nodelet runs, so a slow ``on_init`` blocks neither ``list`` nor other loads.
"""

from __future__ import annotations

import enum
import logging
import threading
import time
import traceback
import weakref
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Type

from dyknow.errors import LoadFailed, NameTaken, UnknownNodelet, UnloadedMeanwhile
from dyknow.locks import state_condition
from dyknow.nodelet.context import Context, Runtime
from dyknow.nodelet.cycles import clear_frames
from dyknow.nodelet.leftovers import Leftovers
from dyknow.nodelet.middleware import Closable
from dyknow.nodelet.nodelet import Nodelet
from dyknow.periodic import in_background

#: Seconds that an unload waits for ``on_shutdown``.
SHUTDOWN_PATIENCE = 1.0
#: Seconds that a load waits for a nodelet of that name which is being unloaded.
_UNLOAD_PATIENCE = 3.0
#: Seconds that a nodelet has for itself when all are unloaded, before the next one's turn.
_HEAD_START = 0.05

_log = logging.getLogger("rosout.dyknow")


class _State(enum.Enum):
    LOADING = "being loaded"
    RUNNING = "already loaded"
    UNLOADING = "still being unloaded"


@dataclass(eq=False)
class _Entry:
    """One taken name."""

    context: Context
    state: _State = _State.LOADING
    nodelet: Optional[Nodelet] = None
    runs: List[_Run] = field(default_factory=list)

    def age(self) -> float:
        """Seconds for which code of the nodelet has been running; 0.0 if none runs."""
        runs = [time.monotonic() - run.began for run in self.runs if not run.done.is_set()]
        return max([self.context.callback_age(), *runs])


class _Run:
    """A call on a thread of its own, which the caller may stop waiting for."""

    def __init__(self, call: Callable[[], Any], name: str) -> None:
        self.began = time.monotonic()
        self.error: Optional[BaseException] = None
        self.done = threading.Event()
        self._call = call
        in_background(name, self._run)

    def _run(self) -> None:
        call, self._call = self._call, _nothing
        try:
            call()
        except BaseException as error:  # the boundary of the thread; the waiting one raises it
            clear_frames(error)
            trace = error.__traceback__
            # Without this frame, which refers to the error again.
            self.error = error.with_traceback(trace.tb_next if trace is not None else None)
            del trace
        finally:
            del call  # first: nobody who sees the end finds a reference to the nodelet here
            self.done.set()


def _nothing() -> None:
    """Do nothing."""


class Loader:
    """The nodelets of this process, by name."""

    def __init__(
        self,
        runtime: Runtime,
        find_class: Callable[[str, Context], Type[Nodelet]],
        on_attach: Callable[[Context, Any], Optional[Closable]] = lambda context, thing: None,
        on_unloaded: Callable[[str], None] = lambda name: None,
    ) -> None:
        """Make an empty loader.

        Args:
            runtime: what the nodelets share.
            find_class: imports the class of a declared type, for a nodelet.
            on_attach: opens what belongs to a nodelet's proxy.
            on_unloaded: called with the name after a running nodelet was unloaded.
        """
        self.runtime = runtime
        self._find_class = find_class
        self._on_attach = on_attach
        self._on_unloaded = on_unloaded
        self._changed = state_condition("loader")
        self._entries: Dict[str, _Entry] = {}
        #: Nodelets that were unloaded and are not gone yet.
        self.leftovers = Leftovers()

    def list(self) -> List[str]:
        """Names of the nodelets that run, sorted."""
        with self._changed:
            return sorted(
                name for name, entry in self._entries.items() if entry.state is _State.RUNNING
            )

    def contexts(self) -> List[Context]:
        """Contexts of the nodelets that run, sorted by name."""
        with self._changed:
            running = [each for each in self._entries.values() if each.state is _State.RUNNING]
        return sorted((each.context for each in running), key=lambda context: context.name)

    def get(self, name: str) -> Nodelet:
        """Return the running nodelet of that name.

        Raises:
            UnknownNodelet: none of that name runs.
        """
        with self._changed:
            entry = self._entries.get(name)
            if entry is not None and entry.state is _State.RUNNING and entry.nodelet is not None:
                return entry.nodelet
        raise UnknownNodelet(name, self.list())

    def load(
        self,
        name: str,
        type_name: str,
        remappings: Optional[Mapping[str, str]] = None,
        my_argv: Sequence[str] = (),
    ) -> Nodelet:
        """Make a nodelet and return it once its ``on_init`` has returned.

        One of that name that is being unloaded is waited for.

        Args:
            name: global name.
            type_name: declared type, ``package/Class``.
            remappings: table of global names.
            my_argv: arguments for the nodelet.

        Raises:
            NameTaken: the name is in use.
            UnknownNodeletType: no package declares the type.
            BrokenPlugin: the declared class cannot be used.
            LoadFailed: the nodelet raised; nothing of it is left.
            UnloadedMeanwhile: it was unloaded before it was up.
        """
        with self._changed:
            self._changed.wait_for(lambda: not self._is_ending(name), _UNLOAD_PATIENCE)
            if name in self._entries:
                raise NameTaken(name, self._entries[name].state.value)
            context = Context(self.runtime, name, remappings, my_argv)
            entry = self._entries[name] = _Entry(context)
        context.on_attach = self._on_attach
        context.unload = lambda: self._unload_self(name, entry)
        try:
            with self.runtime.executor.record.noting(context.mark):  # its import is its code too
                nodelet_class = self._find_class(type_name, context)
            if context.closed:
                raise UnloadedMeanwhile(name, "load")
            run = _Run(lambda: self._start(entry, nodelet_class), f"{name} on_init")
            entry.runs.append(run)
            context.close_with(_Signal(run.done))  # an unload ends the wait
            run.done.wait()
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

    def unload(self, name: str) -> None:
        """Unload a nodelet: when this returns nothing of it is registered and the name is free.

        Queued messages are dropped. A callback that runs is not waited for: its late publishes
        are refused. A nodelet that is still in its ``on_init`` can be unloaded too.

        Raises:
            UnknownNodelet: no nodelet of that name is loaded.
        """
        self._finish(self._begin(name, None))

    def close(self) -> None:
        """Unload everything, the newest first.

        Each has its time for ``on_shutdown``, but those that take long take it together.
        """
        with self._changed:
            loaded = list(self._entries)
        unloads = []
        for name in reversed(loaded):
            try:
                unload = self._begin(name, None, wanted=False)
            except UnknownNodelet:
                continue  # another unload was faster
            unload.wait(_HEAD_START)
            unloads.append(unload)
        for unload in unloads:
            self._finish(unload)
        self.leftovers.close()

    def _begin(self, name: str, only: Optional[_Entry], wanted: bool = True) -> _Unload:
        """Begin an unload: one that was asked for, or (not ``wanted``) the end of the process."""
        with self._changed:
            entry = self._entries.get(name)
            known = [each for each, one in self._entries.items() if one.state is _State.RUNNING]
            if entry is None or entry.state is _State.UNLOADING or only not in (None, entry):
                raise UnknownNodelet(name, known)
            was_running = entry.state is _State.RUNNING
            entry.state = _State.UNLOADING
        entry.context.stop()
        return _Unload(name, entry, self._shut_down(entry, wanted) if was_running else None)

    def _finish(self, unload: _Unload) -> None:
        name, context = unload.name, unload.entry.context
        if not unload.wait(SHUTDOWN_PATIENCE):
            _log.warning(
                "%s: on_shutdown has not returned after %g s; it is not waited for any longer",
                name,
                SHUTDOWN_PATIENCE,
            )
        was_running = unload.shutdown is not None
        if was_running and context.callback_age() > 0.0:
            _log.info("%s: unloaded while a callback runs; it is not waited for", name)
        context.close()
        self._free(name, unload.entry)
        if was_running:
            self._on_unloaded(name)

    @staticmethod
    def _start(entry: _Entry, nodelet_class: Type[Nodelet]) -> None:
        context = entry.context
        with context.runtime.executor.record.noting(context.mark):
            nodelet = entry.nodelet = nodelet_class()
            nodelet.bind(context)
            nodelet.on_init()

    def _free(self, name: str, entry: _Entry) -> None:
        """Give the name back, and the nodelet's memory."""
        with self._changed:
            if self._entries.get(name) is entry:
                del self._entries[name]
                self._changed.notify_all()
        if entry.nodelet is not None:
            nodelet, entry.nodelet = weakref.ref(entry.nodelet), None
            self.leftovers.add(name, nodelet, entry.age, entry.context.last_hooks)

    def _is_ending(self, name: str) -> bool:
        return name in self._entries and self._entries[name].state is _State.UNLOADING

    def _unload_self(self, name: str, entry: _Entry) -> None:
        # By its entry: another nodelet may have the name by now.
        try:
            self._finish(self._begin(name, entry))
        except UnknownNodelet:
            _log.info("%s: asked to be unloaded twice", name)

    @staticmethod
    def _shut_down(entry: _Entry, wanted: bool) -> _Run:
        context = entry.context
        assert entry.nodelet is not None
        hooks = [entry.nodelet.on_shutdown, *context.shutdown_hooks]

        def shut_down() -> None:
            with context.runtime.executor.record.noting(context.mark, unloading=wanted):
                while hooks:
                    try:
                        hooks.pop(0)()
                    except BaseException:  # the boundary: the other hooks and the unload go on
                        _log.error(
                            "%s: on_shutdown raised\n%s", context.name, traceback.format_exc()
                        )

        run = _Run(shut_down, f"{context.name} on_shutdown")
        entry.runs.append(run)
        return run


@dataclass
class _Unload:
    """An unload that has begun."""

    name: str
    entry: _Entry
    #: What ``on_shutdown`` is doing; None for a nodelet that did not run yet.
    shutdown: Optional[_Run]
    began: float = field(default_factory=time.monotonic)

    def wait(self, seconds: float) -> bool:
        """Wait for ``on_shutdown`` until so many seconds after it began."""
        left = max(0.0, self.began + seconds - time.monotonic())
        return self.shutdown is None or self.shutdown.done.wait(left)


class _Signal(Closable):
    """Sets an event when the context is closed."""

    def __init__(self, event: threading.Event) -> None:
        self._event = event

    def close(self) -> None:
        """Set the event."""
        self._event.set()
