# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The context menus of the graph, and the other programs that they open."""

from __future__ import annotations

import shutil
from functools import partial
from typing import Any, Callable, Collection, Iterable, Iterator, NamedTuple, Sequence, Sized

from python_qt_binding.QtCore import QProcess
from python_qt_binding.QtGui import QGuiApplication
from python_qt_binding.QtWidgets import QMenu, QWidget

from dyknow.model.graph import PortRef
from dyknow_rqt.graph import changes
from dyknow_rqt.graph.figure import Edge, Group, VertexKind, edge_refs
from dyknow_rqt.graph.snapshot import Snapshot, not_destroyed, not_ours, protection
from dyknow_rqt.graph_panel.bar import GraphBar
from dyknow_rqt.graph_panel.edits import GraphEdits
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.selection import Selection


def menu_of(
    selection: Selection, monitor: GraphMonitor, edits: GraphEdits, parent: QWidget
) -> QMenu:
    menu, snapshot = QMenu(parent), monitor.snapshot
    menu.setToolTipsVisible(True)
    nodelets, edges = selection.nodelets, selection.edges
    topics, nodes = selection.names(VertexKind.TOPIC), selection.names(VertexKind.NODE)
    count = len(selection.keys)
    if count == 1 and nodelets:
        _add(menu, "&Connect …", partial(edits.connection_wanted.emit, nodelets[0], ""))
    if count == 1 and edges:
        for ref in edge_refs(edges[0]):
            _add(menu, f"&Disconnect {ref}", partial(edits.disconnect_ports, (ref,)))
    else:
        refs = tuple(dict.fromkeys(_connected(nodelets, topics, edges, snapshot)))
        text = "&Disconnect all ports" if count == 1 else f"&Disconnect {_count(refs, 'port')}"
        action = _add(menu, text, partial(edits.disconnect_ports, refs))
        action.setEnabled(bool(refs))
    if count == 1 and (topics or edges):
        topic = topics[0] if topics else edges[0].topic
        _add(menu, "Show last &message", partial(edits.topic_wanted.emit, topic))
        found_topic = snapshot.topics().get(topic)
        datatype = found_topic.datatype if found_topic is not None else ""
        add_viewers(menu.addMenu("&Open in"), VIEWERS, datatype, topic=topic)
    if count == 1 and nodelets:
        _add(menu, "Para&meters …", partial(edits.show_parameters, nodelets[0]))
        add_viewers(menu.addMenu("&Log in"), LOG_VIEWERS, name=nodelets[0])
    if nodelets:
        what = "" if len(nodelets) == 1 else f" {_count(nodelets, 'nodelet')}"
        names, on = protection(nodelets, snapshot)
        text = f"&Protect{what}" if on else f"&Release{what} from protection"
        protect = [changes.protect(name, on) for name in names]
        _add(menu, text, partial(monitor.do_in_turn, protect))
        foreign, kept = not_ours(nodelets, snapshot), not_destroyed(nodelets, snapshot)
        restart = partial(monitor.do, changes.restart(nodelets))
        _add(menu, f"Re&start{what}", restart, foreign)
        found = [snapshot.nodelet(name) for name in nodelets]
        on = not all(each is not None and each.isolated for each in found)
        text = "its" if len(nodelets) == 1 else "their"
        text = f"&Isolate{what} in {text} own process" if on else f"Share a process{what}"
        _add(menu, text, partial(monitor.do, changes.isolate(nodelets, on)), kept)
        _add(menu, f"D&estroy{what} …", partial(edits.ask_to_destroy, nodelets), kept)
    named = [*nodelets, *topics, *nodes, *(edge.topic for edge in edges)]
    _add_copy(menu, dict.fromkeys(named))
    return menu


def menu_of_ground(edits: GraphEdits, bar: GraphBar, box: Group, outer: Sequence[Group]) -> QMenu:
    """Make the menu of the background, in a ``box`` or in none; ``outer`` are in no other."""
    menu = QMenu(bar)
    _add(menu, "&Create nodelet …", partial(edits.create_wanted.emit, ""))
    rest = [bar.find, bar.fit, bar.tidy, bar.refresh, bar.timeline, bar.next_ill, bar.keys]
    menu.addActions(rest)
    menu.addSeparator()
    if box:
        _add(menu, f"C&ollapse {box[-1]}", partial(bar.toggle_box, box))
    every = {*outer, *bar.collapsed}
    _add(menu, "Co&llapse all boxes", partial(bar.collapse, every)).setEnabled(bool(every))
    opened = _add(menu, "Open all &boxes", partial(bar.collapse, ()))
    opened.setEnabled(bool(bar.collapsed))
    return menu


def menu_of_port(ref: PortRef, snapshot: Snapshot, edits: GraphEdits, parent: QWidget) -> QMenu:
    menu, port = QMenu(parent), snapshot.port(ref)
    _add(menu, "&Connect …", partial(edits.connection_wanted.emit, ref.nodelet, ref.port))
    action = _add(menu, "&Disconnect", partial(edits.disconnect_ports, (ref,)))
    action.setEnabled(port is not None and bool(port.topic))
    _add_copy(menu, [str(ref)])
    return menu


def _connected(
    nodelets: Iterable[str], topics: Iterable[str], edges: Iterable[Edge], snapshot: Snapshot
) -> Iterator[PortRef]:
    """The ports to disconnect: all of nodelets and topics, and where arrows end."""
    for name in nodelets:
        nodelet = snapshot.nodelet(name)
        ports = nodelet.connections if nodelet is not None else ()
        yield from (PortRef(name, port) for port in ports)
    for name in topics:
        topic = snapshot.topics().get(name)
        yield from topic.sources + topic.targets if topic is not None else ()
    yield from (ref for edge in edges for ref in edge_refs(edge)[:1])


def _count(things: Sized, what: str) -> str:
    return f"{len(things)} {what}{'' if len(things) == 1 else 's'}"


def _add_copy(menu: QMenu, names: Collection[str]) -> None:
    menu.addSeparator()
    text = "Copy &name" if len(names) == 1 else "Copy &names"
    action = _add(menu, text, lambda: QGuiApplication.clipboard().setText("\n".join(names)))
    action.setEnabled(bool(names))


def _add(menu: QMenu, text: str, function: Callable[[], object], why_not: str = "") -> Any:
    """Add an action; it is disabled if there is a reason why it cannot be done."""
    action = menu.addAction(text)
    action.setEnabled(not why_not)
    action.setToolTip(why_not)
    action.triggered.connect(lambda checked=False: function())
    return action


#: Types of messages that are images.
IMAGES = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")
_TERMINAL = ("x-terminal-emulator", "-e", "rostopic", "echo")


class Viewer(NamedTuple):
    """A program that shows images, or everything else, or both (None).

    In the words of its command ``{topic}``, ``{field}`` and ``{name}`` are replaced.
    """

    title: str
    words: tuple[str, ...]
    is_for_images: bool | None = None

    def is_there(self) -> bool:
        programs = ("rostopic", self.words[0]) if self.words[:4] == _TERMINAL else self.words[:1]
        return all(shutil.which(each) for each in programs)

    def start(self, topic: str, field: str, name: str) -> None:
        """Start it; it outlives the window."""
        field = "/" + field.replace(".", "/") if field else ""
        words = [word.format(topic=topic, field=field, name=name) for word in self.words]
        QProcess.startDetached(words[0], words[1:])


VIEWERS = (
    Viewer("rqt_image_view", ("rqt_image_view", "{topic}"), True),
    Viewer("rqt_plot", ("rqt_plot", "{topic}{field}"), False),
    Viewer("rostopic echo", (*_TERMINAL, "{topic}")),
)
LOG_VIEWERS = (
    Viewer("rqt_console", ("rqt_console",)),
    Viewer("rostopic echo", (*_TERMINAL, "--filter", "m.name == '{name}'", "/rosout")),
)


def add_viewers(
    menu: QMenu,
    viewers: Sequence[Viewer],
    datatype: str = "",
    topic: str = "",
    field: str = "",
    name: str = "",
) -> None:
    """Add the programs that show something; those that are not installed are greyed."""
    for viewer in viewers:
        if viewer.is_for_images in (None, datatype in IMAGES):
            action = menu.addAction(viewer.title)
            action.setEnabled(viewer.is_there())
            start = partial(viewer.start, topic, field, name)
            action.triggered.connect(lambda checked=False, start=start: start())
