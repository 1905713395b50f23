# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps the window's snapshot of the computation graph up to date, and makes its changes.

``GraphMonitor`` owns the remote side and the calls in the background. Its state changes in the
thread of the window only; everything that may block is called in the background.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from dataclasses import replace
from typing import Any, Callable, FrozenSet, Sequence, Tuple, TypeVar

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.errors import DyKnowError, Refused
from dyknow.formulas import Verdict
from dyknow.manager.steps import CannotUndo
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import Model, PortRef, State
from dyknow.model.statistics import NodeletCount
from dyknow.model.streams import ClaimState, StreamStatus
from dyknow.model.transformation import Transformation
from dyknow_rqt.background_calls import BackgroundCalls
from dyknow_rqt.graph.changes import Change, DoneChange, Present, UndoHistory
from dyknow_rqt.graph.measurements import (
    Meter,
    PortRate,
    PortVerdict,
    Strain,
    port_verdicts,
    verdict_sources,
)
from dyknow_rqt.graph.snapshot import PlainNode, Side, Snapshot, plain_nodes, taken_topics
from dyknow_rqt.monitoring.heartbeat import Heartbeat
from dyknow_rqt.monitoring.remote import Remote

T = TypeVar("T")

#: Milliseconds from look to look.
_PERIOD = 1000
#: Milliseconds for which verdicts are gathered before they are shown.
_GATHERING = 100
#: The master's state is queried at most in one of so many parts of the time.
_SELDOM = 20


#: Findings of a look: the link to the manager when it began, the model, ordinary nodes, the topics
#: that are taken.
_Look = Tuple[int, Model, Tuple[PlainNode, ...], FrozenSet[str]]


class GraphMonitor(QObject):
    """Reads the graph after each change, and periodically."""

    #: The graph has changed: a ``Snapshot``.
    changed = Signal(object)
    #: The library has changed: transformations by label.
    library_changed = Signal(object)
    #: Rates have been measured: ``PortRate`` by ``PortRef``.
    measured = Signal(object)
    #: Verdicts have changed: ``PortVerdict`` by ``PortRef``.
    decided = Signal(object)
    #: Something has become of a stream: a ``StreamEvent``.
    stream_event = Signal(object)
    #: The list of streams has changed.
    streams_changed = Signal()
    #: An error, in words.
    failed = Signal(str)
    #: A change is being made, or waits, in words.
    begun = Signal(str)
    #: A change was made, in words.
    done = Signal(str)
    #: A change has succeeded or failed.
    settled = Signal()
    #: What undo and redo would do now.
    history_changed = Signal(str, str)

    def __init__(self, remote: Remote) -> None:
        super().__init__()
        self.remote = remote
        self._client = remote.client
        self.snapshot = Snapshot()
        self.library: dict[str, Transformation] = {}
        self.streams: tuple[StreamStatus, ...] = ()
        self.heart = Heartbeat(remote)
        self.heart.linked.connect(self._follow_link)
        self.heart.listed.connect(self._take_streams)
        for signal in (self.stream_event, self.settled):
            signal.connect(self.heart.list_streams)
        self.history = UndoHistory()
        #: The address of the manager, the one of whose nodelets these are, with transformations;
        #: whether the next model may be another manager's.
        self._address = self._maker = ""
        self._made: set[tuple[str, str]] = set()
        self._is_another = False
        #: How often the manager, or another one, has begun to answer.
        self._link = 0
        self._calls = BackgroundCalls()
        self._meter = Meter()
        self._revision = -1
        self._library_revision = -1
        self._changing = False
        self._waiting: deque[Callable[[], None]] = deque()
        self._system: tuple[Side, Side] = ((), ())
        self._system_due = 0.0
        self._timer = QTimer(self, interval=_PERIOD, timeout=self.look)
        self._heard: Model | None = None
        self._drawing = QTimer(self, interval=0, singleShot=True, timeout=self._take_heard)
        #: The last verdicts by topic, None before the first one.
        self._verdicts: dict[str, Verdict | None] = {}
        self._gathering = QTimer(
            self, interval=_GATHERING, singleShot=True, timeout=self._tell_verdicts
        )

    def start(self) -> None:
        remote = self.remote
        remote.on_model, remote.on_verdict = self._hear_model, self._hear_verdict
        remote.on_counts = self._hear_counts
        remote.on_event = lambda event: self._calls.deliver(lambda: self.stream_event.emit(event))
        remote.start()
        self.heart.start()
        self._timer.start()
        self.look()

    def close(self) -> None:
        """Stop; returns at once."""
        self._timer.stop()
        self._drawing.stop()
        self._gathering.stop()
        self.heart.close()
        self._calls.close()
        self.remote.close()

    @property
    def is_linked(self) -> bool:
        return self.heart.status.is_current

    @property
    def traffic(self) -> dict[PortRef, PortRate]:
        """The traffic of ports, as it was measured last."""
        return dict(self._meter.traffic)

    @property
    def strains(self) -> dict[str, Strain]:
        """The loads that make nodelets stand out, by name."""
        return dict(self._meter.strains)

    @property
    def verdicts(self) -> dict[PortRef, PortVerdict]:
        """The last verdicts, by the out-ports that they came from."""
        return port_verdicts(self.snapshot.nodelets, self._verdicts, self.streams)

    @property
    def is_changing(self) -> bool:
        """Whether a change is under way, or waits for that or for the graph to be read."""
        return self._changing or bool(self._waiting)

    def stream(self, claim_id: str) -> StreamStatus | None:
        return next((each for each in self.streams if each.claim_id == claim_id), None)

    def look(self) -> None:
        """Read everything now, unless that is under way."""
        self._calls.run_once("the graph", lambda: self._looked(self.remote.graph), self._take_look)

    def read_library(self) -> None:
        link = self._link
        self._calls.run_once(
            "the library", self._client.get_model, lambda model: self._take_library(model, link)
        )

    def ask(
        self,
        question: Callable[[BaseManagerClient], T],
        then: Callable[[T], None],
        failed: Callable[[str], None] | None = None,
    ) -> None:
        """Ask the remote side in the background, and take the answer in the thread of the window.

        There ``failed`` takes the error in words; by default it is reported.
        """
        say = failed or self.failed.emit
        if self.is_linked:
            self._calls.run(lambda: question(self._client), then, lambda error: say(_words(error)))
        else:
            say(self.heart.status.text)  # the threads are not to wait for it

    def do(
        self,
        change: Change | Callable[[Snapshot], Change],
        then: Callable[[], None] = lambda: None,
    ) -> None:
        """Make a change after those before it; it can be undone if there is a way back.

        One that depends on the graph is a function of it: it is called now, to refuse at once,
        and again when the change begins. ``then`` is called in the thread of the window when the
        change has been done.
        """
        plan = change if callable(change) else lambda snapshot: change

        def note(done: DoneChange) -> None:
            self.history.note(done)
            then()

        def begin() -> None:
            present = self._present()
            planned = plan(present.snapshot)
            self._apply(planned.text, lambda: planned.apply(present), note)

        self._in_turn(plan(self.snapshot).text, begin)

    def do_in_turn(self, changes: Sequence[Change]) -> None:
        """Make changes one after the other, up to the first that is refused."""
        if changes:
            self.do(changes[0], lambda: self.do_in_turn(changes[1:]))

    def undo(self) -> None:
        self._in_turn("undo", self._undo)

    def redo(self) -> None:
        self._in_turn("redo", self._redo)

    # Inside

    def _undo(self) -> None:
        done = self.history.last
        if done is None:
            raise CannotUndo("there is nothing to undo")
        text = f"undo '{done.change.text}'"

        def undo() -> DoneChange:
            done.undo()
            return done._replace(text=text)

        self._apply(text, undo, lambda done: self.history.note_undone(), self.history.drop)

    def _redo(self) -> None:
        change, present = self.history.next, self._present()
        if change is None:
            raise CannotUndo("there is nothing to redo")
        again = change

        def redo() -> DoneChange:
            again.check(self._client)
            return again.apply(present)

        self._apply(again.text, redo, self.history.note_redone)

    def _in_turn(self, text: str, begin: Callable[[], None]) -> None:
        """Begin a change as soon as it can begin from the graph that it is to change."""
        if self._must_wait:
            self._waiting.append(begin)
            awaited = "the change before it" if self._changing else "the graph to be read"
            self.begun.emit(f"{text}: waiting for {awaited} …")
        else:
            begin()

    @property
    def _must_wait(self) -> bool:
        """Whether another change is under way, or the graph is read from the beginning."""
        return self.is_linked and (self._changing or self._is_another)

    def _go_on(self) -> None:
        while self._waiting and not self._must_wait:
            try:
                self._waiting.popleft()()
            except DyKnowError as error:  # that holds up nothing
                self.failed.emit(str(error))
                self.settled.emit()

    def _present(self) -> Present:
        return Present(self._client, self.snapshot, dict(self.library))

    def _apply(
        self,
        text: str,
        job: Callable[[], DoneChange],
        note: Callable[[DoneChange], None],
        no_way: Callable[[], None] = lambda: None,
    ) -> None:
        """Make a change, if the manager answers; the next begins from the graph that it leaves.

        ``no_way`` is called if it was refused, but not if nothing answered.
        """

        def work() -> tuple[DoneChange, _Look | None]:
            done = job()
            try:
                return done, self._looked(self._whole_graph)
            except DyKnowError:
                return done, None

        if not self.is_linked:
            self.failed.emit(f"{text}: {self.heart.status.text}")
            self.settled.emit()
            return
        self._changing = True
        self.begun.emit(f"{text} …")

        def settle(signal: Any, words: str) -> None:
            self._tell_history()
            signal.emit(words)
            self.settled.emit()
            self.look()
            self._go_on()

        def made(result: tuple[DoneChange, _Look | None]) -> None:
            done, look = result
            self._is_another = False  # it has made the change that was sent before its link
            if look is not None:
                self._take_look(look)
            self._changing = False  # first: the next change may begin at once
            note(done)
            settle(self.done, f"done: {done.text}")

        def refused(error: Exception) -> None:
            self._changing = False
            if isinstance(error, (CannotUndo, Refused)):
                no_way()
            what = f"cannot {text}" if isinstance(error, CannotUndo) else text
            settle(self.failed, f"{what}: {_words(error)}")

        self._calls.run(work, made, refused)

    def _tell_history(self) -> None:
        self.history_changed.emit(*self.history.texts)

    def _whole_graph(self) -> Model:
        """Read the graph, with the library if that has changed; in the background."""
        model = self._client.get_graph()
        is_known = model.library_revision == self._library_revision
        return model if is_known or model.transformations else self._client.get_model()

    def _looked(self, read: Callable[[], Model]) -> _Look:
        """Read everything for a look; in the background."""
        link = self._link
        if self._is_another:
            with contextlib.suppress(DyKnowError):  # without a master it is the same one
                self._address = self.remote.find_manager()
        model = read()
        model = replace(model, nodelets=self.snapshot.shared(model.nodelets))
        topics = {port.topic for each in model.nodelets for port in each.ports if port.topic}
        hosts = {each.node for each in model.nodelets}
        nodes, taken = self.snapshot.nodes, self.snapshot.taken
        try:
            publishers, subscribers = self._system_state()
            nodes = plain_nodes(publishers, subscribers, topics, hosts)
            taken = taken_topics(publishers, model.nodelets, hosts)
        except (DyKnowError, LookupError):
            pass  # the master's last state is shown
        return link, model, nodes, taken

    def _system_state(self) -> tuple[Side, Side]:
        """Ask the master, unless its answers took a large part of the time; in the background."""
        start = time.monotonic()
        if start >= self._system_due:
            self._system = self.remote.system_state()
            end = time.monotonic()
            self._system_due = end + _SELDOM * (end - start)
        return self._system

    def _take_look(self, look: _Look) -> None:
        link, model, nodes, taken = look
        if link != self._link:
            self.look()  # at once: changes before it count as another manager's
        elif model.revision >= self._revision:
            if self._heard is not None and self._heard.revision <= model.revision:
                self._heard = None  # an older model
            self._take_model(model, nodes, taken)

    def _hear_model(self, model: Model) -> None:
        """Take a model that the manager publishes; in any thread."""
        self.heart.contact.hear_manager()
        shared = replace(model, nodelets=self.snapshot.shared(model.nodelets))
        self._calls.deliver(lambda: self._hear(shared))

    def _hear(self, model: Model) -> None:
        """Delay a model until the one before it has been drawn, and for the same time again."""
        # Else a look has brought a newer one, or is to say whose models come over a new link.
        if model.revision >= self._revision and not self._is_another:
            self._heard = model
            if not self._drawing.isActive():
                self._drawing.start()

    def _take_heard(self) -> None:
        model, self._heard = self._heard, None
        if model is None:
            return
        start = time.monotonic()
        self._take_model(model, self.snapshot.nodes, self.snapshot.taken)
        self._drawing.setInterval(min(1000, int((time.monotonic() - start) * 2000)))

    def _take_model(
        self, model: Model, nodes: tuple[PlainNode, ...], taken: frozenset[str]
    ) -> None:
        self._revision = model.revision
        made = {(each.name, each.transformation) for each in model.nodelets}
        if not (self._is_another and self._changing):  # else the change may make the difference
            if self._is_another and self._address != self._maker and made != self._made:
                self.history = UndoHistory()
                self._tell_history()
            self._made, self._maker, self._is_another = made, self._address, False
        if model.transformations:
            self._take_library(model, self._link)
        self._take_snapshot(Snapshot(model.nodelets, nodes, taken, self.snapshot.pending))
        if model.library_revision != self._library_revision:
            self.read_library()
        self._go_on()

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        if snapshot != self.snapshot:
            self.snapshot = snapshot
            self.changed.emit(snapshot)
            self._calls.deliver(self._tell_rates)
            self._calls.deliver(self._follow_verdicts)

    def _take_library(self, model: Model, link: int) -> None:
        """Take the library that was read over a link, unless a newer one has come since."""
        if link != self._link or model.library_revision < self._library_revision:
            return
        self._library_revision = model.library_revision
        library = {each.label: each for each in model.transformations}
        if library != self.library:
            self.library = library
            self.library_changed.emit(library)

    def _hear_counts(self, counts: Sequence[NodeletCount]) -> None:
        """Take the counts that the manager publishes; in any thread."""
        self.heart.contact.hear_manager()
        moment = time.monotonic()
        self._calls.deliver(lambda: self._take_counts(counts, moment))

    def _take_counts(self, counts: Sequence[NodeletCount], moment: float) -> None:
        self._meter.take(counts, moment)
        self.measured.emit(self.traffic)

    def _tell_rates(self) -> None:
        """Tell the rates of connected ports of nodelets that run, if the manager answers."""
        nodelets = self.snapshot.nodelets if self.is_linked else ()
        running = [each for each in nodelets if each.state is State.RUNNING]
        ports = ((each.name, port) for each in running for port in each.ports if port.topic)
        self._meter.keep({PortRef(name, port.name): port.topic for name, port in ports})
        self.measured.emit(self.traffic)

    def _follow_verdicts(self) -> None:
        sources = verdict_sources(self.snapshot.nodelets)
        self._verdicts = {topic: self._verdicts.get(topic) for _, topic in sources}
        self.remote.follow_verdicts(sources)
        self._tell_verdicts()

    def _hear_verdict(self, topic: str, verdict: Verdict) -> None:
        """Take a verdict; in any thread, several times a second."""
        self._calls.deliver(lambda: self._take_verdict(topic, verdict))

    def _take_verdict(self, topic: str, verdict: Verdict) -> None:
        if verdict != self._verdicts.get(topic, verdict):
            self._verdicts[topic] = verdict
            if not self._gathering.isActive():
                self._gathering.start()

    def _take_streams(self, streams: Sequence[StreamStatus]) -> None:
        if tuple(streams) == self.streams:
            return
        self.streams = tuple(streams)
        self._tell_verdicts()
        waiting = [each for each in streams if each.state is ClaimState.PENDING]
        pending = {each.bound_tag: each.detail.partition(": ")[2] for each in waiting}
        self._take_snapshot(replace(self.snapshot, pending=tuple(sorted(pending.items()))))
        self.streams_changed.emit()

    def _tell_verdicts(self) -> None:
        self.decided.emit(self.verdicts)

    def _follow_link(self, is_linked: bool) -> None:
        """Read everything of a manager that answers again: it may be another one."""
        if is_linked:
            self._is_another, self._heard = True, None
            self._revision = self._library_revision = -1
            self._link += 1
            self.look()
        self._tell_rates()
        self._go_on()


def _words(error: Any) -> str:
    if isinstance(error, (DyKnowError, OSError)):
        return str(error)
    return f"{type(error).__name__}: {error}"
