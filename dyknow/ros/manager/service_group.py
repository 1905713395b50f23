# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The services of the DyKnow manager: offered together, and answered in the same way."""

from __future__ import annotations

import logging
from typing import Any, Callable, List, Optional

import rospy

from dyknow.errors import DyKnowError
from dyknow.ros.log_text import for_log
from dyknow.ros.nodelets.guard_parameters import caller_of

_log = logging.getLogger("rosout.dyknow")

Handler = Callable[[Any], Any]


class ServiceGroup:
    """Private services of the node, until they are closed together."""

    def __init__(self, after_change: Callable[[], None], remark: Callable[[], str]) -> None:
        """Begin without a service.

        Args:
            after_change: called after each attempt to change something, before it is answered.
            remark: what the answer to a change has to add; empty for nothing.
        """
        self._after_change = after_change
        self._remark = remark
        self._services: List[Any] = []

    def offer(self, name: str, service_class: Any, handler: Handler) -> None:
        """Offer one service.

        Args:
            name: its private name, without ``~``.
            service_class: its type.
            handler: returns the response to a request.
        """
        service = rospy.Service(f"~{name}", service_class, self._with_remark(handler))
        self._services.append(service)

    def close(self) -> None:
        """Withdraw the services."""
        while self._services:
            self._services.pop().shutdown("the manager ends")

    def attempt(
        self, request: Any, what: str, action: Callable[[], object]
    ) -> Optional[Exception]:
        """Do what a request asks for, and log it; returns why it did not work, or None.

        Args:
            request: as it came.
            what: what it asks for, for the log.
            action: does it.
        """
        what, caller = for_log(what), for_log(caller_of(request))
        try:
            try:
                action()
            finally:
                self._after_change()
        except DyKnowError as error:
            rospy.logwarn("%s for %s: refused: %s", what, caller, for_log(error))
            return error
        except Exception as error:  # the boundary of the service
            _log.exception("%s for %s failed", what, caller)
            return DyKnowError(f"internal error: {type(error).__name__}: {error}")
        rospy.loginfo("%s for %s: done", what, caller)
        return None

    def _with_remark(self, handler: Handler) -> Handler:
        """Add the remark to answers that say that something was done."""

        def answer(request: Any) -> Any:
            response = handler(request)
            if getattr(response, "success", False) and not getattr(request, "dry_run", False):
                response.message = "\n".join(filter(None, (response.message, self._remark())))
            return response

        return answer
