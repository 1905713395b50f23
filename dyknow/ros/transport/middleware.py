# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The seam to ROS, over rospy."""

from __future__ import annotations

import functools
import logging
import traceback
from typing import Any, Sequence

import rospy

from dyknow.errors import PeerTimeout
from dyknow.locks import assert_no_state_lock
from dyknow.nodelet.loading.memory import clear_frames
from dyknow.nodelet.middleware import (
    Closable,
    Codec,
    Converter,
    Handler,
    Middleware,
    Parameter,
    Receive,
    Services,
    Transport,
)
from dyknow.nodelet.scheduler import Executor
from dyknow.nodelet.texts import encodable
from dyknow.ros.transport import images
from dyknow.ros.transport.conversions import (
    built,
    digest,
    has_arrays,
    in_class,
    packed,
    receive_in_class,
)
from dyknow.ros.transport.intraprocess import IntraProcess
from dyknow.ros.transport.node import RospyNode, make_ticker
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.transport.shared_memory import SharedMemory
from dyknow.ros.transport.topics import RospyPublisher, RospySubscriber
from dyknow.ros.wire.ages_and_sizes import age_of, size_of
from dyknow.ros.wire.master import Master

#: Not below "rosout": to publish there rospy asks the master about a parameter first.
_log = logging.getLogger("dyknow.master")


def rospy_middleware(executor: Executor, shared_memory: bool) -> Middleware:
    """Make the middleware of this process; the node must be initialised.

    ``executor`` runs callbacks of ordinary rospy subscribers. With ``shared_memory`` large
    messages reach other processes of this host through memory.
    """
    transport = RospyTransport(executor, shared_memory)
    return Middleware(transport, RospyServices(), make_ticker(), RospyNode())


class RospyTransport(Transport):
    """Topics, as the nodelets of this process see them."""

    def __init__(self, executor: Executor, shared_memory: bool) -> None:
        self._shared_memory = SharedMemory.start(shared_memory)
        self._intraprocess = IntraProcess(executor, self._shared_memory)
        self._registrar = Registrar()

    def advertise(
        self,
        topic: str,
        datatype: Any,
        latch: bool,
        queue_size: int | None,
        options: dict[str, Any],
    ) -> RospyPublisher:
        assert_no_state_lock(f"advertising {topic}")
        return RospyPublisher(
            self._intraprocess,
            self._shared_memory,
            self._registrar,
            topic,
            datatype,
            latch,
            queue_size,
            options,
        )

    def subscribe(
        self, topic: str, datatype: Any, receive: Receive, options: dict[str, Any]
    ) -> RospySubscriber:
        assert_no_state_lock(f"subscribing to {topic}")
        return RospySubscriber(self._registrar, topic, datatype, receive, options)

    def datatype_of(self, topic: str) -> str:
        """Ask the master; a master that does not answer knows nothing."""
        try:
            found = Master(rospy.get_name()).datatype(topic)
        except PeerTimeout as error:
            _log.warning("the type of %s is not checked: %s", topic, error)
            return ""
        return "" if found == "*" else found

    def is_published(self, topic: str) -> bool:
        try:
            return bool(Master(rospy.get_name()).publishers(topic))
        except (PeerTimeout, LookupError):
            return False

    def build(self, datatype: Any, args: Sequence[Any], kwds: dict[str, Any]) -> Any:
        return built(datatype, args, kwds)

    def digest(self, message: Any) -> bytes:
        return digest(message)

    def pack(self, message: Any) -> bytes:
        return packed(message)

    def unpack(self, datatype: Any, content: bytes) -> Any:
        return datatype().deserialize(content)

    def sample_of(self, message: Any) -> tuple[float | None, int]:
        return age_of(message), size_of(message)

    def codec(self, datatype: Any, parameter: Parameter) -> Codec | None:
        return images.codec(datatype, parameter)

    def converter(self, datatype: Any) -> Converter | None:
        return in_class if has_arrays(datatype) else None

    def adapt(self, datatype: Any, receive: Receive) -> Receive:
        """Give subscribers of ``rospy.AnyMsg`` and ``numpy_msg`` the messages that they expect."""
        return receive_in_class(datatype, receive)


class RospyServices(Services):
    """Services, offered by rospy."""

    def offer(
        self,
        service: str,
        service_class: Any,
        handler: Handler,
        options: dict[str, Any],
        owner: str,
    ) -> Closable:
        assert_no_state_lock(f"offering {service}")
        return _Service(service, service_class, handler, options, owner)


class _Service(Closable):
    def __init__(
        self,
        name: str,
        service_class: Any,
        handler: Handler,
        options: dict[str, Any],
        owner: str,
    ) -> None:
        report = options.get("error_handler") or functools.partial(_log_failure, name, owner)

        def failed(error: Any, error_type: Any, value: Any, trace: Any) -> None:
            report(error, error_type, value, trace)
            clear_frames(error)  # rospy's frame refers to the traceback, and that to all of them

        options = {**options, "error_handler": failed}
        handler = functools.partial(_answer, handler)
        self._service = rospy.Service(name, service_class, handler, **options)

    def close(self) -> None:
        if self._service is not None:
            service, self._service = self._service, None
            service.shutdown("closed")


def _answer(handler: Handler, request: Any) -> Any:
    """Call a handler; make its error one that rospy can send, else the client waits."""
    try:
        return handler(request)
    except Exception as error:
        text = str(error)
        if encodable(text) == text:
            raise
        if isinstance(error, rospy.ServiceException):
            raise rospy.ServiceException(encodable(text)) from error
        raise RuntimeError(encodable(f"{type(error).__name__}: {text}")) from error


def _log_failure(
    service: str, owner: str, error: Any, error_type: Any, value: Any, trace: Any
) -> None:
    """Log the exception of a handler; rospy's own entry does not name the service."""
    trace = "".join(traceback.format_exception(error_type, value, trace))
    text, by = encodable(f"{error}\n{trace}"), {"nodelet": owner}
    rospy.logerr("the handler of service %s raised: %s", service, text, extra=by)
