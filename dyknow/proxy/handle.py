# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow NodeHandle: the plain one, with ports where that has topics."""

from __future__ import annotations

from typing import Any

from dyknow.model.statistics import NodeletStatistics
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.port import PortPublisher, PortSubscriber
from dyknow.proxy.proxy import NodeletProxy, ReconfigureCallback


class NodeHandle(PlainNodeHandle):
    """A handle whose publishers and subscribers are ports; everything else is as on topics.

    All handles of one nodelet share one proxy, so a port is the same port in each of them. A port
    starts disconnected unless the load request remaps its name.
    """

    _place = "at port"
    proxy_class = NodeletProxy  # keeps the ports

    def __init__(self, node_handle: PlainNodeHandle) -> None:
        """Take the place of one of the nodelet's own handles, such as ``self.node_handle``."""
        if not isinstance(node_handle, PlainNodeHandle) or isinstance(node_handle, NodeHandle):
            raise TypeError(
                "dyknow.NodeHandle expects a handle of the nodelet, such as self.node_handle, "
                f"not {type(node_handle).__name__}"
            )
        super().__init__(node_handle.context, node_handle.namespace, node_handle.concurrent)
        self._proxy = self.proxy_class.of(node_handle.context)

    def get_statistics(self) -> NodeletStatistics:
        """Return the counts of the nodelet and its ports since it was loaded.

        The service ``get_statistics`` answers the same: ``uptime``, ``reconfigurations``,
        ``callback_errors``, and for each of ``ports`` its ``messages``, ``rate``, ``dropped`` …
        """
        return self._proxy.get_statistics()

    def set_reconfigure_callback(self, callback: ReconfigureCallback | None) -> None:
        """Call back when ports were connected elsewhere.

        The callback gets two maps from port to topic, of in-ports and of out-ports; a topic is
        empty where the port is disconnected. It runs on the nodelet's queue, after the last
        message of the old and before the first of the new connection. Its errors are logged
        and do not undo the switch.
        """
        self._proxy.set_reconfigure_callback(callback)

    def _make_publisher(self, *args: Any, **options: Any) -> PortPublisher:
        return self._proxy.publisher(self, *args, **options)

    def _make_subscriber(self, *args: Any, **options: Any) -> PortSubscriber:
        return self._proxy.subscriber(self, *args, **options)
