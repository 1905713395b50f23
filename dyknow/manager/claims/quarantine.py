"""What fails again and again is left alone for a while, longer each time."""

from __future__ import annotations

from typing import Callable, Dict, FrozenSet, Tuple

#: Seconds of the first pause; the first failure of all has none.
FIRST_PAUSE = 1.0
LONGEST_PAUSE = 60.0
#: Seconds after which a failure is forgotten whatever came of it.
LONG_AGO = 3600.0
#: Seconds of good service after which earlier failures are forgiven.
GOOD_SERVICE = 10.0


class Quarantine:
    """Failures by name, with pauses that grow."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Count on a clock of steady seconds."""
        self._clock = clock
        self._failures: Dict[str, Tuple[int, float]] = {}

    def blame(self, name: str, served: float = 0.0) -> None:
        """Count a failure, after so many seconds of good service."""
        now = self._clock()
        for each in [
            each for each, (_, last) in list(self._failures.items()) if now - last > LONG_AGO
        ]:
            self._failures.pop(each, None)
        count, _ = self._failures.get(name, (0, 0.0))
        self._failures[name] = (1 if served >= GOOD_SERVICE else count + 1, now)

    def forgive(self, name: str) -> None:
        """Forget all failures of a name."""
        self._failures.pop(name, None)

    def allows(self, name: str) -> bool:
        """Whether its pause is over."""
        count, last = self._failures.get(name, (0, 0.0))
        if count < 2:
            return True
        return self._clock() - last >= min(LONGEST_PAUSE, FIRST_PAUSE * 2.0 ** min(count - 2, 16))

    def names(self) -> FrozenSet[str]:
        """Names whose pause is not over."""
        names = list(self._failures)  # deaths are counted on the thread that looks
        return frozenset(name for name in names if not self.allows(name))
