# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tab Streams: asks for streams by their tags, and shows their states."""

from __future__ import annotations

import os
import socket
import time
from dataclasses import replace
from typing import Callable, Mapping, Sequence

from python_qt_binding.QtCore import QEvent, QStringListModel, Qt, Signal
from python_qt_binding.QtWidgets import (
    QCheckBox,
    QCompleter,
    QDoubleSpinBox,
    QHeaderView,
    QLineEdit,
    QPushButton,
    QSplitter,
    QWidget,
)

from dyknow.model.client import BaseManagerClient
from dyknow.model.streams import (
    Acquisition,
    ClaimState,
    Replanned,
    StreamEvent,
    StreamRequest,
    StreamStatus,
)
from dyknow.model.transformation import OUT, Transformation
from dyknow_rqt.graph.changes import acquire, release, replan
from dyknow_rqt.graph.filters import tag_completions
from dyknow_rqt.graph.ways import Way, WayPart, dropped_by, next_ways, present_way, read_way
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.panels.tables import KeyedTable, Panel, WayTree
from dyknow_rqt.selection import Selection
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import column_in, field_of, form_in, row_of, text_of

#: The first column, the key of the rows, is not shown.
_TITLES = ("Claim", "Tag", "State", "Topic", "Type", "Client")
_EVENTS_KEPT = 500
#: Letters of a reason in a row; the tool tip has all of it.
_LONGEST = 70


class StreamsPanel(Panel):
    """Previews, acquires, releases and replans streams; shows their states."""

    #: A plan is shown that is not made yet: its parts; none for no plan.
    planned = Signal(object)

    def __init__(self, monitor: GraphMonitor, line: StatusLine, selection: Selection) -> None:
        super().__init__(monitor, line)
        self._selection = selection
        names, where = "concepts or labels", "Concepts or labels, separated by ;: used where there"
        self.tag, self.datatype = field_of("FieldPosition(ball)"), field_of("any")
        unused = "Transformations that must not be used"
        self.exclude = field_of("labels, separated by ;", unused)
        self.prefer = field_of(names, f"{where} is a choice", "Prefer")
        self.avoid = field_of(names, f"{where} is no other choice", "Avoid")
        self.require = field_of(
            "it.pose.covariance[0] < 0.05",
            "A formula over 'it', the messages of the stream; the stream is repaired when it is "
            "FALSE.\nExample: historically[0 s, 3 s] it.pose.covariance[0] < 0.05",
        )
        of_plan = (self.exclude, self.prefer, self.avoid)
        self.fields = (self.tag, self.datatype, *of_plan, self.require)
        self._tags: list[str] = []
        self._offered, self._types = QStringListModel(self), QStringListModel(self)
        for field, model in ((self.tag, self._offered), (self.datatype, self._types)):
            completer = QCompleter(model, self)
            completer.setFilterMode(Qt.MatchContains)
            completer.setCaseSensitivity(Qt.CaseInsensitive)
            field.setCompleter(completer)
        self.silence = _limit("never", " s", 0.5, "it is silent for longer")
        self.rate = _limit("any rate", " Hz", 1.0, "it is slower", "Rate at least")
        self.age = _limit("any age", " s", 0.1, "its messages are older", "Age at most")
        self.preview = QPushButton("&Preview", clicked=self._preview)
        self.acquire = QPushButton("Ac&quire", clicked=self._acquire)
        self.plan = WayTree("Plan")
        #: The parts of the shown plan, unless that is the present one.
        self._planned: list[WayPart] = []
        #: The claim whose present plan is shown; empty for another text.
        self._explained = ""
        #: The number of the last question; answers to those before it are not shown.
        self._question = 0
        #: Whether *Acquire* waits for what becomes of it.
        self._is_acquiring = False
        #: A tag that is being acquired, and the claims before.
        self._awaited: tuple[str, frozenset[str]] = ("", frozenset())
        self._say("How the stream would be made is shown here")
        self.table = KeyedTable(_TITLES, "Streams")
        self.table.hideColumn(0)
        self.table.sortByColumn(1, Qt.AscendingOrder)
        self.table.horizontalHeader().setSectionResizeMode(1, QHeaderView.ResizeToContents)
        self.ended = QCheckBox("Those that ended too", toggled=self._show_streams)
        self.replan = QPushButton("Replan …", clicked=self._replan)
        self.release = QPushButton("Release", clicked=self._release)
        self.events = text_of("Events of streams")
        self.events.setMaximumBlockCount(_EVENTS_KEPT)
        self.events.setPlaceholderText("What becomes of streams from now on is shown here")
        self._arrange()
        self._listen()
        self._follow()

    # Asking for streams

    def request(self) -> StreamRequest:
        return StreamRequest(
            tag=self.tag.text().strip(),
            datatype=self.datatype.text().strip(),
            client_id=f"window on {socket.gethostname()} ({os.getpid()})",
            max_silence=self.silence.value(),
            min_rate=self.rate.value(),
            max_age=self.age.value(),
            exclude=_names(self.exclude),
            prefer=_names(self.prefer),
            avoid=_names(self.avoid),
            require=self.require.text().strip(),
        )

    def _preview(self) -> None:
        """Show how a stream would be made, and then the next best ways."""
        request = self.request()

        def without(client: BaseManagerClient, label: str) -> Acquisition:
            other = replace(request, exclude=(*request.exclude, label))
            return client.acquire_stream(other, dry_run=True)

        self._explain(request, lambda way: self._add_next_ways(without, way))

    def _acquire(self) -> None:
        """The plan is requested first: then the stream is there already."""
        request, self._is_acquiring = self.request(), True
        self._follow()

        def act(way: Way) -> None:
            self._awaited = request.tag, frozenset(each.claim_id for each in self._monitor.streams)
            self._monitor.settled.connect(self._end_acquisition)
            self._monitor.do(acquire(request))

        self._explain(request, act)

    def _end_acquisition(self) -> None:
        if not self._monitor.is_changing:
            self._monitor.settled.disconnect(self._end_acquisition)
            self._is_acquiring = False
            self._follow()

    def _explain(self, request: StreamRequest, then: Callable[[Way], None]) -> None:
        """Show how a stream would be made, or why it cannot be, and go on in any case."""
        for field in (self.tag, self.datatype):
            field.completer().popup().hide()

        def show(text: str) -> None:
            way = read_way(text)
            if number == self._question:
                self._show_plan(way)
            then(way)

        def take(found: Acquisition) -> None:
            if found.warnings:
                self._monitor.failed.emit("\n".join(found.warnings))
            show(found.plan)

        if request.tag:
            self._explained, self._awaited = "", ("", frozenset())
            self._say("…")
            number = self._begin_question()
            self._monitor.ask(
                lambda client: client.acquire_stream(request, dry_run=True), take, show
            )

    def _add_next_ways(
        self, plan: Callable[[BaseManagerClient, str], Acquisition | Replanned], *shown: Way
    ) -> None:
        """Add the next best ways to the shown ones, if these are still shown."""

        def add(found: Sequence[Way]) -> None:
            if self.plan.ways == shown:
                self.plan.show_ways(*shown, *found)

        self._monitor.ask(
            lambda client: next_ways(lambda label: plan(client, label), shown[0]),
            add,
            lambda reason: None,
        )

    # What there is

    def _release(self) -> None:
        self._monitor.do_in_turn([release(each.claim_id, each.tag) for each in self._chosen()])

    def _replan(self) -> None:
        """Show the plan that is the cheapest now, and ask whether to switch to it."""
        for stream in self._chosen()[:1]:
            self._ask_to_replan(stream)

    def _ask_to_replan(self, stream: StreamStatus) -> None:
        number = self._begin_question()

        def ask(found: Replanned) -> None:
            if number != self._question:
                return
            way = read_way(found.plan)
            ways = way, dropped_by(way, found, stream, self._monitor.snapshot)
            self._explained = ""
            self._show_plan(*ways)
            self._add_next_ways(
                lambda client, label: client.plan_stream(stream.claim_id, (label,)), *ways
            )
            change = replan(stream.claim_id, stream.tag)
            what = f"at a cost of {found.cost:.0f}" if found.spawned else "which spawns nothing"
            self._line.ask(
                f"Switch {stream.tag} to this plan, {what}?",
                "Replan",
                lambda: self._monitor.do(change, lambda: self._show_way(stream.claim_id)),
            )

        self._monitor.ask(lambda client: client.replan_stream(stream.claim_id, dry_run=True), ask)

    def _show_streams(self) -> None:
        rows = []
        for each in self._monitor.streams:
            if not each.state.ended or self.ended.isChecked():
                state, topic = _state(each), each.topic or "–"
                cells = (
                    *(each.claim_id, each.bound_tag, state, topic),
                    *(each.datatype or "–", each.client_id),
                )
                more = [f"claim {each.claim_id}", each.detail, *each.nodelets]
                rows.append((cells, "\n".join(part for part in more if part)))
        self.table.show_rows(rows)
        self._follow()
        tag, before = self._awaited
        wanted = tag, self.request().client_id
        for each in self._monitor.streams:
            if (each.tag, each.client_id) == wanted and each.claim_id not in before:
                self._awaited = ("", frozenset())
                self._explained = each.claim_id
        self._show_way(self._explained)

    def _show_way(self, claim: str) -> None:
        """Show how a stream is made now, also after a repair."""
        stream = self._monitor.stream(claim)
        if stream is not None:
            self._explained = claim
            self.plan.show_ways(present_way(stream, self._monitor.snapshot))
            self._forget_plan()

    def _show_plan(self, *ways: Way) -> None:
        self.plan.show_ways(*ways)
        self._planned = [part for way in ways for part in way]
        if self.isVisible():
            self.planned.emit(self._planned)

    def _say(self, text: str) -> None:
        self._show_plan(read_way(text))

    def _begin_question(self) -> int:
        self._question += 1
        return self._question

    def _forget_plan(self) -> None:
        self._planned = []
        self.planned.emit([])

    def showEvent(self, event: QEvent) -> None:  # noqa: N802
        super().showEvent(event)
        self.planned.emit(self._planned)

    def hideEvent(self, event: QEvent) -> None:  # noqa: N802
        """Draw no plan that is not shown."""
        super().hideEvent(event)
        self.planned.emit([])

    def choose(self, claims: Sequence[str]) -> None:
        self._selection.choose_claims(claims)
        for claim in claims[:1]:
            self._begin_question()
            self._show_way(claim)

    def _show_present_way(self) -> None:
        self._show_way(self._explained)

    def _show_event(self, event: StreamEvent) -> None:
        states = [each.state.name.lower() for each in (event.before, event.after) if each]
        moment = time.strftime("%H:%M:%S", time.localtime(event.stamp))
        self.events.appendPlainText(
            f"{moment}  {event.after.bound_tag}: {' → '.join(dict.fromkeys(states))}"
            + (f" ({event.reason})" if event.reason else "")
        )

    def _show_library(self, library: Mapping[str, Transformation]) -> None:
        outputs = [p for each in library.values() for p in each.ports if p.direction == OUT]
        self._tags = sorted({tag for port in outputs for tag in port.tags})
        self._offered.setStringList(self._tags)
        self._types.setStringList(sorted({p.datatype for p in outputs} - {"", "*"}))

    def _follow(self) -> None:
        has_tag = bool(self.tag.text().strip())
        self.preview.setEnabled(has_tag)
        self.acquire.setEnabled(has_tag and not self._is_acquiring)
        self.table.follow(self._selection.claims)
        streams = self._chosen()
        self.release.setEnabled(bool(streams))
        self.replan.setEnabled(len(streams) == 1)

    # Inside

    def _chosen(self) -> list[StreamStatus]:
        """The streams in selected rows that have not ended."""
        found = map(self._monitor.stream, self.table.chosen())
        return [stream for stream in found if stream is not None and not stream.state.ended]

    def _listen(self) -> None:
        self.tag.textChanged.connect(self._follow)
        for field in self.fields:
            field.returnPressed.connect(self._preview)
        self.table.picked.connect(self.choose)
        self.plan.picked.connect(self._selection.choose_nodelets)
        self.tag.textEdited.connect(self._forget_plan)
        self.tag.textEdited.connect(self._begin_question)
        self._monitor.changed.connect(self._show_present_way)
        self.tag.textEdited.connect(
            lambda text: self._offered.setStringList(tag_completions(text, self._tags))
        )
        for signal in (self._selection.changed, self.table.filter.textChanged):
            signal.connect(self._follow)
        self.table.on_delete(self._release)
        self._monitor.streams_changed.connect(self._show_streams)
        self._monitor.stream_event.connect(self._show_event)
        self._monitor.library_changed.connect(self._show_library)

    def _arrange(self) -> None:
        form = form_in()
        form.addRow("&Tag:", self.tag)
        form.addRow("Type:", self.datatype)
        form.addRow("W&ithout:", self.exclude)
        form.addRow("Prefer, avoid:", row_of(self.prefer, self.avoid))
        form.addRow("Silent at &most:", self.silence)
        form.addRow("Rate, age:", row_of(self.rate, self.age))
        form.addRow("Require:", self.require)
        form.addRow("", row_of(self.preview, self.acquire))
        having = row_of(self.ended, self.replan, self.release)
        having.insertStretch(1, 1)
        middle = QWidget()
        column_in(middle, self.table.filter, self.table, having).setContentsMargins(0, 0, 0, 0)
        parts = QSplitter(Qt.Vertical)
        for part, stretch in ((self.plan, 3), (middle, 2), (self.events, 2)):
            parts.addWidget(part)
            parts.setStretchFactor(parts.count() - 1, stretch)
        column_in(self.page, form, parts).setStretch(1, 1)


def _state(stream: StreamStatus) -> str:
    """The state of a stream, with its reason."""
    state, reason = stream.state.name.lower(), stream.detail.partition("\n")[0]
    is_over = stream.state in (ClaimState.RELEASED, ClaimState.EXPIRED)
    if len(reason) > _LONGEST:
        reason = f"{reason[: _LONGEST - 1]}…"
    return state if is_over or not reason else f"{state}: {reason}"


def _names(field: QLineEdit) -> tuple[str, ...]:
    names = (part.strip() for part in field.text().split(";"))
    return tuple(name for name in names if name)


def _limit(none: str, unit: str, step: float, fault: str, name: str = "") -> QDoubleSpinBox:
    box = QDoubleSpinBox(maximum=3600.0, singleStep=step, suffix=unit, accessibleName=name)
    box.setSpecialValueText(none)
    box.setToolTip(f"The stream is repaired if {fault}")
    return box
