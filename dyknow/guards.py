# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Restrictions on changes, enforced by the manager and by each proxy.

The manager hands its guards to its nodelet managers, since a call to a proxy does not pass through
the manager. A nodelet manager that several managers share is under the guards of all of them.
"""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass, field
from typing import Iterable

from dyknow.errors import Denied, LimitExceeded

#: Why a process refuses each set_config of its nodelets, and of itself if it is a node.
NOT_REWIRABLE = "their process is not to be re-wired (parameter ~rewirable)"
#: Topics of every process, which no allow list has to name.
SYSTEM_TOPICS = frozenset(("/rosout", "/rosout_agg", "/clock"))


@dataclass(frozen=True)
class Guards:
    """Restrictions on changes.

    Attributes:
        denied_topics: patterns (``/robot/*/cmd_vel``) of topics that nothing may be connected to.
        allowed_topics: lists of patterns, one of each manager that has one: a topic has to match
            a pattern of every list.
        allowed_programs: lists of patterns (``my_robot/*``) likewise, for the programs and scripts
            (``package/executable``) that may be started.
        remote_programs: whether services may start other programs and scripts than those of the
            manager's own specification files.
        read_only: refuse every change.
        string_length: characters in one string of a request.
        array_length: entries in one array of a request.
        nodelets: nodelets that may run at the same time.
    """

    denied_topics: tuple[str, ...] = field(default=())
    allowed_topics: tuple[tuple[str, ...], ...] = ()
    allowed_programs: tuple[tuple[str, ...], ...] = ()
    remote_programs: bool = True
    read_only: bool = False
    string_length: int = 4096
    array_length: int = 1024
    nodelets: int = 2000

    def check_writable(self, what: str) -> None:
        """Refuse ``what`` in read-only mode."""
        if self.read_only:
            raise Denied(what, "DyKnow runs read-only (parameter read_only)")

    def check_topic(self, topic: str) -> None:
        """Refuse a topic of the deny list, and one that is not on an allow list.

        The empty one, of a port that is not connected, is allowed.
        """
        if not topic:
            return
        for pattern in self.denied_topics:
            if fnmatch.fnmatchcase(topic, pattern):
                raise Denied(
                    f"topic '{topic}'", f"it matches '{pattern}' of the deny list (denied_topics)"
                )
        if topic not in SYSTEM_TOPICS:
            _check_allowed(f"topic '{topic}'", topic, self.allowed_topics, "allowed_topics")

    def check_program(self, program: str, is_own: bool = False) -> None:
        """Refuse a program; ``is_own``: a specification file of the manager itself names it."""
        what = f"program '{program}'"
        _check_allowed(what, program, self.allowed_programs, "allowed_programs")
        if not (self.remote_programs or is_own):
            raise Denied(
                what,
                "services start only programs that the manager's own specification files name "
                "(parameter remote_programs)",
            )

    def check_sizes(self, strings: Iterable[str], entries: int = 0) -> None:
        """Refuse strings and arrays beyond the limits."""
        if entries > self.array_length:
            raise LimitExceeded("entries in an array", entries, self.array_length)
        for text in strings:
            if len(text) > self.string_length:
                raise LimitExceeded("characters in a string", len(text), self.string_length)


def _check_allowed(
    what: str, name: str, allowed: Iterable[tuple[str, ...]], parameter: str
) -> None:
    for patterns in allowed:
        if not any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns):
            raise Denied(what, f"it matches no pattern of the allow list ({parameter})")


NO_GUARDS = Guards()
"""Nothing is denied."""


def together(several: Iterable[Guards]) -> Guards:
    """Return guards that deny everything that one of several denies."""
    every = list(several)
    if not every:
        return NO_GUARDS
    return Guards(
        denied_topics=tuple(sorted({each for one in every for each in one.denied_topics})),
        allowed_topics=tuple(sorted({each for one in every for each in one.allowed_topics})),
        allowed_programs=tuple(sorted({each for one in every for each in one.allowed_programs})),
        remote_programs=all(one.remote_programs for one in every),
        read_only=any(one.read_only for one in every),
        string_length=min(one.string_length for one in every),
        array_length=min(one.array_length for one in every),
        nodelets=min(one.nodelets for one in every),
    )
