# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Health: the nodelets and claims that are not well, and the contact with master and manager."""

from __future__ import annotations

import time
from typing import Callable, Iterable, Mapping, NamedTuple

from dyknow.model.graph import PortRef, State
from dyknow.model.streams import ClaimState, StreamStatus
from dyknow.periodic import RunningClock
from dyknow_rqt.graph.measurements import PortRate
from dyknow_rqt.graph.snapshot import Snapshot

_OF_NODELETS = {State.LOST: "lost", State.FAILED: "failed"}
_OF_CLAIMS = {
    ClaimState.FAILED: "failed",
    ClaimState.DEGRADED: "degraded",
    ClaimState.RECOVERING: "degraded",
    ClaimState.PENDING: "waiting",
}
#: The words, the worst first; a nodelet is slow if messages are dropped at its in-ports.
_WORDS = ("lost", "failed", "degraded", "slow", "waiting")


class Ill(NamedTuple):
    """A nodelet, by its name, or a claim, by its id, that is not well; the title is for people."""

    word: str
    title: str
    nodelet: str = ""
    claim: str = ""


def ills_of(
    snapshot: Snapshot, streams: Iterable[StreamStatus], traffic: Mapping[PortRef, PortRate]
) -> list[Ill]:
    """List the nodelets and claims in a bad state, the worst first, each once."""
    slow = {ref.nodelet for ref, each in traffic.items() if each.drop_rate > 0}
    words = {name: "slow" for name in slow}
    sick = (each for each in snapshot.nodelets if each.state in _OF_NODELETS)
    words.update((each.name, _OF_NODELETS[each.state]) for each in sick)
    ills = [Ill(word, name, nodelet=name) for name, word in words.items()]
    ills += [
        Ill(_OF_CLAIMS[each.state], each.bound_tag, claim=each.claim_id)
        for each in streams
        if each.state in _OF_CLAIMS
    ]
    return sorted(ills, key=lambda ill: (_WORDS.index(ill.word), ill))


#: Seconds without a word after which the manager, which counts aloud, and the master are silent.
PATIENCE, _MASTER_PATIENCE = 1.6, 2.5


class Status(NamedTuple):
    """The contact at one moment, in a few words, and with its meaning for the shown graph.

    It is current if the manager answers, and sound if the master answers too and knows it.
    """

    is_current: bool
    is_sound: bool
    short: str
    text: str


class _Peer:
    """When a peer answered last, and whether it refused since."""

    def __init__(self, clock: Callable[[], float], patience: float) -> None:
        self._clock = clock
        self._patience = patience
        self._since = clock()
        self.was_heard = self.is_gone = False

    @property
    def silence(self) -> float:
        """Seconds since its last answer, or since the beginning."""
        return self._clock() - self._since

    @property
    def is_well(self) -> bool:
        return self.was_heard and not (self.is_gone or self.is_silent)

    @property
    def is_silent(self) -> bool:
        return self.silence >= self._patience

    def hear(self) -> None:
        self._since, self.was_heard, self.is_gone = self._clock(), True, False


class Contact:
    """Notes who answered, in the thread where the answer came, and says what that means."""

    def __init__(
        self,
        manager: str,
        master: str,
        clock: Callable[[], float] | None = None,
        now: Callable[[], float] = time.time,
    ) -> None:
        """``clock`` counts the seconds for which the window has run, ``now`` those on the wall."""
        self._manager, self._master, self._now = manager, master, now
        clock = clock or RunningClock()
        self._of_manager, self._of_master = _Peer(clock, PATIENCE), _Peer(clock, _MASTER_PATIENCE)
        self._is_known = True
        self._since = 0.0

    def hear_manager(self) -> None:
        """Note that the manager answered, or announced something."""
        if not self._of_manager.is_well:
            self._since = self._now()
        self._of_manager.hear()

    def miss_manager(self, is_gone: bool) -> None:
        """Note that it did not answer; ``is_gone`` says that no process is there to answer."""
        self._of_manager.is_gone = is_gone

    def hear_master(self, is_known: bool) -> None:
        """Note that the master answered; ``is_known`` says whether it knows the manager."""
        self._of_master.hear()
        self._is_known = is_known

    def miss_master(self, is_gone: bool) -> None:
        self._of_master.is_gone = is_gone

    def status(self) -> Status:
        manager, master = self._of_manager, self._of_master
        complaints, advice = [], ""
        if master.is_gone or master.is_silent:
            complaints.append(f"no ROS master at {self._master}{_for(master)}")
            advice = "; nothing new can be asked for"
        elif not self._is_known and manager.is_well:
            complaints.append(f"the ROS master at {self._master} does not know {self._manager}")
            advice = ": a new roscore; its nodes are registered again within seconds"
        if manager.is_well:
            if not complaints:
                moment = time.strftime("%H:%M:%S", time.localtime(self._since))
                fine = f"{self._manager} answers since {moment}"
                return Status(True, True, fine, f"{fine}; ROS master at {self._master}")
            (short,) = complaints
            return Status(True, False, short, f"{short}; {self._manager} answers{advice}")
        if not manager.was_heard:
            complaints.append(f"waiting for {self._manager}")
            return Status(False, False, complaints[0], "; ".join(complaints))
        state = "gone" if manager.is_gone else "silent"
        complaints.append(f"{self._manager} {state}{_for(manager)}")
        aged = f"{'; '.join(complaints)}: what is shown is that old"
        return Status(False, False, complaints[-1], aged)


def _for(peer: _Peer) -> str:
    """For how long it has been silent, if it was heard before."""
    return f" for {_duration(peer.silence)}" if peer.was_heard else ""


def _duration(seconds: float) -> str:
    for unit, length in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"
