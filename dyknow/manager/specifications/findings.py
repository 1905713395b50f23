"""What a parser has found so far: it goes on after a problem, so that all are told at once."""

from __future__ import annotations

from typing import Dict, Tuple

from dyknow.errors import Problem, SpecificationError

_MAX_REPETITIONS = 200_000
"""A problem in a template may come once for each of its expansions, at most this often."""


class EnoughProblems(Exception):
    """So many problems are known that looking for more helps nobody."""


class Findings:
    """Collects the problems and warnings of one text; the same one twice counts once."""

    def __init__(self, file: str, max_problems: int) -> None:
        self._file = file
        self._max = max_problems
        self._problems: Dict[Problem, None] = {}
        self._warnings: Dict[Problem, None] = {}
        self._rest: Tuple[Problem, ...] = ()
        self._repetitions = 0

    def problem(self, line: int, message: str) -> None:
        """Note an error.

        Raises:
            EnoughProblems: As many as may be listed were known before this one, or the same
                ones come again and again.
        """
        problem = Problem(self._file, line, message)
        if problem in self._problems:
            self._repetitions += 1
            if self._repetitions > _MAX_REPETITIONS:
                raise EnoughProblems
            return
        if len(self._problems) >= self._max:
            rest = f"there are more than {self._max} problems; the rest is not listed"
            self._rest = (Problem(self._file, line, rest),)
            raise EnoughProblems
        self._problems[problem] = None

    def warning(self, line: int, message: str) -> None:
        """Note something doubtful that is accepted; beyond the maximum they are dropped."""
        if len(self._warnings) < self._max:
            self._warnings[Problem(self._file, line, message)] = None

    @property
    def problems(self) -> Tuple[Problem, ...]:
        """The errors by line, those of one line as they were found."""
        return tuple(sorted(self._problems, key=lambda problem: problem.line)) + self._rest

    @property
    def warnings(self) -> Tuple[Problem, ...]:
        """The warnings by line."""
        return tuple(sorted(self._warnings, key=lambda problem: problem.line))

    def raise_if_any(self) -> None:
        """Refuse the text if an error was noted.

        Raises:
            SpecificationError: With every error and warning.
        """
        if self._problems:
            raise SpecificationError(self.problems, self.warnings)
