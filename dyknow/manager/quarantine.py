"""What failed lately is left alone for a while, longer each time."""

from __future__ import annotations

from typing import Callable, Dict, FrozenSet, Set, Tuple

#: Seconds of the first pause; the first failure of all has none.
FIRST_PAUSE = 1.0
LONGEST_PAUSE = 60.0
#: Seconds without a failure after which the past is forgiven.
FORGIVEN_AFTER = 120.0


class Quarantine:
    """Failures by name, with pauses that grow; and nodelets that are not to be relied on."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Count on a clock of steady seconds."""
        self._clock = clock
        self._failures: Dict[str, Tuple[int, float]] = {}
        self._distrusted: Set[str] = set()

    def blame(self, name: str) -> None:
        """Count a failure."""
        now = self._clock()
        count, last = self._failures.get(name, (0, now))
        self._failures[name] = (1 if now - last > FORGIVEN_AFTER else count + 1, now)

    def allows(self, name: str) -> bool:
        """Whether its pause is over."""
        count, last = self._failures.get(name, (0, 0.0))
        if count < 2:
            return True
        return self._clock() - last >= min(LONGEST_PAUSE, FIRST_PAUSE * 2.0 ** (count - 2))

    def labels(self) -> FrozenSet[str]:
        """Names whose pause is not over."""
        return frozenset(name for name in self._failures if not self.allows(name))

    def distrust(self, nodelet: str) -> None:
        """Use this nodelet no more, though it runs."""
        self._distrusted.add(nodelet)

    def is_distrusted(self, nodelet: str) -> bool:
        """Whether the nodelet is not to be used."""
        return nodelet in self._distrusted

    def distrusted(self) -> FrozenSet[str]:
        """Nodelets that are not to be used."""
        return frozenset(self._distrusted)
