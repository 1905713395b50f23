# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Restrictions on changes, enforced by the manager and by each proxy.

The manager hands its guards to its nodelet managers, since a call to a proxy does not pass through
the manager. A nodelet manager that several managers share is under the guards of all of them.
"""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass, field
from typing import Iterable, Tuple

from dyknow.errors import Denied, LimitExceeded


@dataclass(frozen=True)
class Guards:
    """Restrictions on changes.

    Attributes:
        denied_topics: patterns (``/robot/*/cmd_vel``) of topics that no port may be connected to.
        read_only: refuse every change.
        string_length: characters in one string of a request.
        array_length: entries in one array of a request.
        nodelets: nodelets that may run at the same time.
    """

    denied_topics: Tuple[str, ...] = field(default=())
    read_only: bool = False
    string_length: int = 4096
    array_length: int = 1024
    nodelets: int = 2000

    def check_writable(self, what: str) -> None:
        """Refuse ``what`` in read-only mode.

        Raises:
            Denied: the mode is read-only.
        """
        if self.read_only:
            raise Denied(what, "DyKnow runs read-only (parameter read_only)")

    def check_topic(self, topic: str) -> None:
        """Refuse a topic of the deny list.

        Raises:
            Denied: a pattern matches.
        """
        for pattern in self.denied_topics:
            if fnmatch.fnmatchcase(topic, pattern):
                raise Denied(
                    f"topic '{topic}'", f"it matches '{pattern}' of the deny list (denied_topics)"
                )

    def check_sizes(self, strings: Iterable[str], entries: int = 0) -> None:
        """Refuse strings and arrays beyond the limits.

        Raises:
            LimitExceeded: a string or an array is too long.
        """
        if entries > self.array_length:
            raise LimitExceeded("entries in an array", entries, self.array_length)
        for text in strings:
            if len(text) > self.string_length:
                raise LimitExceeded("characters in a string", len(text), self.string_length)


NO_GUARDS = Guards()
"""Nothing is denied."""


def together(several: Iterable[Guards]) -> Guards:
    """Return guards that deny everything that one of several denies."""
    every = list(several)
    if not every:
        return NO_GUARDS
    return Guards(
        denied_topics=tuple(sorted({each for one in every for each in one.denied_topics})),
        read_only=any(one.read_only for one in every),
        string_length=min(one.string_length for one in every),
        array_length=min(one.array_length for one in every),
        nodelets=min(one.nodelets for one in every),
    )
