# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Collects the problems of a text, so that all are reported at once, and words them.

Messages quote the text; long texts and long lists are shortened.
"""

from __future__ import annotations

from typing import Collection, Iterable

from dyknow.errors import Problem, SpecificationError
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.similar import did_you_mean

#: Characters of a quoted text, names in a quoted list.
_TEXT = 60
_NAMES = 20
#: No suggestion is made among more known names: a program wrote them.
_FEW = 100
#: A problem in a template may come once for each of its expansions, at most this often.
_MAX_REPETITIONS = 200_000


class EnoughProblems(Exception):
    """Reading ends: there are too many problems, or the rest cannot be understood."""


class Findings:
    """The problems and warnings of one text, each once."""

    def __init__(self, file: str, limits: SpecificationLimits = DEFAULT_LIMITS) -> None:
        self.limits = limits  # the caps that the text has to hold
        self._file = file
        self._problems: dict[Problem, None] = {}
        self._warnings: dict[Problem, None] = {}
        self._rest: tuple[Problem, ...] = ()
        self._repetitions = 0

    def problem(self, line: int, message: str) -> None:
        """Note an error; EnoughProblems if the list is full, or problems repeat too often."""
        problem = Problem(self._file, line, message)
        if problem in self._problems:
            self._repetitions += 1
            if self._repetitions > _MAX_REPETITIONS:
                raise EnoughProblems
            return
        if len(self._problems) >= self.limits.problems:
            rest = f"there are more than {self.limits.problems} problems; the rest is not listed"
            self._rest = (Problem(self._file, line, rest),)
            raise EnoughProblems
        self._problems[problem] = None

    def warning(self, line: int, message: str) -> None:
        """Note something doubtful that is accepted; dropped when the list is full."""
        if len(self._warnings) < self.limits.problems:
            self._warnings[Problem(self._file, line, message)] = None

    @property
    def problems(self) -> tuple[Problem, ...]:
        """The errors by line, those of one line as they were found."""
        return tuple(sorted(self._problems, key=lambda problem: problem.line)) + self._rest

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """The warnings by line."""
        return tuple(sorted(self._warnings, key=lambda problem: problem.line))

    def raise_if_any(self) -> None:
        """Raise SpecificationError with every error and warning if an error was noted."""
        if self._problems:
            raise SpecificationError(self.problems, self.warnings)


def shorten(text: str) -> str:
    return text if len(text) <= _TEXT else text[:_TEXT] + "…"


def listed(names: Iterable[str]) -> str:
    """List names, sorted; `none` if there are none."""
    known = sorted(names)
    more = f" and {len(known) - _NAMES} more" if len(known) > _NAMES else ""
    return (", ".join(shorten(name) for name in known[:_NAMES]) or "none") + more


def meant(name: str, known: Collection[str]) -> str:
    """Suggest a similar name, or return an empty text."""
    return did_you_mean(name, known) if len(known) <= _FEW else ""
