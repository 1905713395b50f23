# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The context menus of the graph, and the files of wirings that it saves and loads."""

from __future__ import annotations

from functools import partial
from typing import Any, Callable, Collection, Iterable, Iterator, List, Sized, Tuple

from python_qt_binding.QtCore import QObject, Signal
from python_qt_binding.QtGui import QGuiApplication
from python_qt_binding.QtWidgets import QFileDialog, QMenu, QWidget

from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import PortRef
from dyknow.model.hosts import pins
from dyknow.wiring.wiring import read_wiring, wiring_of
from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.graph.changes import load_wiring, protection
from dyknow_rqt.graph.figure import Edge, VertexKind, edge_refs
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph_bar import GraphBar
from dyknow_rqt.monitor import GraphMonitor
from dyknow_rqt.selection import Selection
from dyknow_rqt.viewers import LOG_VIEWERS, VIEWERS, add_viewers

_FILES = "Wirings (*.xml);;All files (*)"


class WiringFiles:
    """Saves the wiring and loads it."""

    def __init__(self, monitor: GraphMonitor, window: QWidget) -> None:
        self._monitor, self._window = monitor, window
        self.report = monitor.report

    def save(self, path: str) -> None:
        """Write the nodelets, their connections and their transformations to a file."""

        def write(client: BaseManagerClient) -> Tuple[int, List[str]]:
            wiring, left_out = wiring_of(client.get_model(), pins(client.list_hosts()))
            with open(path, "w", encoding="utf-8") as file:
                file.write(wiring.to_xml())
            return len(wiring.nodelets), [each.name for each in left_out]

        def say(written: Tuple[int, List[str]]) -> None:
            count, left_out = written
            text = f"{count} nodelet{'' if count == 1 else 's'} saved in {path}"
            if left_out:
                text += f"; without {', '.join(left_out)}, which others have loaded"
            self._monitor.done.emit(text)

        self._monitor.ask(write, say)

    def load(self, path: str) -> None:
        """Load the wiring of a file; nodelets that it does not name are left alone.

        Raises:
            OSError: the file cannot be read.
            SpecificationError: it is not a wiring; with all problems.
        """
        with open(path, "rb") as file:
            wiring = read_wiring(file.read(), path.rpartition("/")[2])
        self._monitor.do(load_wiring(wiring, path.rpartition("/")[2]))

    @qt_slot
    def ask_where_to_save(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self._window, "Save the wiring", "wiring.xml", _FILES
        )
        if path:
            self.save(path)

    @qt_slot
    def ask_what_to_load(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self._window, "Load a wiring", "", _FILES)
        if path:
            self.load(path)


class GraphActions(QObject):
    """Requests of the user in the graph; the parts of the window that do it connect."""

    #: Connect a port; the nodelet, and the port or an empty text.
    connection_wanted = Signal(str, str)
    #: Make a nodelet; the label of its transformation, or an empty text.
    create_wanted = Signal(str)
    #: Destroy nodelets; their names.
    destroy_wanted = Signal(object)
    #: Disconnect ports; a tuple of ``PortRef``.
    disconnect_wanted = Signal(object)
    #: Make nodelets again in processes of their own, or not; their names.
    isolate_wanted = Signal(object, bool)
    #: Show the parameters of a nodelet.
    parameters_wanted = Signal(str)
    #: Protect nodelets, or release them; their names.
    protect_wanted = Signal(object, bool)
    #: Restart nodelets; their names.
    restart_wanted = Signal(object)
    #: Show the last message of a topic.
    topic_wanted = Signal(str)


def menu_of(
    selection: Selection, snapshot: Snapshot, actions: GraphActions, parent: QWidget
) -> QMenu:
    menu = QMenu(parent)
    nodelets, edges = selection.nodelets, selection.edges
    topics, nodes = selection.names(VertexKind.TOPIC), selection.names(VertexKind.NODE)
    count = len(selection.keys)
    if count == 1 and nodelets:
        _add(menu, "&Connect …", partial(actions.connection_wanted.emit, nodelets[0], ""))
    if count == 1 and edges:
        for ref in edge_refs(edges[0]):
            _add(menu, f"&Disconnect {ref}", partial(actions.disconnect_wanted.emit, (ref,)))
    else:
        refs = tuple(dict.fromkeys(_connected(nodelets, topics, edges, snapshot)))
        text = "&Disconnect all ports" if count == 1 else f"&Disconnect {_count(refs, 'port')}"
        action = _add(menu, text, partial(actions.disconnect_wanted.emit, refs))
        action.setEnabled(bool(refs))
    if count == 1 and (topics or edges):
        topic = topics[0] if topics else edges[0].topic
        _add(menu, "Show last &message", partial(actions.topic_wanted.emit, topic))
        found_topic = snapshot.topics().get(topic)
        datatype = found_topic.datatype if found_topic is not None else ""
        add_viewers(menu.addMenu("&Open in"), VIEWERS, datatype, topic=topic)
    if count == 1 and nodelets:
        _add(menu, "Para&meters …", partial(actions.parameters_wanted.emit, nodelets[0]))
        add_viewers(menu.addMenu("&Log in"), LOG_VIEWERS, name=nodelets[0])
    if nodelets:
        what = "" if len(nodelets) == 1 else f" {_count(nodelets, 'nodelet')}"
        names, on = protection(nodelets, snapshot)
        text = f"&Protect{what}" if on else f"&Release{what} from protection"
        _add(menu, text, partial(actions.protect_wanted.emit, names, on))
        _add(menu, f"Re&start{what}", partial(actions.restart_wanted.emit, nodelets))
        found = [snapshot.nodelet(name) for name in nodelets]
        on = not all(each is not None and each.isolated for each in found)
        text = "its" if len(nodelets) == 1 else "their"
        text = f"&Isolate{what} in {text} own process" if on else f"Share a process{what}"
        _add(menu, text, partial(actions.isolate_wanted.emit, nodelets, on))
        _add(menu, f"D&estroy{what} …", partial(actions.destroy_wanted.emit, nodelets)).setEnabled(
            not any(each is not None and each.is_protected for each in found)
        )
    named = [*nodelets, *topics, *nodes, *(edge.topic for edge in edges)]
    _add_copy(menu, dict.fromkeys(named))
    return menu


def menu_of_ground(actions: GraphActions, bar: GraphBar) -> QMenu:
    menu = QMenu(bar)
    _add(menu, "&Create nodelet …", partial(actions.create_wanted.emit, ""))
    rest = [bar.find, bar.fit, bar.tidy, bar.refresh, bar.timeline, bar.next_ill, bar.keys]
    menu.addActions(rest)
    return menu


def menu_of_port(
    ref: PortRef, snapshot: Snapshot, actions: GraphActions, parent: QWidget
) -> QMenu:
    menu, port = QMenu(parent), snapshot.port(ref)
    _add(menu, "&Connect …", partial(actions.connection_wanted.emit, ref.nodelet, ref.port))
    action = _add(menu, "&Disconnect", partial(actions.disconnect_wanted.emit, (ref,)))
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
    yield from (edge_refs(edge)[0] for edge in edges)


def _count(things: Sized, what: str) -> str:
    return f"{len(things)} {what}{'' if len(things) == 1 else 's'}"


def _add_copy(menu: QMenu, names: Collection[str]) -> None:
    menu.addSeparator()
    text = "Copy &name" if len(names) == 1 else "Copy &names"
    _add(menu, text, lambda: QGuiApplication.clipboard().setText("\n".join(names)))


def _add(menu: QMenu, text: str, function: Callable[[], object]) -> Any:
    action = menu.addAction(text)
    action.triggered.connect(lambda checked=False: function())
    return action
