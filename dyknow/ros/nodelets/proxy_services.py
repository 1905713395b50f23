# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The three services of a nodelet's proxy, in the nodelet's own namespace."""

from __future__ import annotations

from typing import Any, Callable, Protocol, Sequence

import rospy
from dyknow_msgs import srv

from dyknow import names
from dyknow.errors import DyKnowError
from dyknow.model.graph import PortState
from dyknow.model.statistics import NodeletStatistics
from dyknow.nodelet.middleware import Closable
from dyknow.nodelet.texts import sendable
from dyknow.ros.nodelets.process_guards import caller_of
from dyknow.ros.transport.registrar import services_together
from dyknow.ros.wire.messages import config_pairs, port_message, statistics_message

#: Characters of one text in the log. A list of problems may have many lines.
_LONGEST = 4096


class Proxy(Protocol):
    """A nodelet's proxy, or a substitute of it; ``set_config`` raises DyKnowError."""

    @property
    def name(self) -> str: ...

    def get_config(self) -> list[PortState]: ...

    def set_config(self, config: Sequence[tuple[str, str]]) -> None: ...

    def get_statistics(self) -> NodeletStatistics: ...


class ProxyServices(Closable):
    """Offers get_config, set_config and get_statistics until it is closed.

    They are answered on rospy's threads, not on the nodelet's queue: a nodelet whose callback
    hangs can still be inspected and re-wired.

    Args:
        proxy: answers them.
        check_caller: raises Denied if this node must not make a change, which the second
            argument describes.
    """

    def __init__(
        self, proxy: Proxy, check_caller: Callable[[str, str], None] = lambda caller, what: None
    ) -> None:
        self._proxy = proxy
        self._check_caller = check_caller
        self._services: list[Any] = []
        self._closed = False
        try:
            with services_together():
                self._offer("get_config", srv.GetConfig, self._get_config)
                self._offer("set_config", srv.SetConfig, self._set_config)
                self._offer("get_statistics", srv.GetStatistics, self._get_statistics)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self._closed = True
        while self._services:
            self._services.pop().shutdown("the nodelet is unloaded")

    def _offer(self, name: str, service_class: Any, handler: Callable[[Any], Any]) -> None:
        def answer(request: Any) -> Any:
            if self._closed:  # a persistent connection, which rospy keeps when a service ends
                raise rospy.ServiceException(f"nodelet {self._proxy.name} is unloaded")
            return handler(request)

        full_name = names.join(self._proxy.name, name)
        self._services.append(rospy.Service(full_name, service_class, answer))

    def _get_config(self, request: Any) -> srv.GetConfigResponse:
        return srv.GetConfigResponse([port_message(port) for port in self._proxy.get_config()])

    def _set_config(self, request: Any) -> srv.SetConfigResponse:
        caller, name = caller_of(request), self._proxy.name
        config = config_pairs(request.config)
        try:
            self._check_caller(caller, f"connecting ports of '{name}'")
            self._proxy.set_config(config)
        except DyKnowError as error:
            rospy.logerr("%s: set_config of %s: %s", name, for_log(caller), for_log(error))
            return srv.SetConfigResponse(False, sendable(error))
        made = ", ".join(f"'{port}' to {topic or 'nothing'}" for port, topic in config)
        rospy.loginfo("%s: %s connected %s", name, for_log(caller), for_log(made))
        return srv.SetConfigResponse(True, "")

    def _get_statistics(self, request: Any) -> srv.GetStatisticsResponse:
        return statistics_message(self._proxy.get_statistics())


def for_log(text: object) -> str:
    """Return a text for the log; of a long one its beginning and its length."""
    words = str(text)
    if len(words) <= _LONGEST:
        return words
    return f"{words[:_LONGEST]}… ({len(words)} characters)"
