# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Every way in which DyKnow refuses: one exception for each cause.

Each exception carries the facts that explain it. Its text names the fault and the
expected value. ``dyknow.ros`` alone turns exceptions into answers of services.

::

    DyKnowError
    ├── InvalidName, BadParameter, NoMessageClass, BadQueueSize, TypeMismatch, RemappedTopic
    ├── HandleClosed, PeerTimeout, Denied, LimitExceeded, NeedsProcess, StoreError, FormulaError
    ├── BadImage, NotUtf8
    ├── SpecificationError, CannotLaunch, ManagerUnreachable, NodeletUnreachable
    ├── NodeletError
    │   ├── NameTaken, UnknownNodelet, UnknownNodeletType, BrokenPlugin, BadRemapping
    │   ├── LoadFailed, ScriptEnded, UnloadedMeanwhile, SpawnFailed, RestartFailed
    │   ├── CannotMove, MoveFailed
    │   └── Busy, Protected, ProtectedFromUnloading
    ├── PortError
    │   └── UnknownPort, DuplicatePort, PortConflict, InvalidConfiguration
    ├── TransformationError
    │   └── UnknownTransformation, NotSpawnable, InvalidParameters
    ├── StreamError
    │   ├── NoPlanFound, StreamTypeMismatch, WrongStream, UnknownClaim
    │   └── InvalidTag
    │       └── InvalidType
    ├── OntologyError
    │   └── OntologyFileError, UnknownConcept, LabelsError, IndividualsError
    ├── HostError
    │   └── FixedTopics, CannotRun, HostTimeout, NotOurs
    └── Refused
        └── StreamRefused
"""

from __future__ import annotations

import enum
from typing import Iterable, NamedTuple, Sequence

from dyknow.demand_text import read_missing
from dyknow.similar import did_you_mean


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def described(error: BaseException) -> str:
    """Return the type and the text of an error of anybody's code, which may fail to make one."""
    name = type(error).__name__
    try:
        return f"{name}: {error}"
    except Exception as failure:
        return f"{name}, without a text: its __str__ raises {type(failure).__name__}"


class DyKnowError(Exception):
    """Root of all exceptions that DyKnow raises on purpose."""


class InvalidName(DyKnowError, ValueError):
    """A string that should be a ROS graph name is not one; rospy raises ValueError too."""

    def __init__(self, name: str, what: str = "name") -> None:
        self.name = name
        self.what = what
        super().__init__(
            f"'{name}' is not a valid {what}: expected letters, digits, '_' and single "
            "'/', starting with a letter, '/' or '~'"
        )


class NotUtf8(DyKnowError, ValueError):
    """A text cannot be sent: it has bytes of a word of the command line that is not UTF-8.

    Attributes:
        text: what was to be sent.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        shown = text.encode("utf-8", "backslashreplace").decode("utf-8")
        super().__init__(f"'{shown}' is not UTF-8")


class TypeMismatch(DyKnowError):
    """A topic is live with another type than the wanted one."""

    def __init__(self, topic: str, wanted: str, present: str) -> None:
        self.topic = topic
        self.wanted = wanted
        self.present = present
        super().__init__(f"topic '{topic}' carries {present}, but {wanted} was requested")


class NoMessageClass(DyKnowError, ValueError):
    """The given type of a topic is not a message class; rospy raises ValueError too."""

    def __init__(self, name: str, given: object) -> None:
        self.name = name
        self.given = given
        super().__init__(
            f"'{name}' expects a message class such as std_msgs.msg.String, not {given!r}"
        )


class BadQueueSize(DyKnowError, ValueError):
    """The given bound of a queue is not a number."""

    def __init__(self, name: str, given: object) -> None:
        self.name = name
        self.given = given
        super().__init__(f"'{name}' expects a number or None as queue_size, not {given!r}")


class CannotLaunch(DyKnowError):
    """A launch file cannot be found, read, or started."""


class BadParameter(DyKnowError):
    """A parameter has a value that cannot be worked with."""

    def __init__(self, name: str, value: object, expected: str) -> None:
        self.name = name
        self.value = value
        super().__init__(f"parameter '{name}' is {value!r}: expected {expected}")


class BadImage(DyKnowError):
    """An image cannot be compressed, or not be made of its compressed form."""

    def __init__(self, image: str, expected: str) -> None:
        super().__init__(f"{image}: expected {expected}")


class FormulaError(DyKnowError):
    """A formula cannot be read, or does not fit the messages of its ports.

    Attributes:
        line: counted from 1 within the formula.
        column: counted from 1.
        problem: the text without the place.
    """

    def __init__(self, formula: str, place: int, problem: str) -> None:
        begin = formula.rfind("\n", 0, place) + 1
        self.line = formula.count("\n", 0, place) + 1
        self.column = place - begin + 1
        self.problem = problem
        shown = formula[begin:].partition("\n")[0]
        super().__init__(
            f"formula, line {self.line}, column {self.column}: {problem}\n"
            f"  {shown}\n  {' ' * (self.column - 1)}^"
        )


class RemappedTopic(DyKnowError):
    """A remapping of the process stands between a topic and its name."""

    def __init__(self, topic: str, target: str) -> None:
        self.topic = topic
        self.target = target
        super().__init__(
            f"topic '{topic}' cannot be reached from this process: its command line remaps "
            f"it to '{target}'; name that topic, or start the process without the remapping"
        )


class PeerTimeout(DyKnowError):
    """Somebody outside this process did not answer in time."""

    def __init__(self, peer: str, seconds: float) -> None:
        self.seconds = seconds
        self.peer = peer
        super().__init__(f"{peer} did not answer within {seconds:g} s")


class HandleClosed(DyKnowError):
    """A handle was used after its nodelet was unloaded, or after it was unregistered."""

    def __init__(self, what: str) -> None:
        self.what = what
        super().__init__(f"{what} is closed: it was unregistered, or its nodelet is unloaded")


class Denied(DyKnowError):
    """A guard forbids a change."""

    def __init__(self, what: str, why: str) -> None:
        self.what = what
        self.why = why
        super().__init__(f"{what} is denied: {why}")


class LimitExceeded(DyKnowError):
    """A limit is exceeded."""

    def __init__(self, what: str, count: int, limit: int) -> None:
        self.count = count
        self.limit = limit
        super().__init__(f"too many {what}: {count}, at most {limit} are allowed")


class HostError(DyKnowError):
    """A nodelet manager refused something, or could not be reached."""


class CannotRun(HostError):
    """A program cannot be started."""


class FixedTopics(HostError):
    """The ports of a nodelet stay on their topics: its nodelet manager has no live ports."""

    def __init__(self, nodelet: str, manager: str) -> None:
        super().__init__(
            f"the topics of '{nodelet}' are fixed, since its nodelet manager '{manager}' has no "
            "live ports; load it into one started with 'rosrun dyknow cpp_nodelet_manager', or "
            "start that one with the launch-prefix 'rosrun dyknow rewirable'"
        )
        self.nodelet = nodelet
        self.manager = manager


class HostTimeout(HostError):
    """A nodelet manager, or a nodelet of it, did not answer in time."""


class NotOurs(HostError):
    """A nodelet that is to be destroyed is in a process that this manager does not use."""

    def __init__(self, name: str, process: str, owner: str) -> None:
        self.name = name
        self.owner = owner
        if name == process:
            where, end = "a process of its own", f"rosnode kill {name}"
        else:
            where = f"nodelet manager '{process}'"
            end = f"rosrun nodelet nodelet unload {name} {process}"
        whose = f" of {owner}" if owner not in (name, process) else ""
        super().__init__(
            f"'{name}' is not this manager's: it runs in {where}{whose}; end it with: {end}"
        )


class Refused(DyKnowError):
    """A DyKnow manager or a proxy refused a request; the text says why."""


class ManagerUnreachable(DyKnowError):
    """There is no ROS master, or no DyKnow manager that answers; the text says which."""


class NodeletUnreachable(DyKnowError):
    """A nodelet's proxy does not answer; it may or may not have served the request."""


class StoreError(DyKnowError):
    """The durable state cannot be read or written."""

    def __init__(self, path: str, reason: object) -> None:
        self.path = path
        super().__init__(f"state file '{path}': {reason}")


class NodeletError(DyKnowError):
    """Something about one nodelet, known by its name."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        super().__init__(text)


class NameTaken(NodeletError):
    """A nodelet of that name is loaded, is being loaded, or is being unloaded; or a node runs."""

    def __init__(self, name: str, state: str = "already loaded", what: str = "a nodelet") -> None:
        self.holder = f"{what} named '{name}' is {state}"
        super().__init__(name, f"{self.holder}; choose another name")


class UnknownNodelet(NodeletError):
    """No nodelet of that name is loaded here."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        self.known = tuple(sorted(known))
        hint = did_you_mean(name, self.known)
        text = f"no nodelet named '{name}' is loaded; loaded: {_listed(self.known)}{hint}"
        super().__init__(name, text)


class UnknownNodeletType(NodeletError):
    """No plugin description declares that type."""

    def __init__(self, type_name: str, known: Iterable[str], broken: Sequence[str] = ()) -> None:
        self.known = tuple(sorted(known))
        self.broken = tuple(broken)
        text = (
            f"no package declares a nodelet type '{type_name}'; declared types: "
            f"{_listed(self.known)}{did_you_mean(type_name, self.known)}"
        )
        if broken:
            text += "; descriptions that could not be used: " + "; ".join(broken)
        super().__init__(type_name, text)


class BrokenPlugin(NodeletError):
    """A declared plugin cannot be used: bad description, no import, no Nodelet."""

    def __init__(self, what: str, reason: str) -> None:
        self.reason = reason
        super().__init__(what, f"{what}: {reason}")


class BadRemapping(NodeletError):
    """Remapping sources and targets of a load request do not pair up."""

    def __init__(self, name: str, sources: int, targets: int) -> None:
        super().__init__(
            name,
            f"cannot load '{name}': {sources} remap_source_args but {targets} remap_target_args; "
            "expected one target for each source",
        )


class LoadFailed(NodeletError):
    """The nodelet's constructor or ``on_init`` raised; nothing of it is left."""

    def __init__(self, name: str, type_name: str, cause: BaseException) -> None:
        self.cause = cause
        super().__init__(name, f"cannot load '{name}' of type {type_name}: {described(cause)}")


class ScriptEnded(NodeletError):
    """A script ended as a program that has failed."""

    def __init__(self, name: str, code: object) -> None:
        self.code = code
        super().__init__(name, f"script '{name}' has ended: sys.exit({code!r})")


#: Where a script can do what only one of a process can.
_PROCESS = "a process of its own; spawn it isolated, or run it with 'nodelet standalone_script'"


class NeedsProcess(DyKnowError, ImportError):
    """A script does what cannot be done by one of many in a process.

    It is an ImportError too, so that scripts which can do without a module do.
    """

    def __init__(self, name: str, what: str, need: str = _PROCESS) -> None:
        self.nodelet = name
        self.what = what
        super().__init__(f"'{name}': {what} needs {need}")


class UnloadedMeanwhile(NodeletError):
    """The nodelet was unloaded before an operation on it was complete."""

    def __init__(self, name: str, operation: str) -> None:
        super().__init__(name, f"nodelet '{name}' was unloaded during its {operation}")


class SpawnFailed(NodeletError):
    """A nodelet did not come up as its transformation says; nothing of it is left."""

    def __init__(self, name: str, reason: object) -> None:
        super().__init__(name, f"cannot spawn '{name}': {reason}")


class RestartFailed(NodeletError):
    """A nodelet did not come up again after it was ended for a restart.

    Attributes:
        is_back: whether it runs again as it was made before.
    """

    def __init__(self, name: str, reason: object, is_back: bool) -> None:
        self.is_back = is_back
        now = "it runs as its former specification says" if is_back else "it is tried again"
        super().__init__(name, f"'{name}' did not come up again: {reason}; {now}")


class CannotMove(NodeletError):
    """A nodelet stays in its nodelet manager, where it runs on."""

    def __init__(self, name: str, reason: object) -> None:
        super().__init__(name, f"'{name}' is not moved: {reason}")


class MoveFailed(NodeletError):
    """A nodelet did not come up in another nodelet manager, after it was unloaded from its own.

    Attributes:
        is_back: whether it runs in its own again.
    """

    def __init__(self, name: str, manager: str, reason: object, is_back: bool) -> None:
        self.is_back = is_back
        now = "it runs where it was again" if is_back else "it is tried again"
        super().__init__(name, f"'{name}' did not come up in {manager}: {reason}; {now}")


class Busy(NodeletError):
    """Another operation works on the nodelet now."""

    def __init__(self, name: str) -> None:
        super().__init__(name, f"nodelet '{name}' is being changed by another client; try again")


class Protected(NodeletError):
    """A protected nodelet was to be destroyed."""

    def __init__(self, name: str) -> None:
        super().__init__(
            name, f"nodelet '{name}' is protected; release it first: dyknow unprotect {name}"
        )


class ProtectedFromUnloading(NodeletError):
    """A request to unload a nodelet that a DyKnow manager protects."""

    def __init__(self, name: str) -> None:
        super().__init__(
            name,
            f"nodelet '{name}' is protected from unloading by its DyKnow manager; release it "
            f"first: dyknow unprotect {name}",
        )


class PortError(DyKnowError):
    """Something about the ports of one nodelet."""


class PortConflict(PortError):
    """A port is declared again with another direction or type."""

    def __init__(self, port: str, present: str, wanted: str) -> None:
        self.port = port
        super().__init__(
            f"port '{port}' exists as {present} and cannot also be {wanted}: "
            "the name of a port is unique in its nodelet"
        )


class UnknownPort(PortError):
    """A port was named that the nodelet does not have."""

    def __init__(self, port: str, known: Iterable[str]) -> None:
        self.port = port
        self.known = tuple(sorted(known))
        hint = did_you_mean(port, self.known)
        super().__init__(f"unknown port '{port}'; known ports: {_listed(self.known)}{hint}")


class DuplicatePort(PortError):
    """A port was named more than once in one request."""

    def __init__(self, port: str) -> None:
        self.port = port
        super().__init__(f"port '{port}' is named twice or more; expected one topic for each port")


class InvalidConfiguration(PortError):
    """All that is wrong with one configuration; nothing of it was applied."""

    def __init__(self, nodelet: str, problems: Sequence[DyKnowError]) -> None:
        self.nodelet = nodelet
        self.problems: tuple[DyKnowError, ...] = tuple(problems)
        super().__init__(
            f"{nodelet}: nothing was changed: " + "; ".join(str(problem) for problem in problems)
        )


class TransformationError(DyKnowError):
    """Something about one transformation, known by its label."""


class UnknownTransformation(TransformationError):
    """The library has no transformation of that label."""

    def __init__(self, label: str, hint: str = "") -> None:
        self.label = label
        super().__init__(f"no transformation is labelled '{label}'{hint}")


class NotSpawnable(TransformationError):
    """A transformation describes an external node or topic."""

    def __init__(self, label: str, what: str) -> None:
        self.label = label
        super().__init__(
            f"transformation '{label}' is the existing {what}: "
            "it is used as it is and cannot be spawned"
        )


class InvalidParameters(TransformationError):
    """All that is wrong with the parameters that are given to one nodelet."""

    def __init__(self, label: str, problems: Sequence[str]) -> None:
        self.label = label
        self.problems: tuple[str, ...] = tuple(problems)
        super().__init__(f"parameters of transformation '{label}': {'; '.join(problems)}")


class StreamError(DyKnowError):
    """Something about one stream."""


def waiting(claim_id: str) -> str:
    """End of the text of a refused stream; empty unless its claim is kept."""
    return f"; claim {claim_id} waits until it can be made" if claim_id else ""


class InvalidTag(StreamError):
    """A tag is not a term."""

    def __init__(self, tag: str, expected: str) -> None:
        self.tag = tag
        self.expected = expected
        super().__init__(f"'{tag}' is not a tag: {expected}")


class InvalidType(InvalidTag):
    """A tag is not a term, since the type of a variable is malformed."""


class NoPlanFound(StreamError):
    """Nothing supplies a requested stream now."""

    def __init__(self, reason: str, claim_id: str = "") -> None:
        self.claim_id = claim_id
        super().__init__(reason + waiting(claim_id))


class StreamTypeMismatch(StreamError):
    """A stream turned out to have another type than the requested one.

    Attributes:
        label: the transformation that supplies it.
        consumer: the transformation of which an in-port turned out to have the other type.
    """

    def __init__(
        self, tag: str, wanted: str, found: str, label: str = "", consumer: str = ""
    ) -> None:
        self.label = label
        self.consumer = consumer
        super().__init__(f"the stream {tag} carries {found}, but {wanted} was requested")


class WrongStream(StreamError):
    """A connection was not made, since a consumer would receive an unsuitable stream."""

    def __init__(self, topic: str, sender: str, listener: str) -> None:
        self.topic = topic
        who = sender or "an ordinary node"
        whom = listener or "a client"
        super().__init__(f"on topic '{topic}', {who} sends what {whom} there does not ask for")


class UnknownClaim(StreamError):
    """No claim of that id is kept."""

    def __init__(self, claim_id: str, state: str = "") -> None:
        self.claim_id = claim_id
        super().__init__(
            f"claim '{claim_id}' is {state}" if state else f"there is no claim '{claim_id}'"
        )


class Result(enum.IntEnum):
    """Why a stream was not made; the numbers are those of ``dyknow_msgs/AcquireStream``."""

    OK = 0
    NO_PLAN = 1
    INVALID_TAG = 2
    TYPE_MISMATCH = 3
    SPAWN_FAILED = 4
    TIMEOUT = 5
    DENIED = 6


class StreamRefused(Refused):
    """The manager did not make a stream.

    Attributes:
        result: why, as a number.
        claim_id: the claim that waits until the stream can be made; empty if there is none.
        missing: the tags that nothing supplies, sorted; empty if that is not the reason.
    """

    def __init__(self, message: str, result: Result, claim_id: str = "") -> None:
        self.result = result
        self.claim_id = claim_id
        self.missing = read_missing(message)
        super().__init__(message)

    def given_up(self) -> StreamRefused:
        """Return the refusal as it is once the claim was released: nothing waits any more."""
        return StreamRefused(str(self).replace(waiting(self.claim_id), ""), self.result)


class Problem(NamedTuple):
    """One thing that is wrong, or at least doubtful, in a transformation specification.

    Attributes:
        file: The file, as it was named to the parser.
        line: The line in that file, counted from 1; 0 if the fault is not in one line.
        message: The fault, and the expected value.
    """

    file: str
    line: int
    message: str

    def __str__(self) -> str:
        """Write the problem as compilers do, so that editors find the place."""
        place = f"{self.file}:{self.line}" if self.line else self.file
        return f"{place}: {self.message}"


class SpecificationError(DyKnowError):
    """All that is wrong with one specification text; nothing of it was taken over."""

    def __init__(self, problems: Sequence[Problem], warnings: Sequence[Problem] = ()) -> None:
        self.problems: tuple[Problem, ...] = tuple(problems)
        self.warnings: tuple[Problem, ...] = tuple(warnings)
        super().__init__("\n".join(str(problem) for problem in problems))


class OntologyError(DyKnowError):
    """The ontology cannot answer."""


class OntologyFileError(OntologyError):
    """A file of the ontology cannot be read."""

    def __init__(self, file: str, reason: str) -> None:
        self.file = file
        self.reason = reason
        super().__init__(f"{file}: {reason}")


class UnknownConcept(OntologyError):
    """A class was named that the ontology does not have."""

    def __init__(self, concept: str) -> None:
        self.concept = concept
        super().__init__(f"the ontology has no class <{concept}>")


class LabelsError(OntologyError):
    """Classes, or individuals, have the same label; an ontology does not tell them apart by it."""

    def __init__(self, reasons: Sequence[str]) -> None:
        self.reasons: tuple[str, ...] = tuple(reasons)
        more = len(reasons) - self._LISTED
        listed = [*reasons[: self._LISTED], *([f"{more} more such pairs"] if more > 0 else [])]
        super().__init__("; ".join(listed) + "; expected a label of its own for each")

    _LISTED = 10


class IndividualsError(OntologyError):
    """Individuals of a class cannot serve as terms, since their labels do not tell them apart."""

    def __init__(self, concept: str, reasons: Sequence[str]) -> None:
        self.concept = concept
        self.reasons: tuple[str, ...] = tuple(reasons)
        super().__init__(f"the individuals of <{concept}>: " + "; ".join(reasons))
