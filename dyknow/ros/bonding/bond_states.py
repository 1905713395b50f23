# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The protocol of a bond as plain Python: no thread, no clock, no ROS.

A bond ties two processes together so that each learns when the other goes. Both say on one topic,
about once a second, that they are alive; each waits for the other at most so long. `BondEnd` is
our end of one bond:

    WAITING --alive--> ALIVE --dead, or silence--> DEAD
       |                 |
       |  part           +--part--> PARTING --dead, or too long--> DEAD
       +---------------------------^
       +--dead, or too long--> DEAD

The rules are those of bond_core's state machine (bondcpp, bondpy), with five differences that its
sisters cannot tell from ordinary traffic:

* Silence counts from the moment the sister was first heard, not from her second heartbeat; a
  sister that died in between would be waited for without end.
* An end that gives its sister up says "dead" once, so that a sister that was only suspended
  learns it at once.
* An end that parts before its sister was heard repeats "dead" for a while too: she may just be
  connecting, and would wait for the whole connect timeout.
* After the sister's death is acknowledged, the end lingers and acknowledges again while she
  repeats herself; the first answer may have been sent before she could hear it.
* An id can be used again at once: what former sisters say in answer to the earlier bond's end does
  not count. One that still says "alive" after the disconnect timeout does not listen to us, and is
  the sister of the new bond.

As in bond_core, the timeouts that a sister announces are for debugging; each end follows its own.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass


@dataclass(frozen=True)
class BondTimings:
    """How long an end waits and how often it speaks, in seconds.

    Attributes:
        connect_timeout: From the start to the sister's first word.
        heartbeat_timeout: The longest silence of a sister that was heard.
        disconnect_timeout: From the end's parting to the sister's acknowledgement.
        heartbeat_period: Between two "alive".
        dead_publish_period: Between two "dead" while the sister has not acknowledged.
    """

    connect_timeout: float
    heartbeat_timeout: float
    disconnect_timeout: float
    heartbeat_period: float
    dead_publish_period: float


class BondState(enum.Enum):
    """Where an end of a bond stands; see the module's diagram."""

    WAITING = "waiting for the sister"
    ALIVE = "alive"
    PARTING = "waiting for the sister to acknowledge our death"
    DEAD = "dead"


@dataclass(frozen=True)
class Outcome:
    """What an event asks of the owner of the end.

    Attributes:
        say: Publish this as `active`; None: say nothing.
        broken: The bond broke by itself; its owner wants to know. True at most once in an end's
            life.
        silent: The sister was silent for too long; decide with `BondEnd.judge_silence` what that
            means.
        intruder: The message came from a third party on a bond for two.
    """

    say: bool | None = None
    broken: bool = False
    silent: bool = False
    intruder: bool = False


NOTHING = Outcome()


class BondEnd:
    """Our end of one bond.

    The owner passes in the time (seconds, monotonic) with every event and does what the `Outcome`
    says.

    Attributes:
        bond_id: The id that both ends share.
        instance_id: The id of this end alone.
        sister: The instance id of the other end, once heard.
        state: Where the end stands.
        deadline: When `tick` has to be called next, None: not before another event.
    """

    def __init__(
        self,
        bond_id: str,
        instance_id: str,
        timings: BondTimings,
        now: float,
        former: BondEnd | None = None,
    ) -> None:
        """Start to wait for the sister.

        Args:
            bond_id: The id that both ends share.
            instance_id: A unique id for this end.
            timings: How long to wait and how often to speak.
            now: The time.
            former: Our end of an earlier bond with the same id, whose sisters' last words are not
                meant for this one.
        """
        self.bond_id = bond_id
        self.instance_id = instance_id
        self.sister: str | None = None
        self.state = BondState.WAITING
        self.deadline: float | None = now + timings.connect_timeout
        self._timings = timings
        self._own_instances = {instance_id}
        self._former_sisters: set[str | None] = set()
        if former is not None:
            self._own_instances |= former._own_instances
            self._former_sisters |= former._former_sisters | {former.sister}
        self._former_settled_at = now + timings.disconnect_timeout
        self._parted_at = now

    @property
    def wants_heartbeats(self) -> bool:
        """Whether this end says once a period that it is alive."""
        return self.state in (BondState.WAITING, BondState.ALIVE)

    @property
    def forgettable(self) -> bool:
        """Whether nothing can happen to this end any more."""
        return self.state is BondState.DEAD and self.deadline is None

    def hear(self, instance_id: str, active: bool, now: float) -> Outcome:
        """Take in a status message with this bond's id."""
        if instance_id in self._own_instances:
            return NOTHING
        is_former = instance_id in self._former_sisters
        if self.sister is None and not (is_former and self._are_last_words(active, now)):
            self.sister = instance_id
        if instance_id != self.sister:
            return NOTHING if is_former else Outcome(intruder=True)
        return self._sister_alive(now) if active else self._sister_dead(now)

    def tick(self, now: float) -> Outcome:
        """Do what is due; nothing before `deadline`."""
        if self.deadline is None or now < self.deadline:
            return NOTHING
        if self.state is BondState.WAITING:
            return self._die(say=False, broken=True)
        if self.state is BondState.ALIVE:
            self.deadline = None
            return Outcome(silent=True)
        if (
            self.state is BondState.PARTING
            and now < self._parted_at + self._timings.disconnect_timeout
        ):
            self.deadline = now + self._timings.dead_publish_period
            return Outcome(say=False)
        return self._die()

    def judge_silence(self, counts: bool, now: float) -> Outcome:
        """Settle a silence that `tick` reported, unless it has ended by now.

        Args:
            counts: Whether silence breaks bonds at present; if not, another heartbeat timeout is
                waited for.
            now: The time.
        """
        if self.state is not BondState.ALIVE or self.deadline is not None:
            return NOTHING
        if counts:
            return self._die(say=False, broken=True)
        self.deadline = now + self._timings.heartbeat_timeout
        return NOTHING

    def part(self, now: float) -> Outcome:
        """Break the bond on purpose: the sister is told, the owner is not."""
        if not self.wants_heartbeats:
            return NOTHING
        self.state = BondState.PARTING
        self._parted_at = now
        self.deadline = now + self._timings.dead_publish_period
        return Outcome(say=False)

    def _are_last_words(self, active: bool, now: float) -> bool:
        """Whether a former sister speaks of the earlier bond."""
        return not active or now < self._former_settled_at

    def _sister_alive(self, now: float) -> Outcome:
        if not self.wants_heartbeats:
            return NOTHING
        greeting = Outcome(say=True) if self.state is BondState.WAITING else NOTHING
        self.state = BondState.ALIVE
        self.deadline = now + self._timings.heartbeat_timeout
        return greeting

    def _sister_dead(self, now: float) -> Outcome:
        if self.state is BondState.PARTING:
            return self._die()
        if self.state is BondState.DEAD:
            return NOTHING if self.deadline is None else Outcome(say=False)
        self.state = BondState.DEAD
        self.deadline = now + self._timings.disconnect_timeout
        return Outcome(say=False, broken=True)

    def _die(self, say: bool | None = None, broken: bool = False) -> Outcome:
        self.state = BondState.DEAD
        self.deadline = None
        return Outcome(say=say, broken=broken)
