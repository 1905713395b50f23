# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims: streams that are kept for clients, as the manager knows them."""

from __future__ import annotations

import functools
import json
import time
from dataclasses import asdict, dataclass, field
from typing import Callable, Iterable, Mapping, Optional, Tuple

from dyknow.datatypes import same_type
from dyknow.errors import BadParameter
from dyknow.formulas import parse
from dyknow.manager.bodies import read, read_fields
from dyknow.manager.planning.problem import Demand, Wishes
from dyknow.manager.specifications.tags import Bindings, parse_tag
from dyknow.model.streams import ClaimState, StreamRequest

#: Seconds that the improvement of one plan may take: meanwhile no other request is served.
MOST_BUDGET = 60.0
#: Name of the delivered stream in formulas of requests.
STREAM = "it"


def check_request(request: StreamRequest) -> None:
    """Check the parameters of a request, apart from the tag.

    Raises:
        BadParameter: a value is out of bounds, or contradicts another one.
        FormulaError: ``require`` is not a formula.
    """
    infinity = float("inf")
    for name, value, most, expected in (
        ("lease", request.lease, infinity, "seconds from 0 (which means: until released)"),
        ("max_silence", request.max_silence, infinity, "seconds from 0 (which means: never)"),
        ("min_rate", request.min_rate, infinity, "Hz from 0 (which means: any rate)"),
        ("max_age", request.max_age, infinity, "seconds from 0 (which means: any age)"),
        (
            "budget",
            request.budget,
            MOST_BUDGET,
            f"seconds from 0 (which means: the default) to {MOST_BUDGET:g}",
        ),
    ):
        if not 0 <= value <= most or value == infinity:
            raise BadParameter(name, value, expected)
    if request.require:
        formula, expected = parse(request.require), ""
        if [*formula.ports] != [STREAM]:
            expected = f"a formula that reads '{STREAM}' alone"
        elif formula.variables:
            expected = (
                f"a formula without 'every' and 'some': '{STREAM}' is one stream, and has no "
                f"individuals {formula.variables[0]}"
            )
        if expected:
            raise BadParameter("require", request.require, expected)
    both = sorted(set(request.prefer) & set(request.avoid))
    if both:
        raise BadParameter("avoid", both[0], "a name that is not in prefer as well")


@dataclass(frozen=True)
class Claim:
    """A stream that is kept for a client."""

    claim_id: str  # unique, never used again
    request: StreamRequest  # the client's request
    topic: str = ""  # where the client listens; it stays when the publisher is replaced
    datatype: str = ""  # type of the stream
    state: ClaimState = ClaimState.PENDING  # whether messages flow
    detail: str = ""  # the reason for the state, for people
    #: Nodelet and out-port that publish; empty for a topic of ordinary nodes.
    goal: Tuple[str, str] = ("", "")
    #: Topics by port of each nodelet of the stream; while there is no stream, the nodelets that
    #: are kept for it, disconnected.
    wiring: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    sources: Tuple[str, ...] = ()  # topics of ordinary nodes that the stream needs
    #: When the lease ends, on the reconciler's clock; None for never.
    deadline: Optional[float] = None
    bindings: Bindings = ()  # values of the tag's variables
    monitor: str = ""  # nodelet that evaluates the formula of the request; empty for none

    @property
    def is_made(self) -> bool:
        """Whether something was made or found that publishes for it."""
        return bool(self.goal[0] or self.sources)

    @property
    def nodelets(self) -> Tuple[str, ...]:
        return tuple(sorted(self.wiring))

    @property
    def wanted_type(self) -> str:
        """The ROS type that the client expects: of its request, or its first stream."""
        return self.request.datatype or self.datatype.replace("*", "")

    @functools.cached_property
    def demand(self) -> Demand:
        request = self.request
        tags = frozenset([parse_tag(request.tag)])
        return Demand(tags, self.wanted_type, request.min_rate, request.max_age)

    @property
    def wishes(self) -> Wishes:
        """The preferences of the client."""
        request = self.request
        return Wishes(tuple(sorted({*request.prefer})), tuple(sorted({*request.avoid})))

    def may_share(self, other: Claim) -> bool:
        """Whether every stream that satisfies another claim, now or later, satisfies this one."""
        mine, theirs = self.demand, other.demand
        return (
            mine.tags == theirs.tags
            and (not mine.datatype or same_type(mine.datatype, theirs.datatype))
            and mine.min_rate <= theirs.min_rate
            and (not mine.max_age or 0 < theirs.max_age <= mine.max_age)
            and {*self.request.exclude} == {*other.request.exclude}
            and self.wishes == other.wishes
            and self.request.require == other.request.require
        )

    def body(self, now: Moment) -> str:
        """Return its stored form, with the rest of its lease and the present time."""
        body = asdict(self)
        body["state"] = int(self.state)
        body["left"] = None if self.deadline is None else self.deadline - now.steady
        body["written"] = asdict(now)
        del body["deadline"]
        return json.dumps(body)

    @classmethod
    def from_body(cls, claim_id: str, text: str, now: Moment) -> Claim:
        """Read what ``body`` returned; the lease has run on since it was written."""
        fields = dict(json.loads(text))
        left = read(Optional[float], fields.pop("left"))
        written = read(Moment, fields.pop("written", asdict(now)))
        deadline = None if left is None else now.steady + left - now.since(written)
        claim = cls(**read_fields(cls, fields), deadline=deadline)
        if claim.claim_id != claim_id:
            raise ValueError(f"it says that it is '{claim.claim_id}'")
        parse_tag(claim.request.tag)
        return claim


def demand_of(claims: Iterable[Claim]) -> Demand:
    """Return what one stream has to be to satisfy all these claims."""
    return functools.reduce(Demand.both, [claim.demand for claim in claims])


@dataclass(frozen=True)
class ClaimEvent:
    """A claim changed; before that there was none if it is new."""

    before: Optional[Claim]
    after: Claim
    reason: str


@dataclass(frozen=True)
class Moment:
    """A moment on two clocks."""

    #: Seconds on the steady clock, which all processes share until the machine restarts.
    steady: float
    wall: float  # seconds of the wall clock, which users can set
    boot: str  # id of this run of the machine; empty if unknown

    @classmethod
    def now(cls, steady: Callable[[], float]) -> Moment:
        return cls(steady(), time.time(), _boot())

    def since(self, earlier: Moment) -> float:
        """Seconds from an earlier moment, at least 0: on the steady clock if it is the same."""
        if self.boot and self.boot == earlier.boot:
            return max(0.0, self.steady - earlier.steady)
        return max(0.0, self.wall - earlier.wall)


@functools.lru_cache(maxsize=None)
def _boot() -> str:
    try:
        with open("/proc/sys/kernel/random/boot_id") as file:
            return file.read().strip()
    except OSError:
        return ""
