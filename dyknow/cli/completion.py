"""What may stand at the cursor of an unfinished command line."""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, field
from typing import (
    TYPE_CHECKING,
    Callable,
    Dict,
    Iterable,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
)

from dyknow import names
from dyknow.cli.arguments import Kind, kind_of
from dyknow.cli.topics import topics_of
from dyknow.model.transformation import IN, NODELET, OUT
from dyknow.wiring.ports import types_fit

if TYPE_CHECKING:
    from dyknow.ros.shell_client import ShellClient
    from dyknow.ros.views import NodeletView

Parsers = Tuple[argparse.ArgumentParser, Mapping[str, argparse.ArgumentParser]]


@dataclass
class Place:
    """What the words before the cursor ask for.

    Attributes:
        parser: of the command, or of `dyknow` itself while the command is to come.
        action: the argument that stands at the cursor, or None.
        only: whether nothing but a value of `action` may stand there: no option.
        given: words that were given to each argument, by its name.
    """

    parser: argparse.ArgumentParser
    action: Optional[argparse.Action] = None
    only: bool = False
    given: Dict[str, List[str]] = field(default_factory=dict)


def complete(
    parsers: Parsers, words: Sequence[str], last: str, client: Callable[[str], ShellClient]
) -> List[str]:
    """List what the last word may become.

    Args:
        parsers: That of the program, and those of its commands by name.
        words: The words before it, without the program's name.
        last: What is there of it.
        client: Makes a client of the manager of that name, empty for the default.
    """
    option, equals, value = last.partition("=")
    if option.startswith("--") and equals:
        return [f"{option}={each}" for each in complete(parsers, [*words, option], value, client)]
    program, commands = parsers
    place = find_place(program, commands, words)
    if last.startswith("-") and not place.only:
        found: Iterable[str] = _options(place.parser)
    elif place.parser is program and place.action is None:
        found = [name for name in commands if name != "complete"]
    else:
        kind = kind_of(place.action) if place.action is not None else None
        found = _values(kind, place, last, client)
    return sorted({each for each in found if each.startswith(last)})


def find_place(
    program: argparse.ArgumentParser,
    parsers: Mapping[str, argparse.ArgumentParser],
    words: Sequence[str],
) -> Place:
    """Find out which argument follows some words."""
    place = Place(program)
    positionals: List[argparse.Action] = []
    waiting: Optional[argparse.Action] = None
    needed = 0
    literal = False
    for word in words:
        if ":=" in word:
            continue
        if waiting is not None and (needed or literal or not word.startswith("-")):
            place.given.setdefault(waiting.dest, []).append(word)
            needed = 0
            waiting = waiting if waiting.nargs == "+" else None
        elif word == "--":
            waiting, literal = None, True
        elif word.startswith("-") and not literal:
            waiting, needed = _begin_option(place, word)
        elif place.parser is program:
            if word not in parsers:
                return Place(program, only=True, action=argparse.Action([], "unknown"))
            place.parser = parsers[word]
            positionals = [each for each in _actions(place.parser) if not each.option_strings]
        elif positionals:
            place.given.setdefault(positionals[0].dest, []).append(word)
            if positionals[0].nargs not in ("+", "*"):
                positionals.pop(0)
    if waiting is not None:
        place.action, place.only = waiting, bool(needed)
    elif positionals:
        place.action = positionals[0]
    return place


def _begin_option(place: Place, word: str) -> Tuple[Optional[argparse.Action], int]:
    """Tell which option waits for values now, and how many it needs at least."""
    name, equals, value = word.partition("=")
    action = next((each for each in _actions(place.parser) if name in each.option_strings), None)
    if action is None or action.nargs == 0:
        return None, 0
    if equals:
        place.given.setdefault(action.dest, []).append(value)
        return None, 0
    return action, 0 if action.nargs == "?" else 1


def _actions(parser: argparse.ArgumentParser) -> List[argparse.Action]:
    return parser._actions


def _options(parser: argparse.ArgumentParser) -> List[str]:
    return [text for action in _actions(parser) for text in action.option_strings if len(text) > 2]


def _values(
    kind: Optional[Kind], place: Place, last: str, client: Callable[[str], ShellClient]
) -> Iterable[str]:
    if kind is None:
        return ()
    if kind is Kind.FILE:
        return _files(last)
    nodes = place.given.get("manager_node", [])
    return _Names(client(nodes[-1] if nodes else ""), place, last).of(kind)


def _files(last: str) -> List[str]:
    folder, _, begin = last.rpartition("/")
    typed = folder + "/" if "/" in last else ""
    try:
        entries = list(os.scandir(os.path.expanduser(typed) or "."))
    except OSError:
        return []
    return [
        typed + entry.name + ("/" if entry.is_dir() else "")
        for entry in entries
        if entry.name.startswith(begin) and (begin or not entry.name.startswith("."))
    ]


class _Names:
    """Names that the manager and the master know."""

    def __init__(self, client: ShellClient, place: Place, last: str) -> None:
        self._client = client
        self._place = place
        self._last = last

    def of(self, kind: Kind) -> Iterable[str]:
        """List the names of a kind."""
        if kind is Kind.NODELET:
            done = {self._global(word) for word in self._words("names")}
            found = [each.name for each in self._nodelets() if each.name not in done]
            return self._as_typed(found)
        if kind is Kind.NAMESPACE:
            spaces = {names.parent(each.name) for each in self._nodelets()}
            return self._as_typed(space for space in spaces if space != "/")
        if kind is Kind.LABEL:
            return set(self._labels()) - set(self._words("labels"))
        if kind is Kind.SPAWNABLE:
            return self._labels(NODELET)
        if kind is Kind.TOPIC:
            return self._as_typed(self._topics())
        if kind is Kind.NODELET_MANAGER:
            return self._as_typed(self._client.nodelet_managers())
        if kind is Kind.MANAGER:
            return self._client.managers()
        if kind is Kind.CLAIM:
            return self._claims()
        if kind is Kind.TAG:
            return self._tags()
        if kind is Kind.PORT_OF_LABEL:
            return self._ports_of_label()
        if kind in (Kind.STREAM_SOURCE, Kind.STREAM_TARGET):
            return self._ends(kind)
        return self._ports("")

    def _nodelets(self) -> tuple[NodeletView, ...]:
        return self._client.nodelets().nodelets

    def _words(self, argument: str) -> List[str]:
        return self._place.given.get(argument, [])

    def _global(self, name: str) -> str:
        return name if name.startswith("/") else names.join(self._client.namespace, name)

    def _as_typed(self, found: Iterable[str]) -> List[str]:
        """Leave the manager's namespace out of names if the user has begun so."""
        if not self._last or self._last.startswith("/"):
            return list(found)
        space = self._client.namespace.rstrip("/") + "/"
        return [name[len(space) :] for name in found if name.startswith(space)]

    def _labels(self, type_: str = "") -> List[str]:
        transformations = self._client.model().transformations
        return [each.label for each in transformations if not type_ or each.type == type_]

    def _topics(self) -> List[str]:
        own = {topic.name for topic in topics_of(self._client.nodelets())}
        return sorted(own | set(self._client.topics()))

    def _claims(self) -> List[str]:
        named = set(self._words("claims"))
        streams = self._client.list_streams()
        return [
            each.claim_id
            for each in streams
            if not each.state.ended and each.claim_id not in named
        ]

    def _tags(self) -> set[str]:
        return {
            tag
            for each in self._client.model().transformations
            for port in each.ports
            if port.direction == OUT
            for tag in port.tags
        }

    def _ports_of_label(self) -> List[str]:
        port, colon, _ = self._last.partition(":")
        if colon:
            return [f"{port}:{topic}" for topic in self._topics()]
        label = "".join(self._words("label"))
        return [
            f"{port.name}:"
            for each in self._client.model().transformations
            if each.label == label
            for port in each.ports
        ]

    def _ports(self, direction: str) -> List[str]:
        """Nodelets with such ports, or such ports of the nodelet that is there already."""
        fitting = self._type_of_source() if direction == IN else ""
        name, colon, _ = self._last.rpartition(":")
        found = []
        for nodelet in self._nodelets():
            ports = [
                port.name
                for port in nodelet.ports
                if direction in ("", port.direction) and types_fit(fitting, port.datatype)
            ]
            if not colon and ports:
                found.extend(self._as_typed([nodelet.name + ":"]))
            elif colon and nodelet.name == self._global(name):
                found.extend(f"{name}:{port}" for port in ports)
        return found

    def _ends(self, kind: Kind) -> Iterable[str]:
        """Ports, and topics too where the other end is a port or not there yet."""
        ports = self._ports(OUT if kind is Kind.STREAM_SOURCE else IN)
        from_topic = bool(self._words("source")) and ":" not in self._words("source")[-1]
        if ":" in self._last or (kind is Kind.STREAM_TARGET and from_topic):
            return ports
        return [*ports, *self._as_typed(self._topics())]

    def _type_of_source(self) -> str:
        """ROS type of the out-port that is to be connected, empty if that is not known."""
        name, _, port = "".join(self._words("source")).rpartition(":")
        for nodelet in self._nodelets():
            if nodelet.name == self._global(name):
                found = nodelet.port(port)
                return found.datatype if found is not None else ""
        return ""
