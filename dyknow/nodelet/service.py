# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Services of nodelets: asked on any thread, answered on the nodelet's queue."""

from __future__ import annotations

import queue
from typing import Any, Callable, Dict, Optional, Set, Tuple

from dyknow.errors import HandleClosed
from dyknow.nodelet.context import Context
from dyknow.nodelet.middleware import Closable

_Reply = Tuple[Any, Optional[BaseException]]


class Service(Closable):
    """An offered service; use it as a ``rospy.Service``."""

    def __init__(
        self,
        context: Context,
        resolved_name: str,
        service_class: Any,
        handler: Callable[[Any], Any],
        concurrent: bool,
        options: Dict[str, Any],
    ) -> None:
        """Offer a service under a global name.

        Args:
            context: the nodelet that answers.
            resolved_name: global name.
            service_class: class with the request and response types.
            handler: makes the response of a request, with rospy's rules for what it returns.
            concurrent: whether calls may overlap with each other and with other callbacks.
            options: further arguments of ``rospy.Service`` that were given.
        """
        self.resolved_name = resolved_name
        self.service_class = service_class
        self.handler = handler
        self._context = context
        self._concurrent = concurrent
        self._waiting: Set[queue.SimpleQueue[Optional[_Reply]]] = set()
        self._offered = context.runtime.services.offer(
            resolved_name, service_class, self._ask, options
        )
        context.close_with(self)

    def shutdown(self, reason: str = "") -> None:
        """Withdraw the service; callers that still wait get an error."""
        self._context.forget(self)
        self.close()

    def close(self) -> None:
        """Withdraw the service, as part of the unload."""
        self._offered.close()
        self.handler = _withdrawn  # the handler refers to the nodelet, and that to the service
        for reply in list(self._waiting):
            reply.put(None)

    def _ask(self, request: Any) -> Any:
        context = self._context
        reply: queue.SimpleQueue[Optional[_Reply]] = queue.SimpleQueue()
        self._waiting.add(reply)
        strand = context.new_strand(self.resolved_name) if self._concurrent else context.strand
        try:
            strand.post(lambda: reply.put(self._answer(request)))
            outcome = None if context.closed else reply.get()
        finally:
            self._waiting.discard(reply)
            if self._concurrent:
                context.drop_strand(strand)
        if outcome is None:
            raise context.runtime.node.interrupted(
                f"service '{self.resolved_name}': nodelet {context.name} was unloaded"
            )
        response, error = outcome
        try:
            if error is not None:
                raise error
            return response
        finally:
            del error, outcome  # its traceback refers to this frame

    def _answer(self, request: Any) -> _Reply:
        try:
            return self.handler(request), None
        except Exception as error:  # the boundary: raised again where the caller waits
            self._context.callback_errors += 1
            return None, error
        except BaseException as error:  # sys.exit(): must end neither this worker nor the caller
            self._context.failed(f"service '{self.resolved_name}'", error)
            return None, RuntimeError(f"the handler raised {type(error).__name__}: {error}")


def _withdrawn(request: Any) -> Any:
    raise HandleClosed("the service")
