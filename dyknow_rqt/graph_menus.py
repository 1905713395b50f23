# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Context menus of the graph."""

from __future__ import annotations

from functools import partial
from typing import Any, Callable, Optional

from python_qt_binding.QtCore import QObject, Signal
from python_qt_binding.QtGui import QGuiApplication
from python_qt_binding.QtWidgets import QMenu, QWidget

from dyknow.model.graph import PortRef
from dyknow_rqt.canvas.appearance import edge_refs
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.items import Item, PortItem
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import VertexKind
from dyknow_rqt.graph.snapshot import Snapshot


class GraphActions(QObject):
    """What the user asks for in the graph; the parts of the window that do it connect."""

    #: Connect a port; the nodelet, and the port or an empty text.
    connection_wanted = Signal(str, str)
    #: Make a nodelet; the label of its transformation, or an empty text.
    create_wanted = Signal(str)
    #: Destroy nodelets; their names.
    destroy_wanted = Signal(object)
    #: Disconnect ports; a tuple of ``PortRef``.
    disconnect_wanted = Signal(object)
    #: Protect a nodelet, or release it; its name.
    protect_wanted = Signal(str, bool)
    find_wanted = Signal()
    fit_wanted = Signal()
    refresh_wanted = Signal()
    tidy_wanted = Signal()


def menu_for(
    item: Optional[Item], snapshot: Snapshot, actions: GraphActions, parent: QWidget
) -> QMenu:
    """Make the menu of an item, or of the background."""
    menu = QMenu(parent)
    if isinstance(item, PortItem):
        _add_port(menu, item.ref, snapshot, actions)
    elif isinstance(item, EdgeItem):
        refs = edge_refs(item.edge)
        for ref in refs:
            _add(menu, f"&Disconnect {ref}", partial(actions.disconnect_wanted.emit, (ref,)))
        _add_copy(menu, item.edge.topic)
    elif isinstance(item, VertexItem):
        _add_vertex(menu, item, snapshot, actions)
    else:
        _add(menu, "&Create nodelet …", partial(actions.create_wanted.emit, ""))
        _add(menu, "&Find …", actions.find_wanted.emit)
        menu.addSeparator()
        _add(menu, "&Fit in view", actions.fit_wanted.emit)
        _add(menu, "&Tidy up", actions.tidy_wanted.emit)
        _add(menu, "&Refresh", actions.refresh_wanted.emit)
    return menu


def _add_vertex(menu: QMenu, item: VertexItem, snapshot: Snapshot, actions: GraphActions) -> None:
    name = item.vertex.name
    nodelet = snapshot.nodelet(name) if item.vertex.kind is VertexKind.NODELET else None
    if nodelet is not None:
        connected = tuple(PortRef(name, port.name) for port in nodelet.ports if port.topic)
        _add(menu, "&Connect …", partial(actions.connection_wanted.emit, name, ""))
        action = _add(
            menu, "&Disconnect all ports", partial(actions.disconnect_wanted.emit, connected)
        )
        action.setEnabled(bool(connected))
        protected = nodelet.is_protected
        _add(
            menu,
            "&Release from protection" if protected else "&Protect",
            partial(actions.protect_wanted.emit, name, not protected),
        )
        _add(menu, "D&estroy …", partial(actions.destroy_wanted.emit, (name,))).setEnabled(
            not protected
        )
    elif item.vertex.kind is VertexKind.TOPIC:
        topic = snapshot.topics().get(name)
        refs = topic.sources + topic.targets if topic is not None else ()
        action = _add(menu, "&Disconnect all ports", partial(actions.disconnect_wanted.emit, refs))
        action.setEnabled(bool(refs))
    _add_copy(menu, name)


def _add_port(menu: QMenu, ref: PortRef, snapshot: Snapshot, actions: GraphActions) -> None:
    port = snapshot.port(ref)
    _add(menu, "&Connect …", partial(actions.connection_wanted.emit, ref.nodelet, ref.port))
    action = _add(menu, "&Disconnect", partial(actions.disconnect_wanted.emit, (ref,)))
    action.setEnabled(port is not None and bool(port.topic))
    _add_copy(menu, str(ref))


def _add_copy(menu: QMenu, text: str) -> None:
    menu.addSeparator()
    _add(menu, "Copy &name", lambda: QGuiApplication.clipboard().setText(text))


def _add(menu: QMenu, text: str, function: Callable[[], object]) -> Any:
    action = menu.addAction(text)
    action.triggered.connect(lambda checked=False: function())
    return action
