# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps the window's snapshot of the computation graph up to date, and makes its changes.

``GraphMonitor`` owns the remote side and the calls in the background. Its state changes in the
thread of the window only; everything that may block is called in the background.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    FrozenSet,
    Optional,
    Sequence,
    Set,
    Tuple,
    TypeVar,
)

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.errors import DyKnowError, HostError, PeerTimeout, Refused
from dyknow.manager.steps import CannotUndo
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import PortRef, State
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Transformation
from dyknow_rqt.background_calls import BackgroundCalls, qt_slot
from dyknow_rqt.graph.changes import Change, DoneChange, Present, UndoHistory
from dyknow_rqt.graph.rates import Meter, PortRate
from dyknow_rqt.graph.snapshot import PlainNode, Side, Snapshot, plain_nodes, taken_topics
from dyknow_rqt.graph.verdicts import port_verdicts, verdict_sources
from dyknow_rqt.heartbeat import Heartbeat
from dyknow_rqt.remote import Remote
from dyknow_rqt.stream_watch import StreamWatch

if TYPE_CHECKING:
    from dyknow.formulas import Verdict
    from dyknow.model.graph import Model
    from dyknow.model.statistics import NodeletCount

T = TypeVar("T")

_LOG = logging.getLogger("rosout.dyknow_rqt")
#: Milliseconds from look to look.
_PERIOD = 1000
#: Milliseconds for which verdicts are gathered before they are shown.
_GATHERING = 100
#: The master's state is queried at most in one of so many parts of the time.
_SELDOM = 20


@dataclass(frozen=True)
class _Looked:
    model: Model
    nodes: Tuple[PlainNode, ...]
    taken: FrozenSet[str]


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
    #: An error, in words.
    failed = Signal(str)
    #: A change is being made, in words.
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
        self.library: Dict[str, Transformation] = {}
        self.heart = Heartbeat(remote)
        self.heart.linked.connect(self._follow_link)
        self.history = UndoHistory()
        #: Nodelets and their transformations; whether the next model may be another manager's.
        self._made: Set[Tuple[str, str]] = set()
        self._is_another = False
        self._calls = BackgroundCalls()
        self._meter = Meter()
        self._revision = -1
        self._library_revision = -1
        self._looking = self._changing = self._reading = False
        self._system: Tuple[Side, Side] = ((), ())
        self._system_due = 0.0
        self._timer = QTimer(self)
        self._timer.setInterval(_PERIOD)
        self._timer.timeout.connect(self.look)
        self._heard: Optional[Model] = None
        self._drawing = QTimer(self)
        self._drawing.setSingleShot(True)
        self._drawing.setInterval(0)
        self._drawing.timeout.connect(self._take_heard)
        #: The last verdicts by topic, None before the first one.
        self._verdicts: Dict[str, Optional[Verdict]] = {}
        self.watch = StreamWatch(self)
        self.watch.changed.connect(self._take_streams)
        self._gathering = QTimer(self)
        self._gathering.setSingleShot(True)
        self._gathering.setInterval(_GATHERING)
        self._gathering.timeout.connect(self._tell_verdicts)

    def start(self) -> None:
        self.remote.start(
            self._hear_model,
            lambda event: self._calls.deliver(lambda: self.stream_event.emit(event)),
            self._hear_verdict,
            self._hear_counts,
        )
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
    def traffic(self) -> Dict[PortRef, PortRate]:
        """The traffic of ports, as it was measured last."""
        return dict(self._meter.traffic)

    @property
    def is_changing(self) -> bool:
        return self._changing

    def report(self, text: str) -> None:
        self.failed.emit(text)

    @qt_slot
    def look(self) -> None:
        """Read everything now, unless that is under way."""
        if not self._looking:
            self._looking = True
            self._calls.run(self._looked, self._take_look, self._take_failure)

    @qt_slot
    def read_library(self) -> None:
        if not self._reading:
            self._reading = True
            self._calls.run(self._client.get_model, self._take_library, self._take_no_library)

    def ask(
        self,
        question: Callable[[BaseManagerClient], T],
        then: Callable[[T], None],
        failed: Optional[Callable[[str], None]] = None,
    ) -> None:
        """Call the remote side in the background.

        Args:
            question: may block.
            then: called in the thread of the window with the answer.
            failed: called there with the error in words; by default it is reported.
        """
        say = failed or self.report
        if self.is_linked:
            self._calls.run(lambda: question(self._client), then, lambda error: say(_words(error)))
        else:
            say(self.heart.status.text)  # the threads are not to wait for it

    def do(self, change: Change, then: Callable[[], None] = lambda: None) -> None:
        """Make a change, which can then be undone if there is a way back.

        Args:
            change: what to do.
            then: called in the thread of the window when it has been done.
        """
        present = self._present()

        def note(done: DoneChange) -> None:
            self.history.note(done)
            then()

        self._apply(change.text, lambda: change.apply(present), note)

    @qt_slot
    def undo(self) -> None:
        done = self.history.last
        if done is None:
            raise CannotUndo("there is nothing to undo")
        text = f"undo '{done.change.text}'"

        def undo() -> DoneChange:
            done.undo()
            return done._replace(text=text)

        self._apply(text, undo, lambda done: self.history.note_undone(), self.history.drop)

    @qt_slot
    def redo(self) -> None:
        change, present = self.history.next, self._present()
        if change is None:
            raise CannotUndo("there is nothing to redo")
        again = change

        def redo() -> DoneChange:
            again.check(self._client)
            return again.apply(present)

        self._apply(again.text, redo, self.history.note_redone)

    # Inside

    def _present(self) -> Present:
        return Present(self._client, self.snapshot, dict(self.library))

    def _apply(
        self,
        text: str,
        job: Callable[[], DoneChange],
        note: Callable[[DoneChange], None],
        no_way: Callable[[], None] = lambda: None,
    ) -> None:
        """Make one change at a time: the next depends on the state after this one.

        ``no_way`` is called if it was refused, but not if nothing answered.
        """
        refusal = "" if self.is_linked else self.heart.status.text
        if self._changing:
            refusal = "another change is under way; try again when it is done"
        if refusal:
            self.failed.emit(f"{text}: {refusal}")
            self.settled.emit()
            return
        self._changing = True
        self.begun.emit(f"{text} …")

        def settle(signal: Any, words: str) -> None:
            self._tell_history()
            signal.emit(words)
            self.settled.emit()
            self.look()

        def made(done: DoneChange) -> None:
            self._changing = False  # first: the next change may begin at once
            note(done)
            settle(self.done, f"done: {done.text}")

        def refused(error: Exception) -> None:
            self._changing = False
            if isinstance(error, (CannotUndo, Refused)):
                no_way()
            what = f"cannot {text}" if isinstance(error, CannotUndo) else text
            settle(self.failed, f"{what}: {_words(error)}")

        self._calls.run(job, made, refused)

    def _tell_history(self) -> None:
        self.history_changed.emit(*self.history.texts)

    def _looked(self) -> _Looked:
        """Read everything for a look; in the background."""
        model = self.remote.graph()
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
        return _Looked(model, nodes, taken)

    def _system_state(self) -> Tuple[Side, Side]:
        """Ask the master, unless its answers took a large part of the time; in the background."""
        start = time.monotonic()
        if start >= self._system_due:
            self._system = self.remote.system_state()
            end = time.monotonic()
            self._system_due = end + _SELDOM * (end - start)
        return self._system

    def _take_look(self, looked: _Looked) -> None:
        self._looking = False
        if looked.model.revision >= self._revision:
            if self._heard is not None and self._heard.revision <= looked.model.revision:
                self._heard = None  # an older model
            self._take_model(looked.model, looked.nodes, looked.taken)

    def _hear_model(self, model: Model) -> None:
        """Take a model that the manager publishes; in any thread."""
        self.heart.contact.hear_manager()
        shared = replace(model, nodelets=self.snapshot.shared(model.nodelets))
        self._calls.deliver(lambda: self._hear(shared))

    def _hear(self, model: Model) -> None:
        """Delay a model until the one before it has been drawn, and for the same time again."""
        self._heard = model
        if not self._drawing.isActive():
            self._drawing.start()

    @qt_slot
    def _take_heard(self) -> None:
        model, self._heard = self._heard, None
        if model is None:
            return
        start = time.monotonic()
        self._take_model(model, self.snapshot.nodes, self.snapshot.taken)
        self._drawing.setInterval(min(1000, int((time.monotonic() - start) * 2000)))

    def _take_model(
        self, model: Model, nodes: Tuple[PlainNode, ...], taken: FrozenSet[str]
    ) -> None:
        self._revision = model.revision
        made = {(each.name, each.transformation) for each in model.nodelets}
        if self._is_another and made != self._made:
            self.history = UndoHistory()
            self._tell_history()
        self._made, self._is_another = made, False
        self._take_snapshot(Snapshot(model.nodelets, nodes, taken, self.snapshot.pending))
        if model.library_revision != self._library_revision:
            self.read_library()

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        if snapshot != self.snapshot:
            self.snapshot = snapshot
            self.changed.emit(snapshot)
            self._calls.deliver(self._tell_rates)
            self._calls.deliver(self._follow_verdicts)

    def _take_library(self, model: Model) -> None:
        self._reading = False
        self._library_revision = model.library_revision
        library = {each.label: each for each in model.transformations}
        if library != self.library:
            self.library = library
            self.library_changed.emit(library)

    def _take_no_library(self, error: Exception) -> None:
        self._reading = False
        self._log_unexpected(error)

    def _take_failure(self, error: Exception) -> None:
        self._looking = False
        self._log_unexpected(error)

    def _hear_counts(self, counts: Sequence[NodeletCount]) -> None:
        """Take the counts that the manager publishes; in any thread."""
        self.heart.contact.hear_manager()
        moment = time.monotonic()
        self._calls.deliver(lambda: self._take_counts(counts, moment))

    def _take_counts(self, counts: Sequence[NodeletCount], moment: float) -> None:
        self._meter.take(counts, moment)
        self.measured.emit(self.traffic)

    def _tell_rates(self) -> None:
        """Tell the rates of the nodelets that run, if the manager answers."""
        nodelets = self.snapshot.nodelets if self.is_linked else ()
        running = [each for each in nodelets if each.state is State.RUNNING]
        self._meter.keep(
            {PortRef(n.name, port.name): port.topic for n in running for port in n.ports}
        )
        self.measured.emit(self.traffic)

    def _follow_verdicts(self) -> None:
        sources = verdict_sources(self.snapshot.nodelets)
        self._verdicts = {topic: self._verdicts.get(topic) for _, topic in sources}
        self.remote.follow_verdicts(sources)
        self._tell_verdicts()

    def _hear_verdict(self, topic: str, verdict: Verdict) -> None:
        """Take one that differs from the last; in any thread, several times a second."""
        if verdict != self._verdicts.get(topic, verdict):
            self._calls.deliver(lambda: self._take_verdict(topic, verdict))

    def _take_verdict(self, topic: str, verdict: Verdict) -> None:
        if topic in self._verdicts:
            self._verdicts[topic] = verdict
        if not self._gathering.isActive():
            self._gathering.start()

    @qt_slot
    def _take_streams(self) -> None:
        self._tell_verdicts()
        waiting = [each for each in self.watch.streams if each.state is ClaimState.PENDING]
        pending = {each.bound_tag: each.detail.partition(": ")[2] for each in waiting}
        self._take_snapshot(replace(self.snapshot, pending=tuple(sorted(pending.items()))))

    @qt_slot
    def _tell_verdicts(self) -> None:
        nodelets = self.snapshot.nodelets
        self.decided.emit(port_verdicts(nodelets, self._verdicts, self.watch.streams))

    def _log_unexpected(self, error: Exception) -> None:
        if not isinstance(error, DyKnowError):
            _LOG.error("a look at the graph failed", exc_info=error)

    @qt_slot
    def _follow_link(self, is_linked: bool) -> None:
        """Read everything of a manager that answers again: it may be another one."""
        if is_linked:
            self._is_another = True
            self._revision = self._library_revision = -1
            self.look()
        self._tell_rates()


def _words(error: Any) -> str:
    if isinstance(error, (HostError, PeerTimeout, DyKnowError, OSError)):
        return str(error)
    return f"{type(error).__name__}: {error}"
