# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""States: the view that a formula has of the messages of its ports, once every period.

Times are integers in nanoseconds of ROS time. State ``k`` is at ``k * period``, so monitors that
receive the same messages have the same states, whenever they began.
"""

from __future__ import annotations

from collections import deque
from operator import attrgetter
from typing import Any, Deque, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Tuple

from dyknow.formulas import tree
from dyknow.formulas.compiler import Evaluator, Input
from dyknow.formulas.exact import ExactEvaluator
from dyknow.formulas.log import Log
from dyknow.formulas.look_ahead import looks_ahead
from dyknow.formulas.precision import Single, original, plain
from dyknow.formulas.semantics import FALSE, TRUE, UNKNOWN

#: Seconds over which ``rate`` counts messages, unless the formula says otherwise.
RATE_WINDOW = 2.0
_NONE: Mapping[Any, Any] = {}


class StateSettings(NamedTuple):
    """How states are made from messages; times in nanoseconds."""

    period: int = tree.SECOND // 10  # between two states
    hold: Optional[int] = None  # greatest age of a message with a value; None: until the next one
    delay: int = tree.SECOND // 10  # after which a state closes, even if a port has not passed it
    is_exact: bool = False  # whether to reason with all that UNKNOWN atoms could be
    max_nodes: int = 1000  # most decisions that this keeps at a time


def clock(nanoseconds: int) -> str:
    """Write a time in seconds, with milliseconds."""
    return f"{nanoseconds // tree.SECOND}.{nanoseconds % tree.SECOND // 1_000_000:03d}"


class PortValues:
    """The messages of a port, by the first state that sees them."""

    __slots__ = ("_coming", "_counts", "latest", "message", "stamp")

    def __init__(self, windows: Iterable[int] = ()) -> None:
        """Prepare a port; ``windows`` are the states over which its messages are counted."""
        longest = max(windows, default=0)
        self._counts: Optional[Deque[int]] = deque(maxlen=longest) if longest else None
        self.forget()

    def forget(self) -> None:
        """Begin without a message."""
        self.message: Any = None  # the last one that a closed state has seen, and its stamp
        self.stamp: Optional[int] = None
        self.latest = -1  # greatest stamp of all messages
        self._coming: List[Tuple[int, int, Any, int]] = []  # state, stamp, message, count
        self.forget_counts()

    def forget_counts(self) -> None:
        """Begin to count messages with the next state: states before it have been left out."""
        if self._counts is not None:
            self._counts.clear()

    def add(self, state: int, stamp: int, message: Any, far: int) -> None:
        """Keep a message for a state; of several with one stamp the last one counts.

        Of those stamped after ``far`` only the last one is kept.
        """
        coming = self._coming
        while stamp > far and coming and coming[-1][1] > far:
            coming.pop()
        at = len(coming)
        while at and coming[at - 1][0] > state:
            at -= 1
        if at and coming[at - 1][0] == state:
            _, known, other, count = coming[at - 1]
            last = (stamp, message) if stamp >= known else (known, other)
            coming[at - 1] = (state, *last, count + 1)
        else:
            coming.insert(at, (state, stamp, message, 1))
        if stamp > self.latest:
            self.latest = stamp

    def close(self, state: int) -> None:
        """Take the messages that the state is the first to see."""
        count = 0
        while self._coming and self._coming[0][0] <= state:
            own, self.stamp, self.message, more = self._coming.pop(0)
            count += more * (own == state)  # those of states before the first are not counted
        if self._counts is not None:
            self._counts.append(count)

    def count(self, states: int) -> Optional[int]:
        """Count the messages of the last states; None if there have been fewer states."""
        if self._counts is None or len(self._counts) < states:
            return None
        return sum(list(self._counts)[-states:])


class States:
    """One sequence of states of a formula; a quantified formula has one for each individual.

    Its ``ports`` are without those of individuals; its ``log`` explains truths.
    """

    __slots__ = (
        *("name", "first", "own", "ports", "quantifiers", "evaluator", "log"),
        *("is_over", "_formula", "_settings", "_state", "_decided"),
    )

    def __init__(
        self,
        formula: tree.Node,
        settings: StateSettings,
        first: int,
        shared: Mapping[str, PortValues] | None = None,
        name: str = "",
    ) -> None:
        """Start a sequence at the state of a number, of an individual if it has a ``name``.

        ``shared`` are ports that another one closes: those outside the quantifier.
        """
        self.name = name
        self._formula = formula
        self._settings = settings
        period = settings.period
        self.own = {
            port: PortValues(
                rate_states(each, period)
                for atom in tree.atoms(formula)
                for each in tree.readings(atom)
                if isinstance(each, tree.Call)
                and each.function == "rate"
                and tree.port_of(each) == port
            )
            for port in own_ports(formula)
            if port not in (shared or {})
        }
        self.ports = {**shared, **self.own} if shared else self.own
        quantified = tree.quantifiers(formula)
        self.quantifiers: Mapping[tree.Quantified, Individuals] = _NONE
        if quantified:
            self.quantifiers = {e: Individuals(e, settings, self.ports) for e in quantified}
        self.is_over = False
        self._state = first - 1
        self.begin(first)

    def begin(self, first: int) -> None:
        """Start the sequence at a state, with the messages that the ports have."""
        formula, settings = self._formula, self._settings
        if first > self._state + 1:
            for values in self.own.values():
                values.forget_counts()
        self.first = first
        self.evaluator: Evaluator | ExactEvaluator
        if settings.is_exact:
            self.evaluator = ExactEvaluator(
                formula, settings.period, self._note, settings.max_nodes
            )
        else:
            self.evaluator = Evaluator(formula, settings.period, self._note)
        self.log = Log(formula, settings.period, self.evaluator.atoms, self._named)
        self._state = first - 1
        self._decided = first
        for individuals in self.quantifiers.values():
            individuals.begin(first)

    def close(self, state: int, oldest: int) -> List[Tuple[int, int]]:
        """Close the next state; returns the states that are decided now, with their truths.

        ``oldest`` is the first state that may have to be explained once it is decided.
        """
        self._state = state
        self.log.forget(min(self._decided, oldest) - self.first)
        for port in self.own.values():
            port.close(state)
        now = state * self._settings.period
        truths = self.evaluator.step(*[self._value(each, now) for each in self.evaluator.inputs])
        return self._number(truths)

    def end(self) -> List[Tuple[int, int]]:
        """Decide all states that are open: nothing will be known of states to come."""
        self.is_over = True
        for port in self.own.values():
            port.forget()
        open_ = self._state + 1 - self._decided
        truths: List[int] = []
        for _ in range(self.evaluator.horizon):
            inputs = (
                self.quantifiers[each].end() if isinstance(each, tree.Quantified) else None
                for each in self.evaluator.inputs
            )
            truths += self.evaluator.step(*inputs)
        return self._number(truths[:open_])

    def _number(self, truths: Iterable[int]) -> List[Tuple[int, int]]:
        found = list(enumerate(truths, self._decided))
        self._decided += len(found)
        self.log.close(self._state - self.first)
        return found

    def why(self, state: int, truth: int) -> str:
        """Write the values that decided a truth, which was decided last."""
        return self.log.why(state - self.first, truth)

    def all_ports(self) -> Iterable[PortValues]:
        """Return the ports that have to pass a state before it closes."""
        if not self.quantifiers:
            return self.own.values()
        below = [e for each in self.quantifiers.values() for e in each.open()]
        return [port for states in (self, *below) for port in states.own.values()]

    def _value(self, wanted: Input, now: int) -> Any:
        """Return an input of the evaluator in the state that closes."""
        if isinstance(wanted, tree.Field):
            port = self.ports[wanted.port]
            if port.stamp is None:
                return None
            hold = self._settings.hold
            return port.message if hold is None or now - port.stamp <= hold else None
        if isinstance(wanted, tree.Quantified):
            return self.quantifiers[wanted].close(self._state, self.first + self.log.oldest)
        return self._called(wanted, now)

    def _called(self, wanted: tree.Call, now: int) -> Any:
        """Return what ``present``, ``age`` or ``rate`` is now."""
        port = self.ports[tree.port_of(wanted)]
        if wanted.function == "present":
            return self._value(tree.Field(tree.port_of(wanted)), now) is not None
        if wanted.function == "age":
            return None if port.stamp is None else (now - port.stamp) / tree.SECOND
        states = rate_states(wanted, self._settings.period)
        count = port.count(states)
        return None if count is None else count * tree.SECOND / (states * self._settings.period)

    # The log

    def _named(self, formula: tree.Quantified, state: int) -> Iterator[Tuple[str, Log, int]]:
        state += self.first
        for each in self.quantifiers[formula].of(state):
            yield each.name, each.log, state - each.first

    def _note(self, number: int, truth: int) -> None:
        """Log the truth of an atom that has changed, and the values that it reads."""
        if self.is_over:
            return
        atom = self.evaluator.atoms[number]
        values = tuple(self._reading(each) for each in tree.readings(atom))
        self.log.note(number, self._state - self.first, truth, values)

    def _reading(self, reading: tree.Field | tree.Call) -> str:
        now = self._state * self._settings.period
        if isinstance(reading, tree.Call):
            return f"{reading} = {_written(self._called(reading, now))}"
        stamp = self.ports[reading.port].stamp
        if stamp is None:
            return f"{reading.port}: no message yet"
        when = clock(stamp).rstrip("0").rstrip(".")
        value = self._value(tree.Field(reading.port), now)
        if value is None:
            return f"{reading.port}: no message since {when}"
        try:
            for step in reading.path:
                value = value[step] if isinstance(step, int) else getattr(value, step)
        except (AttributeError, IndexError, TypeError):
            return f"{reading}: no such value at {when}"
        return f"{reading} = {_written(value)} at {when}"


class Individuals:
    """The individuals of a quantifier; each has a sequence of states from its arrival on."""

    def __init__(
        self, formula: tree.Quantified, settings: StateSettings, shared: Mapping[str, PortValues]
    ) -> None:
        """Hold no individuals yet; ``shared`` are the ports outside the quantifier."""
        self._formula = formula
        self._settings = settings
        self._shared = shared
        self.present: Dict[str, States] = {}  # those that are there now, by name
        self._looks_ahead = looks_ahead(formula.operand)
        self._gone: Dict[States, int] = {}  # first states without them
        self._open: Deque[Dict[States, Optional[int]]] = deque()
        self._next: Optional[int] = None

    def begin(self, first: int) -> None:
        """Start the sequences of all individuals at a state."""
        self._open.clear()
        self._gone.clear()
        self._next = None
        for each in self.present.values():
            each.begin(first)

    def set(self, names: Iterable[str], first: int) -> None:
        """Have exactly these individuals from a state on."""
        wanted = set(names)
        for name in sorted(self.present.keys() - wanted):
            self._gone[self.present.pop(name)] = first
        for each in [each for each, without in self._gone.items() if without == first]:
            if each.name in wanted:  # no state is without it
                del self._gone[each]
                self.present[each.name] = each
        for name in sorted(wanted - self.present.keys()):
            operand = self._formula.operand
            self.present[name] = States(operand, self._settings, first, self._shared, name)

    def of(self, state: int) -> List[States]:
        """Return the individuals of a state that is not forgotten, by name."""
        all_ = (*self._gone, *self.present.values())
        here = [each for each in all_ if each.first <= state < self._gone.get(each, state + 1)]
        return sorted(here, key=attrgetter("name"))

    def open(self) -> List[States]:
        """Return the individuals of the states that are to close."""
        return [each for each in (*self._gone, *self.present.values()) if not each.is_over]

    def close(self, state: int, oldest: int) -> Any:
        """Close a state: its truth or, if the formula looks ahead, the truths decided now.

        No state before ``oldest`` will be explained.
        """
        if self._next is None:
            self._next = state
        for each, without in [*self._gone.items()]:
            if without == state:
                self._decide(each, each.end())
            elif without < oldest:
                del self._gone[each]
        present = self.of(state)
        self._open.append(dict.fromkeys(present))
        for each in present:
            self._decide(each, each.close(state, oldest))
        ready = list(self._ready())
        return ready if self._looks_ahead else ready[0]

    def end(self) -> Any:
        """Decide the open states, and return them with the truth of one state to come."""
        for each in self.open():
            self._decide(each, each.end())
        return [*self._ready(), UNKNOWN] if self._looks_ahead else UNKNOWN

    def _decide(self, states: States, decided: Iterable[Tuple[int, int]]) -> None:
        for state, truth in decided:
            # States decided without it are not open any more.
            if self._next is not None and state >= self._next:
                self._open[state - self._next][states] = truth

    def _ready(self) -> Iterator[int]:
        """Yield the truths of the next states, as far as they are decided."""
        is_every = self._formula.quantifier == "every"
        alone = FALSE if is_every else TRUE
        while self._open:
            truths = self._open[0].values()
            known = [each for each in truths if each is not None]
            if len(known) < len(truths) and alone not in known:
                return
            self._open.popleft()
            self._next = (self._next or 0) + 1
            yield min([TRUE, *known]) if is_every else max([FALSE, *known])


def own_ports(formula: tree.Node) -> Tuple[str, ...]:
    """Return the ports that a formula reads outside its quantifiers, in the order written."""
    parts = (each for each in tree.outermost(formula) if not isinstance(each, tree.Quantified))
    return tuple(dict.fromkeys(port for each in parts for port in tree.ports(each)))


def rate_states(call: tree.Call, period: int) -> int:
    """Return the states over which ``rate`` counts."""
    seconds = call.arguments[1] if len(call.arguments) > 1 else tree.Number(RATE_WINDOW)
    assert isinstance(seconds, tree.Number)
    return max(1, round(seconds.value * tree.SECOND) // period)


def _written(value: Any) -> str:
    value = plain(value)
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "unknown"}[value]
    if isinstance(value, Single):
        return str(value)
    if isinstance(value, float):
        return f"{value:.9g}"
    if hasattr(value, "to_sec"):
        return f"{value.to_sec():.9g}"
    if isinstance(value, (int, str)):
        return repr(value)
    if hasattr(value, "UNKNOWN") and hasattr(value, "value"):  # a verdict
        return {0: "FALSE", 1: "TRUE"}.get(value.value, "UNKNOWN")
    if hasattr(value, "data"):
        return _written(value.data)
    return f"<{type(original(value)).__name__}>"
