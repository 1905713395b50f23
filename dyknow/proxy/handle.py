"""The DyKnow NodeHandle: the plain one, with ports where that has topics."""

from __future__ import annotations

from typing import Any, Callable, Dict, Optional

from dyknow.nodelet.handle import DEFAULT_BUFF_SIZE, Inbox, Publisher, Subscriber
from dyknow.nodelet.handle import NodeHandle as PlainNodeHandle
from dyknow.proxy.proxy import NodeletProxy, ProxyStatistics, ReconfigureCallback


class NodeHandle:
    """Wraps a plain handle of a nodelet; everything but topics is handed on to it.

    All handles of one nodelet share one proxy, so a port is the same port in each of them.
    """

    def __init__(self, node_handle: PlainNodeHandle) -> None:
        """Wrap one of the nodelet's own handles, such as ``self.node_handle``."""
        if not isinstance(node_handle, PlainNodeHandle):
            raise TypeError(
                "dyknow.NodeHandle expects a handle of the nodelet, such as self.node_handle, "
                f"not {type(node_handle).__name__}"
            )
        self._plain = node_handle
        self._proxy = NodeletProxy.of(node_handle.context)

    def __getattr__(self, name: str) -> Any:
        """Hand everything else on to the plain handle."""
        if name.startswith("__") or name == "_plain":
            raise AttributeError(name)
        return getattr(self._plain, name)

    def Publisher(  # noqa: N802
        self,
        name: str,
        data_class: Any,
        subscriber_listener: Any = None,
        tcp_nodelay: bool = False,
        latch: bool = False,
        headers: Any = None,
        queue_size: Optional[int] = None,
    ) -> Publisher:
        """Declare the out-port ``name``; the arguments are those of ``rospy.Publisher``.

        It starts disconnected unless the load request remaps its name.
        """
        given: Dict[str, Any] = {}
        if headers:
            given["headers"] = headers
        if tcp_nodelay:
            given["tcp_nodelay"] = True
        state = self._proxy.publisher(
            self._plain, name, data_class, latch, queue_size, subscriber_listener, **given
        )
        return Publisher(state)

    def Subscriber(  # noqa: N802
        self,
        name: str,
        data_class: Any,
        callback: Optional[Callable[..., Any]] = None,
        callback_args: Any = None,
        queue_size: Optional[int] = None,
        buff_size: int = DEFAULT_BUFF_SIZE,
        tcp_nodelay: bool = False,
    ) -> Subscriber:
        """Declare the in-port ``name``; the arguments are those of ``rospy.Subscriber``.

        It starts disconnected unless the load request remaps its name.
        """
        given: Dict[str, Any] = {}
        if buff_size != DEFAULT_BUFF_SIZE:
            given["buff_size"] = buff_size
        state = self._proxy.subscriber(
            self._plain,
            name,
            data_class,
            callback,
            callback_args,
            queue_size,
            self._plain.concurrent,
            **given,
        )
        return Subscriber(state)

    def wait_for_message(
        self, topic: str, topic_type: Any, timeout: Optional[float] = None
    ) -> Any:
        """Block until a message arrives at the in-port ``topic``.

        The nodelet's queue is not needed for it.

        Raises:
            ROSException: nothing came within ``timeout`` seconds.
            ROSInterruptException: the nodelet was unloaded meanwhile.
        """
        inbox = Inbox(self._plain.context)
        state = self._proxy.subscriber(
            self._plain, topic, topic_type, inbox.put, None, 1, concurrent=True, at_once=True
        )
        try:
            return inbox.get(f"a message at port '{topic}'", timeout)
        finally:
            state.unregister(self)

    def get_statistics(self) -> ProxyStatistics:
        """What the nodelet and its ports have done since it was loaded.

        ``get_statistics`` tells the same to others: ``uptime``, ``reconfigurations``,
        ``callback_errors``, and for each of ``ports`` its ``port`` and its ``traffic``.
        """
        return self._proxy.get_statistics()

    def set_reconfigure_callback(self, callback: Optional[ReconfigureCallback]) -> None:
        """Call back when ports were connected elsewhere.

        The callback gets two maps from port to topic, of in-ports and of out-ports; a topic is
        empty where the port is disconnected. It runs on the nodelet's queue, after the last
        message of the old and before the first of the new connection. What it raises is logged
        and does not undo the switch.
        """
        self._proxy.set_reconfigure_callback(callback)
