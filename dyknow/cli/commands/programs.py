# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`run` and `probe`: programs of packages, re-wirable."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import signal
import sys
import tempfile
import time
from typing import TYPE_CHECKING, Any, Iterator

from dyknow import names
from dyknow.cli.arguments import argument
from dyknow.cli.output import transformation_json
from dyknow.cli.rewirable import become
from dyknow.cli.shell import Shell, command
from dyknow.errors import CannotRun, HostError, ManagerUnreachable, PeerTimeout
from dyknow.model.graph import PortState
from dyknow.model.transformation import NODE, Parameter, Port, Program, Transformation
from dyknow.ros.process.programs import find_program

if TYPE_CHECKING:
    from dyknow.ros.client import ProxyClient
    from dyknow.ros.process.os_process import ProcessId
    from dyknow.ros.wire.master import Master


#: A program and its arguments, as for rosrun.
_PROGRAM = (
    argument("package", "PKG", "a package"),
    argument("executable", "EXECUTABLE", "a program of it"),
    argument(
        "words",
        "ARGUMENT",
        "its arguments, remappings and parameters, as for rosrun",
        nargs=argparse.REMAINDER,
    ),
)


@command(
    "Runs a program of a package as rosrun does. A node of roscpp or rospy then has ports "
    "that can be connected elsewhere while it runs, and is shown with the nodelets. Anything "
    "else runs as it is, and says so. In a launch file the same is done by "
    'launch-prefix="rosrun dyknow rewirable".',
    "dyknow run topic_tools relay /scan /copy __name:=copier\n"
    "dyknow run topic_tools transform /numbers /doubled std_msgs/Float64 'm.data * 2'\n"
    "dyknow run nodelet nodelet standalone image_proc/resize image:=/camera/image_raw",
    *_PROGRAM,
)
def _run(arguments: argparse.Namespace, shell: Shell) -> None:
    become([find_program(arguments.package, arguments.executable), *arguments.words])


_STEP = 0.1  # seconds between two questions for its ports
_ANSWER = 2.0  # seconds for one answer
_PATIENCE = 3.0  # seconds that the node has to end
_LINES = 5  # lines of its output that are shown when it fails
#: Topics that all nodes share. The node stays on them, since they are not declared.
_SHARED = re.compile(
    r"/(tf|tf_static|clock|rosout|rosout_agg|diagnostics|diagnostics_agg|statistics)"
    r"|.*/(parameter_updates|parameter_descriptions|bond)"
)


@command(
    "Runs a program of a package once, in a namespace of its own, until its ports are there, "
    "and prints a transformation to begin with: its ports with their types, and the "
    "parameters in its own namespace. Ports that come later, such as those that a lazy node "
    "makes for its first subscriber, are missing; tags are to be added. Nothing is spawned, and "
    "no manager is needed. Options come before PKG.",
    "dyknow probe topic_tools relay /scan /copy > copier.xml\n"
    "dyknow probe --settle 5 image_view image_saver image:=/camera/image",
    argument(
        "--settle",
        "S",
        "end when no port has come for so many seconds (default: %(default)s)",
        default=2.0,
    ),
    argument(
        "--start", "S", "seconds that its first port may take (default: %(default)s)", default=20.0
    ),
    *_PROGRAM,
)
def _probe(arguments: argparse.Namespace, shell: Shell) -> None:
    from dyknow.ros.client import ProxyClient
    from dyknow.ros.process import os_process
    from dyknow.ros.wire.master import Master

    path = find_program(arguments.package, arguments.executable)
    name = f"/dyknow_probe_{os.getpid()}/{_base(arguments.executable)}"
    master = Master(name)
    try:
        master.ask("getPid")
    except PeerTimeout as error:
        raise ManagerUnreachable(
            f"no ROS master at {master.uri}: is roscore running, and ROS_MASTER_URI right?"
        ) from error
    with tempfile.TemporaryDirectory() as folder:
        output = os.path.join(folder, "output")
        own = (f"__name:={_base(arguments.executable)}", f"__ns:={names.parent(name)}")
        command = (sys.executable, "-m", "dyknow.cli.rewirable", path, *arguments.words, *own)
        process = os_process.start(command, output, os.getcwd())
        try:
            ports = _settled(ProxyClient(master), name, process, output, arguments)
            found: Any = {}
            with contextlib.suppress(LookupError, PeerTimeout):
                found = master.ask("getParam", name)
        finally:
            process.end(_PATIENCE, (signal.SIGINT, signal.SIGTERM))
            process.wait_for_rest()
            _clean_up(master, name)
    plain = tuple(word for word in arguments.words if ":=" not in word)
    shared = [each for each in ports if _SHARED.fullmatch(names.resolve(each.name, "/", name))]
    transformation = Transformation(
        _base(arguments.executable),
        Program(arguments.package, arguments.executable, plain).source,
        NODE,
        parameters=tuple(_parameters(found)),
        ports=tuple(
            Port(port.name, port.direction, port.datatype.replace("*", ""))
            for port in ports
            if port not in shared
        ),
    )
    text = transformation.to_xml()
    if shared:
        further = ", ".join(f"{port.name} ({port.direction})" for port in shared)
        text = f"<!-- Further topics, which the node shares with others: {further} -->\n{text}"
    shell.show_file(
        {
            "transformation": transformation_json(transformation),
            "specification": transformation.to_xml(),
            "not_declared": [port.name for port in shared],
        },
        text,
    )


def _base(executable: str) -> str:
    """Name a node after its program."""
    stem = re.sub(r"\W+", "_", executable.rpartition(".")[0] or executable).strip("_")
    return stem if stem[:1].isalpha() else f"node_{stem}"


def _settled(
    client: ProxyClient, name: str, process: ProcessId, output: str, arguments: argparse.Namespace
) -> list[PortState]:
    """Wait until a node has made its ports; raises CannotRun if it ends, or makes none in time."""
    begin = since = time.monotonic()
    ports: list[PortState] = []
    while True:
        now = time.monotonic()
        if not process.alive:
            raise CannotRun(f"the node ended by itself{_printed(output)}")
        try:
            found = list(client.get_config(name, _ANSWER))
        except (HostError, PeerTimeout, LookupError):
            found = ports
        if found != ports:
            ports, since = found, now
        if ports and now - since >= arguments.settle:
            return ports
        if not ports and now - begin >= arguments.start:
            raise CannotRun(
                f"the node offered no ports within {arguments.start:g} s{_printed(output)}"
            )
        time.sleep(_STEP)


def _printed(output: str) -> str:
    with open(output, encoding="utf-8", errors="replace") as file:
        lines = [line.rstrip() for line in file if line.strip()][-_LINES:]
    return "; it printed at last:\n  " + "\n  ".join(lines) if lines else ", and printed nothing"


#: Types of parameters, by those of Python.
_TYPES = {bool: "bool", int: "int", float: "double", list: "yaml"}


def _parameters(tree: Any, above: str = "") -> Iterator[Parameter]:
    """Yield the parameters of a namespace: given to the node, or set by itself."""
    from dyknow.manager.specifications.values import as_yaml

    for key, value in sorted(tree.items()) if isinstance(tree, dict) else ():
        name = f"{above}{key}"
        if isinstance(value, dict):
            # Its guards are a DyKnow manager's, for as long as that sees the node.
            yield from _parameters(value, name + "/") if name != "guards" else ()
        else:
            type_ = _TYPES.get(type(value), "string")
            text = as_yaml(value) if type_ in ("bool", "yaml") else str(value).strip()
            yield Parameter(name, type_, text)


def _clean_up(master: Master, name: str) -> None:
    """Remove the node's registrations and parameters from the master."""
    with contextlib.suppress(LookupError, PeerTimeout):  # nothing is left, or no master
        uri = master.node(name)
        if uri:
            master.purge(name, uri)
        master.ask("deleteParam", names.parent(name))
