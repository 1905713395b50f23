# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts from messages: what ``dyknow.formulas.parse`` returns, and monitors of it."""

from __future__ import annotations

import enum
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from dyknow.errors import BadParameter, FormulaError
from dyknow.formulas import syntax, tree
from dyknow.formulas.compiler import endless
from dyknow.formulas.look_ahead import looks_ahead
from dyknow.formulas.precision import narrowed
from dyknow.formulas.semantics import FALSE, TRUE, UNKNOWN, steps
from dyknow.formulas.states import States, StateSettings, clock, own_ports, rate_states
from dyknow.formulas.types import Lookup, MessageType, TypeChecker, known_type, type_of

MAX_STATES = 1_000_000  # most states that bounds may span
#: Nanoseconds ahead of the clock up to which all messages are kept: a source's clock may differ.
_AHEAD = 10 * tree.SECOND


class Truth(enum.IntEnum):
    """The values of a verdict, as in ``dyknow_msgs/Verdict``."""

    FALSE = 0
    TRUE = 1
    UNKNOWN = 2


_TRUTHS = {FALSE: Truth.FALSE, TRUE: Truth.TRUE, UNKNOWN: Truth.UNKNOWN}


class Verdict(NamedTuple):
    """The verdict of a formula about one state.

    Attributes:
        stamp: time of the state, in nanoseconds.
        value: whether the formula holds.
        since: time of the first state of the run of equal verdicts.
        why: the atoms, values and times that decided at the beginning of this run.
    """

    stamp: int
    value: Truth
    since: int
    why: str

    def __str__(self) -> str:
        """Write it as ``dyknow holds --why`` does."""
        return f"{clock(self.stamp)} {self.value.name}  {self.why}".rstrip()


class Range(NamedTuple):
    """The individuals of a variable; ``concept`` is empty for individuals of any kind."""

    variable: str
    concept: str


class Formula:
    """A formula of metric temporal logic over the messages of ports.

    Attributes:
        text: as it was written.
        tree: its meaning; see ``dyknow.formulas.tree``.
        ports: the ports that it reads, in the order written.
        of_individuals: those of them that belong to the individuals of a quantifier.
    """

    __slots__ = ("of_individuals", "ports", "text", "tree")

    def __init__(self, text: str) -> None:
        """Read a formula; raises FormulaError with line and column."""
        self.text = text
        self.tree = syntax.parse(text)
        self.ports = tree.ports(self.tree)
        own = own_ports(self.tree)
        self.of_individuals = tuple(port for port in self.ports if port not in own)

    def __str__(self) -> str:
        return str(self.tree)

    @property
    def variables(self) -> Tuple[str, ...]:
        """The variables of its quantifiers, in the order written."""
        return tuple(dict.fromkeys(each.variable for each in tree.quantifiers(self.tree)))

    def ranges(self) -> Mapping[str, Range]:
        """Return the individuals that each port of ``of_individuals`` has a stream for.

        A variable has one concept: a quantifier without one takes that of another quantifier.

        Raises:
            FormulaError: a port has two variables, a variable two concepts, or no port.
        """
        quantified = tree.quantifiers(self.tree)
        concepts: Dict[str, str] = {}
        variables: Dict[str, str] = {}
        for each in quantified:
            concept = concepts.setdefault(each.variable, each.concept) or each.concept
            if each.concept not in ("", concept):
                problem = f"{each.variable} is of the concept {concept} in another quantifier: "
                problem += "expected it, or another variable"
                raise FormulaError(self.text, each.place, problem)
            concepts[each.variable] = concept
            for port in tree.ports(each.operand):
                if port not in self.of_individuals:
                    continue
                if variables.setdefault(port, each.variable) != each.variable:
                    problem = f"the port '{port}' has a stream for each {variables[port]}: a "
                    problem += f"quantifier of {each.variable} cannot read it"
                    raise FormulaError(self.text, each.place, problem)
        for each in quantified:
            if each.variable not in variables.values():
                problem = f"{each.variable} has no individuals: each port below the quantifier "
                raise FormulaError(self.text, each.place, f"{problem}is read outside as well")
        return {port: Range(variable, concepts[variable]) for port, variable in variables.items()}

    def check(self, types: Mapping[str, Optional[MessageType]], lookup: Lookup) -> None:
        """Check ports, fields and constants against the types of messages.

        Args:
            types: the ports there are, each with its type; None where that is not known.
            lookup: returns a message type by its name, None for one that is not known.

        Raises:
            FormulaError: a port, a field or a constant does not exist, or values cannot be
                compared; the error names those that exist.
        """
        TypeChecker(self.text, types, lookup).check(self.tree)

    def monitor(
        self,
        period: float = 0.1,
        hold: Optional[float] = None,
        delay: float = 0.1,
        exact: bool = False,
        max_nodes: int = 1000,
    ) -> Monitor:
        """Return a monitor, which makes verdicts from messages.

        Args:
            period: seconds between two states.
            hold: seconds for which a message has a value; None: until the next one comes.
            delay: seconds after which a state closes, even if a port has not passed it.
            exact: whether UNKNOWN atoms are followed through all that they could be.
            max_nodes: the most that ``exact`` keeps; beyond, atoms are UNKNOWN as ever.

        Raises:
            BadParameter: a parameter is out of its range.
            FormulaError: bounds do not fit the period, or a quantifier that looks ahead `exact`.
        """
        for name, value, least in (
            ("period", period, 1e-6),
            ("delay", delay, 0.0),
            ("hold", hold or 0.0, 0.0),
        ):
            if not least <= value < 2**31:
                raise BadParameter(name, value, f"seconds from {least:g} to below {2**31}")
        settings = StateSettings(
            max(1, round(period * tree.SECOND)),
            None if hold is None else round(hold * tree.SECOND),
            round(delay * tree.SECOND),
            exact,
            max_nodes,
        )
        self._check_bounds(settings.period)
        for each in tree.quantifiers(self.tree) if exact else ():
            if looks_ahead(each.operand):
                problem = "exact cannot reason about a quantifier that looks ahead"
                raise FormulaError(self.text, each.place, problem)
        return Monitor(self, settings)

    def _check_bounds(self, period: int) -> None:
        for each in tree.temporals(endless(self.tree)[0]):
            near, far = steps(each.interval, period)
            if far is not None and far < near:
                problem = f"no state lies within {each.interval}: states are "
                raise FormulaError(self.text, each.place, f"{problem}{clock(period)} s apart")
            if max(near, far or 0) > MAX_STATES:
                problem = f"{each.interval} are {max(near, far or 0)} states of "
                problem += f"{clock(period)} s: at most {MAX_STATES}"
                raise FormulaError(self.text, each.place, problem)
        for atom in tree.atoms(self.tree):
            for call in tree.readings(atom):
                if isinstance(call, tree.Call) and call.function == "rate":
                    states = rate_states(call, period)
                    if states > MAX_STATES:
                        problem = f"{call} counts over {states} states of "
                        problem += f"{clock(period)} s: at most {MAX_STATES}"
                        raise FormulaError(self.text, call.place, problem)


class Monitor:
    """Makes verdicts about one formula; not safe for several threads at once.

    Times are those of ROS: ``rospy.Time`` and its like, or seconds.

    Attributes:
        late: number of messages that came for a state that was closed, and were ignored.
    """

    __slots__ = (
        *("late", "_formula", "_settings", "_tree", "_verdicts", "_checked", "_individuals"),
        *("_now", "_states", "_earliest", "_next", "_run"),
    )

    def __init__(self, formula: Formula, settings: StateSettings) -> None:
        """Make a monitor without states; see ``Formula.monitor``."""
        self.late = 0
        self._formula = formula
        self._settings = settings
        self._tree, self._verdicts = endless(formula.tree)
        self._checked: Tuple[Tuple[str, type], ...] = ()
        self._individuals: Tuple[Tuple[str, Tuple[str, ...]], ...] = ()
        self._begin()

    def _begin(self) -> None:
        self._now = -1
        self._states = States(self._tree, self._settings, 0)
        self._earliest = 0  # state
        self._next: Optional[int] = None  # the state that closes next
        self._run: Optional[Verdict] = None

    def feed(
        self, port: str, message: Any, received: Any = None, individual: str = ""
    ) -> List[Verdict]:
        """Take a message; returns the verdicts that it decides, in the order of states.

        Args:
            port: the port that it came on.
            message: it is stamped by its header or, without one, when it was received.
            received: when it was received; by default its stamp, or the present time if that is
                later: messages alone do not turn time back.
            individual: of a port below a quantifier: whose message it is.
        """
        stamp = _stamp(message)
        if received is not None:
            now = nanoseconds(received)
        elif stamp is not None:
            now = max(self._now, stamp)
        else:
            raise BadParameter("received", received, "a time, for messages without a header")
        found = self.advance_to(now)
        self._check_class(port, message)
        stamp = now if stamp is None else stamp
        period = self._settings.period
        state = -(-stamp // period)
        if self._next is None:
            # A stamp that is far ahead of the clock delays no state.
            first = max(state, -(-(now - self._settings.delay) // period))
            self._start(min(first, -(-now // period)))
        readers = self._readers(port, individual)
        if not readers:
            return found
        # A first state sees what came for an earlier one; an individual has its own.
        if max(state, readers[0].first) < (self._next or 0):
            self.late += 1
            return found
        farthest = now + self._settings.delay
        for each in readers:
            values = each.own[port]
            values.add(state, stamp, narrowed(message), now + _AHEAD)
            # A stamp far ahead of the clock passes no states that messages are still to come for.
            if values.latest > farthest:
                values.latest = farthest
        passed = min([each.latest for each in self._states.all_ports()])
        self._close(min(-(-passed // period) - 1, now // period), found)
        return found

    def advance(self, now: Any) -> List[Verdict]:
        """Let ROS time pass; returns the verdicts of the states that close by it."""
        return self.advance_to(nanoseconds(now))

    def advance_to(self, now: int) -> List[Verdict]:
        """``advance`` to a time in nanoseconds."""
        found: List[Verdict] = []
        period = self._settings.period
        is_far = self._next is not None and now // period - self._next > MAX_STATES
        if now < self._now - period or is_far:
            found = self.finish()
        self._now = now
        if self._next is not None:
            self._close(-(-(now - self._settings.delay) // period) - 1, found)
        return found

    @property
    def due(self) -> Optional[float]:
        """ROS time, in seconds, after which ``advance`` closes a state; None without states."""
        if self._next is None:
            return None
        return (self._next * self._settings.period + self._settings.delay) / tree.SECOND

    def individuals(self, variable: str, names: Iterable[str], now: Any) -> List[Verdict]:
        """Have these individuals of a variable from now on, as ``("?c", ["left"], now)``."""
        found = self.advance(now)
        others = (each for each in self._individuals if each[0] != variable)
        self._individuals = (*others, (variable, tuple(names)))
        state = -(-nanoseconds(now) // self._settings.period)
        if self._next is None:
            self._start(state)
        else:
            self._set_individuals(state)
        return found

    def hears(self, port: str, individual: str) -> bool:
        """Whether a port is outside quantifiers, or the individual is present in its range."""
        names = dict(self._individuals)
        return port in self._states.own or any(
            individual in names.get(each.variable, ()) and port in own_ports(each.operand)
            for each in self._states.quantifiers
        )

    def finish(self) -> List[Verdict]:
        """End the sequence of states; returns the verdicts that are open, mostly UNKNOWN."""
        found: List[Verdict] = []
        if self._next is not None:
            last = max((each.latest for each in self._states.all_ports()), default=-1)
            self._close(min(last, self._now) // self._settings.period, found)
            self._decide(self._states.end(), found)
        self._begin()
        return found

    def forget(self, ports: Iterable[str]) -> None:
        """Begin a new sequence of states, without what came to some ports outside quantifiers.

        It begins with the next message, behind the states that are closed; verdicts that are open
        are dropped.
        """
        for port in ports:
            self._states.own[port].forget()
        if self._next is not None:
            self._earliest, self._next, self._run = self._next, None, None

    # Inside

    def _start(self, state: int) -> None:
        self._next = max(state, self._earliest)
        self._states.begin(self._next)
        self._set_individuals(state)

    def _set_individuals(self, state: int) -> None:
        if self._next is not None:
            for formula, individuals in self._states.quantifiers.items():
                names = dict(self._individuals).get(formula.variable, ())
                individuals.set(names, max(state, self._next))

    def _close(self, last: int, found: List[Verdict]) -> None:
        """Close the states up to one of them."""
        while self._next is not None and self._next <= last:
            self._next += 1
            self._decide(self._states.close(self._next - 1, self._next), found)

    def _decide(self, decided: List[Tuple[int, int]], found: List[Verdict]) -> None:
        for state, truth in decided:
            if truth in self._verdicts:
                stamp, value = state * self._settings.period, _TRUTHS[truth]
                if self._run is None or self._run.value != value:
                    self._run = Verdict(stamp, value, stamp, self._states.why(state, truth))
                found.append(self._run._replace(stamp=stamp))

    def _readers(self, port: str, individual: str) -> Sequence[States]:
        """Return the sequences of states that read a port; none for an individual not there."""
        if port in self._states.own:
            return (self._states,)
        if port not in self._formula.ports:
            raise BadParameter("port", port, f"one of {', '.join(self._formula.ports)}")
        here = (e.present.get(individual) for e in self._states.quantifiers.values())
        return [each for each in here if each is not None and port in each.own]

    def _check_class(self, port: str, message: Any) -> None:
        """Check the formula once against each type of message."""
        if (port, type(message)) not in self._checked:
            self._checked += ((port, type(message)),)
            classes = dict(self._checked)
            types = {each: type_of(classes.get(each)) for each in self._formula.ports}
            self._formula.check(types, known_type)


def parse(text: str) -> Formula:
    """Read a formula.

    Raises:
        FormulaError: it is not a formula; the error has line and column, and the expected words.
    """
    return Formula(text)


def nanoseconds(time: Any) -> int:
    """Return a time in nanoseconds: one of ROS, or a number of seconds."""
    if hasattr(time, "to_nsec"):
        return int(time.to_nsec())
    return int(round(time * tree.SECOND))


def _stamp(message: Any) -> Optional[int]:
    """Return the stamp of a message's header, in nanoseconds; None without one, or for zero."""
    header = getattr(message, "header", None)
    stamp = getattr(header, "stamp", None)
    found = 0 if stamp is None else nanoseconds(stamp)
    return found or None
