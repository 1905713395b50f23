# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Completion: argcomplete finds the argument at the cursor, this module its possible values.

They ask the manager and the master, and offer nothing if these do not answer quickly.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import signal
from typing import TYPE_CHECKING, Any, Callable, Iterable, List, Sequence

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.errors import CannotLaunch, DyKnowError
from dyknow.model.graph import NodeletStatus, PortRef
from dyknow.model.transformation import IN, OUT, Transformation
from dyknow.wiring.ports import topics_of

if TYPE_CHECKING:
    from dyknow.ros.shell.shell_client import ShellClient

#: What argcomplete calls, with the keywords `prefix`, `action`, `parser` and `parsed_args`.
Completer = Callable[..., List[str]]

_TIMEOUT = 0.2  # seconds to wait for each answer
#: Seconds after which an answer is given up; 100,000 labels would take longer. The start of Python
#: does not count: on a busy machine it alone takes so long.
_LIMIT = 1.0
#: In names of files, what stands for bytes that are not UTF-8.
_NO_UNICODE = re.compile("[\ud800-\udfff]")


def autocomplete(parser: argparse.ArgumentParser) -> None:
    """If the shell asks for completions, print them and end the process.

    The shell asks by the environment variable `_ARGCOMPLETE`.
    """
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    argcomplete.autocomplete(parser, always_complete_options=False, default_completer=_nothing)


def connect(manager_node: str) -> ShellClient:
    """Make a client that answers quickly or not at all: the process ends at the limit."""
    from dyknow.ros.shell.shell_client import ShellClient

    signal.signal(signal.SIGALRM, lambda *_: os._exit(1))
    signal.setitimer(signal.ITIMER_REAL, _LIMIT)
    return ShellClient(manager_node, _TIMEOUT)


class _Cursor:
    """The value at the cursor, as far as it is typed, with the arguments before it."""

    def __init__(self, client: ShellClient, prefix: str, arguments: argparse.Namespace) -> None:
        self.client = client
        self.prefix = prefix
        self._arguments = arguments

    def given(self, argument: str) -> Any:
        """The value that an argument has already, or None."""
        return getattr(self._arguments, argument, None)

    def nodelets(self) -> Sequence[NodeletStatus]:
        return self.client.get_graph().nodelets

    def nodelet(self, name: str) -> NodeletStatus | None:
        return self.client.get_graph().nodelet(self.resolve(name))

    def topics(self) -> list[str]:
        """The topics of nodelets and of ordinary nodes, sorted."""
        own = {topic.name for topic in topics_of(self.nodelets())}
        return sorted(own | set(self.client.datatypes()))

    def transformations(self, label: str | None = None) -> Sequence[Transformation]:
        """The transformations of the library, or the one of a label if there is one."""
        found = self.client.get_model().transformations
        return found if label is None else [each for each in found if each.label == label]

    def resolve(self, name: str) -> str:
        return name if name.startswith("/") else names.join(self.client.namespace, name)

    def as_typed(self, found: Iterable[str]) -> list[str]:
        """Strip the manager's namespace if the user began with a relative name."""
        if not self.prefix or self.prefix.startswith("/"):
            return list(found)
        space = self.client.namespace.rstrip("/") + "/"
        return [name[len(space) :] for name in found if name.startswith(space)]

    def not_named(self, found: Iterable[str]) -> list[str]:
        """Leave out the names that the command line has already."""
        return self.as_typed(set(found) - set(map(self.resolve, self.given("names") or ())))

    def ports(self, direction: str = "", datatype: str = "") -> list[str]:
        """List the ports of the nodelet that is typed, or else the nodelets with such ports.

        An empty direction stands for both, and an empty type for any.
        """
        name, colon, _ = self.prefix.rpartition(":")
        fitting = {
            nodelet.name: [
                f"{name}:{port.name}"
                for port in nodelet.ports
                if direction in ("", port.direction) and types_fit(datatype, port.datatype)
            ]
            for nodelet in self.nodelets()
        }
        if colon:
            return fitting.get(self.resolve(name), [])
        return self.as_typed(f"{nodelet}:" for nodelet, ports in fitting.items() if ports)

    def topics_beside_ports(self) -> Iterable[str]:
        return () if ":" in self.prefix else self.as_typed(self.topics())


def _completer(find: Callable[[_Cursor], Iterable[str]]) -> Completer:
    def complete(prefix: str, parsed_args: argparse.Namespace, **_: object) -> list[str]:
        from dyknow.cli.arguments import default_manager  # which declares completers

        node = getattr(parsed_args, "manager_node", None) or default_manager()
        try:
            return sorted(set(find(_Cursor(connect(node), prefix, parsed_args))))
        except DyKnowError:
            return []

    return complete


topics = _completer(lambda cursor: cursor.as_typed(cursor.topics()))
managers = _completer(lambda cursor: cursor.client.managers())
nodelets = _completer(lambda cursor: cursor.not_named(each.name for each in cursor.nodelets()))
nodelet_managers = _completer(lambda cursor: cursor.as_typed(cursor.client.nodelet_managers()))
restartable = _completer(
    lambda cursor: cursor.not_named(
        [*(each.name for each in cursor.nodelets()), *cursor.client.nodelet_managers()]
    )
)
hosts = _completer(lambda cursor: (each.name for each in cursor.client.list_hosts()))
ports = _completer(lambda cursor: cursor.ports())
stream_sources = _completer(lambda cursor: [*cursor.ports(OUT), *cursor.topics_beside_ports()])
spawnable_labels = _completer(
    lambda cursor: (each.label for each in cursor.transformations() if not each.is_described)
)


@_completer
def parameters_of_nodelet(cursor: _Cursor) -> Iterable[str]:
    """Parameters that were given to a nodelet, or that its transformation declares."""
    nodelet = cursor.nodelet(cursor.given("name") or "")
    if nodelet is None:
        return []
    declared = [each.parameters for each in cursor.transformations(nodelet.transformation)]
    given = itertools.chain(nodelet.parameters, *declared)
    return [each.name for each in given if each.name[:1] != "?"]


@_completer
def namespaces(cursor: _Cursor) -> Iterable[str]:
    spaces = {names.parent(each.name) for each in cursor.nodelets()}
    return cursor.as_typed(spaces - {"/"})


@_completer
def labels(cursor: _Cursor) -> Iterable[str]:
    """Labels of the library that the command line does not name yet."""
    return {each.label for each in cursor.transformations()} - set(cursor.given("labels") or ())


@_completer
def claims(cursor: _Cursor) -> Iterable[str]:
    """Claims that have not ended and that the command line does not name yet."""
    running = {each.claim_id for each in cursor.client.list_streams() if not each.state.ended}
    return running - set(cursor.given("claims") or ())


@_completer
def tags(cursor: _Cursor) -> Iterable[str]:
    """Tags that some transformation supplies."""
    ports = (port for each in cursor.transformations() for port in each.ports)
    return (tag for port in ports if port.direction == OUT for tag in port.tags)


@_completer
def ports_of_label(cursor: _Cursor) -> Iterable[str]:
    """Ports of the transformation that is to be spawned, and the ends behind them, `PORT:END`."""
    name, colon, _ = cursor.prefix.partition(":")
    own = [
        port for each in cursor.transformations(cursor.given("label") or "") for port in each.ports
    ]
    if not colon:
        return (f"{port.name}:" for port in own)
    peers = [
        f"{each.name}:{peer.name}"
        for each in cursor.nodelets()
        for peer in each.ports
        if any(port.name == name and port.direction != peer.direction for port in own)
    ]
    return [f"{name}:{end}" for end in (*cursor.topics(), *peers)]


@_completer
def parameters_of_label(cursor: _Cursor) -> Iterable[str]:
    """Parameters and variables of the transformation that is to be spawned, `NAME=`."""
    from dyknow.manager.specifications.given import variables

    return (
        f"{name}="
        for each in cursor.transformations(cursor.given("label") or "")
        for name in (*[parameter.name for parameter in each.parameters], *variables(each))
    )


@_completer
def stream_targets(cursor: _Cursor) -> Iterable[str]:
    """In-ports that fit the source, and topics if the source is a port."""
    source = cursor.given("source")
    if not isinstance(source, PortRef):
        return cursor.ports(IN)
    nodelet = cursor.nodelet(source.nodelet)
    port = nodelet.port(source.port) if nodelet is not None else None
    return [*cursor.ports(IN, port.datatype if port else ""), *cursor.topics_beside_ports()]


@_completer
def formulas(cursor: _Cursor) -> Iterable[str]:
    """The formula with the names of fields, or of ports, in the place of its last word."""
    from dyknow.ros.formulas.message_types import message_type

    begin, word = re.fullmatch(r"(?s)(.*?)([\w.]*)", cursor.prefix).groups()  # type: ignore[union-attr]
    *path, last = word.split(".")
    datatypes = cursor.client.datatypes()
    ports = {topic[1:]: topic for topic in datatypes if topic[1:].isidentifier()}
    ports.update(port for port in cursor.given("topic") or () if port[0])
    if not path:
        return [f"{begin}{port}." for port in ports if port.startswith(last)]
    found = message_type(datatypes.get(ports.get(path[0], ""), ""))
    for step in path[1:]:
        found = message_type(found.fields.get(step, "")) if found is not None else None
    fields = found.fields if found is not None else {}
    before = ".".join(path)
    dots = {name: "." if "/" in kind and "[" not in kind else "" for name, kind in fields.items()}
    return [f"{begin}{before}.{name}{dot}" for name, dot in dots.items() if name.startswith(last)]


@_completer
def formula_topics(cursor: _Cursor) -> Iterable[str]:
    """Topics, behind `PORT=` if that is typed."""
    port, equals, _ = cursor.prefix.rpartition("=")
    return [f"{port}{equals}{topic}" for topic in cursor.topics()]


def packages(prefix: str, **_: object) -> list[str]:
    import rospkg

    return sorted(name for name in rospkg.RosPack().list() if name.startswith(prefix))


def launch_words(prefix: str, parsed_args: argparse.Namespace, **_: object) -> list[str]:
    """A package or a launch file, launch files of the package, and then their arguments."""
    from dyknow.cli.launch_files import arguments_of, find_files, launch_files

    words = parsed_args.words or []
    if not words:
        return [*packages(prefix), *files(prefix)]
    try:
        found = find_files([word for word in words if ":=" not in word])
    except CannotLaunch:
        return launch_files(words[0])
    return [f"{name}:=" for file in found for name in arguments_of(file)]


def files(prefix: str, **_: object) -> list[str]:
    """Files and folders, hidden ones only behind a dot; no names that are not Unicode.

    argcomplete's own completer finds nothing in a folder with one of these.
    """
    begin = os.path.basename(prefix)
    folder = prefix[: len(prefix) - len(begin)]
    try:
        with os.scandir(os.path.expanduser(folder) or ".") as entries:
            found = [each.name + "/" * each.is_dir() for each in entries]
    except OSError:
        return []
    named = (name for name in found if name.startswith(begin) and not _NO_UNICODE.search(name))
    return sorted(folder + name for name in named if begin or not name.startswith("."))


def _nothing(**_: object) -> list[str]:
    """Offer nothing for an argument that has no completer."""
    return []
