"""Context menus of the graph: what can be done with a thing."""

from __future__ import annotations

from functools import partial
from typing import Any, Callable, Optional

from python_qt_binding.QtGui import QGuiApplication
from python_qt_binding.QtWidgets import QMenu, QWidget

from dyknow_rqt.canvas.appearance import edge_refs
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.items import Item, PortItem
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import VertexKind
from dyknow_rqt.graph.snapshot import PortRef, Snapshot


class GraphActions:
    """What menus can have done; the graph panel fills it in."""

    def __init__(self) -> None:
        """Begin with actions that do nothing."""
        self.destroy: Callable[..., Any] = _nothing
        self.protect: Callable[..., Any] = _nothing
        self.disconnect: Callable[..., Any] = _nothing
        self.begin_connection: Callable[..., Any] = _nothing
        self.create: Callable[..., Any] = _nothing
        self.refresh: Callable[..., Any] = _nothing
        self.fit: Callable[..., Any] = _nothing
        self.tidy: Callable[..., Any] = _nothing
        self.find: Callable[..., Any] = _nothing


def _nothing(*args: Any) -> None:
    """What is done as long as nobody says what to do."""


def menu_for(
    item: Optional[Item], snapshot: Snapshot, actions: GraphActions, parent: QWidget
) -> QMenu:
    """Make the menu for a thing of the graph, or for the ground."""
    menu = QMenu(parent)
    if isinstance(item, PortItem):
        _add_port(menu, item.ref, snapshot, actions)
    elif isinstance(item, EdgeItem):
        refs = edge_refs(item.edge)
        for ref in refs:
            _add(menu, f"&Disconnect {ref}", partial(actions.disconnect, (ref,)))
        _add_copy(menu, item.edge.topic)
    elif isinstance(item, VertexItem):
        _add_vertex(menu, item, snapshot, actions)
    else:
        _add(menu, "&Create nodelet …", actions.create)
        _add(menu, "&Find …", actions.find)
        menu.addSeparator()
        _add(menu, "&Fit in view", actions.fit)
        _add(menu, "&Tidy up", actions.tidy)
        _add(menu, "&Refresh", actions.refresh)
    return menu


def _add_vertex(menu: QMenu, item: VertexItem, snapshot: Snapshot, actions: GraphActions) -> None:
    name = item.vertex.name
    nodelet = snapshot.nodelet(name) if item.vertex.kind is VertexKind.NODELET else None
    if nodelet is not None:
        connected = tuple(PortRef(name, port.name) for port in nodelet.ports if port.topic)
        _add(menu, "&Connect …", lambda: actions.begin_connection(name))
        action = _add(menu, "&Disconnect all ports", lambda: actions.disconnect(connected))
        action.setEnabled(bool(connected))
        protected = nodelet.is_protected
        _add(
            menu,
            "&Release from protection" if protected else "&Protect",
            lambda: actions.protect(name, not protected),
        )
        _add(menu, "D&estroy …", lambda: actions.destroy((name,))).setEnabled(not protected)
    elif item.vertex.kind is VertexKind.TOPIC:
        topic = snapshot.topics().get(name)
        refs = topic.sources + topic.sinks if topic is not None else ()
        action = _add(menu, "&Disconnect all ports", lambda: actions.disconnect(refs))
        action.setEnabled(bool(refs))
    _add_copy(menu, name)


def _add_port(menu: QMenu, ref: PortRef, snapshot: Snapshot, actions: GraphActions) -> None:
    port = snapshot.port(ref)
    _add(menu, "&Connect …", lambda: actions.begin_connection(ref.nodelet, ref.port))
    action = _add(menu, "&Disconnect", lambda: actions.disconnect((ref,)))
    action.setEnabled(port is not None and bool(port.topic))
    _add_copy(menu, str(ref))


def _add_copy(menu: QMenu, text: str) -> None:
    menu.addSeparator()
    _add(menu, "Copy &name", lambda: QGuiApplication.clipboard().setText(text))


def _add(menu: QMenu, text: str, function: Callable[[], object]) -> Any:
    action = menu.addAction(text)
    action.triggered.connect(lambda checked=False: function())
    return action
