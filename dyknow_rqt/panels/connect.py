# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tab Connect: two ports over a topic that is chosen for them, or one port and a topic."""

from __future__ import annotations

import contextlib
from typing import Callable, Mapping, Sequence

from python_qt_binding.QtCore import QEvent, QSignalBlocker, QStringListModel, Qt
from python_qt_binding.QtWidgets import QComboBox, QCompleter, QGroupBox, QLabel, QPushButton

from dyknow.errors import InvalidName
from dyknow.model.graph import PortRef, PortState
from dyknow.model.transformation import IN, OUT
from dyknow.wiring.ports import CannotConnect
from dyknow_rqt.graph import wiring
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.panels.tables import Panel
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import column_in, field_of, form_in, row_of


class _PortChoice:
    """Two boxes: a nodelet, and one of its ports."""

    def __init__(self, what: str) -> None:
        self.nodelet, self.port = QComboBox(), QComboBox()
        #: The nodelet whose ports were offered last.
        self._owner = ""
        for box, name in ((self.nodelet, "nodelet"), (self.port, "port")):
            box.setAccessibleName(f"{what} {name}")
            box.setMinimumContentsLength(10)
            box.setSizeAdjustPolicy(QComboBox.AdjustToMinimumContentsLengthWithIcon)

    @property
    def ref(self) -> PortRef | None:
        port = self.port.currentData()
        return PortRef(self.nodelet.currentText(), port) if port is not None else None

    def offer(
        self, ports: Mapping[str, Sequence[PortState]], every: Mapping[str, Sequence[PortState]]
    ) -> None:
        """Offer nodelets with these ports of ``every`` one; choices are kept, also when away."""
        offered = [(name, name) for name in sorted(ports) if ports[name]]
        _refill(self.nodelet, offered, lambda name: not every.get(name))
        name = self.nodelet.currentText()
        found = [(_words(port), port.name) for port in ports.get(name, ())]
        _refill(self.port, found, lambda port: name == self._owner)
        self._owner = name or self._owner

    def choose(self, ref: PortRef) -> None:
        self.nodelet.setCurrentText(ref.nodelet)
        found = self.port.findData(ref.port)
        if found >= 0:
            self.port.setCurrentIndex(found)


class ConnectPanel(Panel):
    """Offers only ports and topics that fit."""

    def __init__(self, monitor: GraphMonitor, line: StatusLine) -> None:
        super().__init__(monitor, line)
        self.source, self.sink = _PortChoice("From"), _PortChoice("To")
        self.single = _PortChoice("Single")
        self.topic_chosen, self.now, self.replaced = (QLabel(wordWrap=True) for _ in range(3))
        self.topic_chosen.setTextInteractionFlags(Qt.TextSelectableByMouse)
        self.connect = QPushButton("Connect", clicked=self._connect)
        self.topic = field_of("/camera/image")
        self._topics = QStringListModel(self)
        self.topic.setCompleter(QCompleter(self._topics, self))
        self.connect_topic = QPushButton("Connect", clicked=self._connect_topic)
        self.disconnect_port = QPushButton("D&isconnect", clicked=self._disconnect)
        two = _box(
            "Two nodelets",
            ("From:", self.source.nodelet),
            ("port:", self.source.port),
            ("&To:", self.sink.nodelet),
            ("port:", self.sink.port),
            ("over topic:", self.topic_chosen),
            ("", self.connect),
        )
        one = _box(
            "One port and a topic",
            ("Nodelet:", self.single.nodelet),
            ("port:", self.single.port),
            ("now:", self.now),
            ("To&pic:", self.topic),
            ("", self.replaced),
            ("", row_of(self.connect_topic, self.disconnect_port)),
        )
        column_in(self.page, two, one).addStretch(1)
        for choice in (self.source, self.sink, self.single):
            choice.nodelet.currentIndexChanged.connect(self._follow)
            choice.port.currentIndexChanged.connect(self._follow)
        self.topic.textChanged.connect(self._follow)
        self.topic.returnPressed.connect(self._connect_topic)
        monitor.changed.connect(self._follow)
        self._follow()

    def begin(self, nodelet: str, port: str = "") -> None:
        snapshot = self._monitor.snapshot
        found = snapshot.nodelet(nodelet)
        if found is None or not found.ports:
            return
        state = (found.port(port) if port else None) or found.ports[-1]
        ref = PortRef(nodelet, state.name)
        if state.direction == IN:
            # The source is chosen first: only fitting topics are offered for the other end.
            for other in wiring.partners(snapshot, ref):
                self.source.choose(other)
                break
            self.sink.choose(ref)
        else:
            self.source.choose(ref)
        self.single.choose(ref)
        self.source.nodelet.setFocus()

    def showEvent(self, event: QEvent) -> None:  # noqa: N802
        """Catch up with changes that were missed while it was hidden."""
        super().showEvent(event)
        self._follow()

    def _connect(self) -> None:
        source, sink = self.source.ref, self.sink.ref
        if source is not None and sink is not None:
            self._monitor.do(lambda snapshot: wiring.connect(snapshot, source, sink))

    def _connect_topic(self) -> None:
        ref, topic = self.single.ref, self.topic.text().strip()
        if ref is not None and topic:
            self._monitor.do(lambda snapshot: wiring.connect_topic(snapshot, ref, topic))

    def _disconnect(self) -> None:
        ref = self.single.ref
        if ref is not None:
            self._monitor.do(lambda snapshot: wiring.disconnect(snapshot, (ref,)))

    def _follow(self) -> None:
        """Offer the fitting topics; choices that still fit are kept. Only where it is seen."""
        if not self.isVisible():
            return
        snapshot = self._monitor.snapshot
        every = {nodelet.name: nodelet.ports for nodelet in snapshot.nodelets}
        outs = {name: [p for p in ports if p.direction == OUT] for name, ports in every.items()}
        self.source.offer(outs, every)
        fitting = set(wiring.partners(snapshot, self.source.ref)) if self.source.ref else set()
        ins = {n: [p for p in ps if PortRef(n, p.name) in fitting] for n, ps in every.items()}
        self.sink.offer(ins, every)
        self.single.offer(every, every)
        self._show_choice(snapshot)
        ref = self.single.ref
        port = snapshot.port(ref) if ref is not None else None
        self.now.setText((port.topic or "not connected") if port is not None else "–")
        self._topics.setStringList(wiring.topics_for(snapshot, ref) if ref is not None else [])
        self.disconnect_port.setEnabled(port is not None and bool(port.topic))
        wanted = self.topic.text().strip()
        self.replaced.setText("")
        if ref is not None and wanted:
            with contextlib.suppress(CannotConnect, InvalidName):  # the button says why
                self.replaced.setText(wiring.connect_topic(snapshot, ref, wanted).replaced)
        self.connect_topic.setEnabled(port is not None and bool(wanted))

    def _show_choice(self, snapshot: Snapshot) -> None:
        source, sink = self.source.ref, self.sink.ref
        text, possible = "–", False
        if source is not None and sink is not None:
            try:
                text = wiring.choose_topic(snapshot, source, sink)
            except CannotConnect as error:
                text = str(error)
            else:
                change = wiring.connect(snapshot, source, sink)
                possible = bool(change.topics)
                text += f"\n{change.replaced}" if possible else "  (connected already)"
        self.topic_chosen.setText(text.strip())
        self.connect.setEnabled(possible)


def _box(title: str, *rows: tuple[str, object]) -> QGroupBox:
    box = QGroupBox(title)
    form = form_in(box)
    form.setLabelAlignment(Qt.AlignRight | Qt.AlignVCenter)
    for name, field in rows:
        form.addRow(name, field)
    return box


def _words(port: PortState) -> str:
    arrow = "→" if port.direction == OUT else "←"
    return f"{arrow} {port.name}" + (f"  [{port.datatype}]" if port.datatype else "")


def _refill(
    box: QComboBox, wanted: Sequence[tuple[str, str]], is_away: Callable[[str], bool]
) -> None:
    """Replace the entries of a box; the chosen one stays chosen if it is among them.

    If not, none is chosen until it returns, where it is away, or else the first.
    """
    if [(box.itemText(i), box.itemData(i)) for i in range(box.count())] == wanted:
        return
    chosen = box.currentData() or box.property("awaited")
    with QSignalBlocker(box):
        box.clear()
        for text, data in wanted:
            box.addItem(text, data)
        found = box.findData(chosen)
        awaits = chosen is not None and found < 0 and (not wanted or is_away(chosen))
        box.setProperty("awaited", chosen if awaits else None)
        box.setCurrentIndex(found if awaits else max(found, 0))
