# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The base class of nodelets."""

from __future__ import annotations

from typing import List, Optional

from dyknow import names
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle


class Nodelet:
    """Derive from this, set things up in ``on_init`` and return; callbacks do the rest.

    ``on_init`` runs once, before any callback; what it raises makes the load fail and is the
    answer to the request. ``on_shutdown`` runs once at the unload, which waits for it at most 1 s.
    """

    _context: Optional[Context] = None

    def on_init(self) -> None:
        """Create publishers, subscribers, timers and services here."""
        raise NotImplementedError(f"{type(self).__name__} does not define on_init()")

    def on_shutdown(self) -> None:
        """Put away what is not made through a handle; publishing still works here."""

    def bind(self, context: Context) -> None:
        """Give the nodelet its place; the loader calls this before ``on_init``."""
        self._context = context

    @property
    def context(self) -> Context:
        """The nodelet's share of the runtime."""
        if self._context is None:
            raise RuntimeError(
                f"{type(self).__name__} has no name and no handles before on_init(): "
                "set up there, not in __init__()"
            )
        return self._context

    @property
    def name(self) -> str:
        """Global name."""
        return self.context.name

    @property
    def my_argv(self) -> List[str]:
        """Arguments of the load request."""
        return list(self.context.my_argv)

    @property
    def node_handle(self) -> PlainNodeHandle:
        """Handle in the namespace that the nodelet stands in; callbacks never overlap."""
        return PlainNodeHandle(self.context, names.parent(self.name))

    @property
    def private_node_handle(self) -> PlainNodeHandle:
        """Handle in the nodelet's own namespace; callbacks never overlap."""
        return PlainNodeHandle(self.context, self.name)

    @property
    def mt_node_handle(self) -> PlainNodeHandle:
        """Like ``node_handle``; callbacks of different subscriptions may overlap."""
        return PlainNodeHandle(self.context, names.parent(self.name), concurrent=True)

    @property
    def mt_private_node_handle(self) -> PlainNodeHandle:
        """Like ``private_node_handle``; callbacks of different subscriptions may overlap."""
        return PlainNodeHandle(self.context, self.name, concurrent=True)
