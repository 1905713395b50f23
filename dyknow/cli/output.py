# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The output of commands: JSON, tables, values that change, and files."""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import json
import os
import shutil
import tempfile
import time
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Sequence

from dyknow.cli.shell import Shell
from dyknow.errors import DyKnowError
from dyknow.model.transformation import Parameter, Transformation
from dyknow.similar import did_you_mean
from dyknow.wiring.ports import by_name

if TYPE_CHECKING:
    from dyknow.model.graph import Model, NodeletStatus
    from dyknow.model.statistics import NodeletStatistics, PortStatistics
    from dyknow.model.streams import StreamEvent, StreamStatus


Json = Dict[str, Any]


def as_json(value: Any) -> Any:
    """Make JSON of a value: of sequences lists, of sets sorted ones, of dataclasses objects."""
    if isinstance(value, enum.Enum):
        return value.name.lower() if isinstance(value, enum.IntEnum) else value.value
    if dataclasses.is_dataclass(value):
        return {field.name: as_json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [as_json(each) for each in (sorted(value) if isinstance(value, set) else value)]
    return value


def picked(value: object, names: str) -> Json:
    """Make a JSON object of some attributes; `key=attribute` calls one by another name."""
    pairs = (name.partition("=")[::2] for name in names.split())
    return {key: as_json(getattr(value, attribute or key)) for key, attribute in pairs}


def nodelet_json(nodelet: NodeletStatus) -> Json:
    named = "name transformation manager protected=is_protected isolated fixed=is_fixed"
    return {
        **picked(nodelet, f"{named} kind host state detail outdated owner"),
        "ports": as_json(by_name(nodelet.ports)),
        "parameters": _parameters_json(nodelet.parameters),
    }


def _parameters_json(parameters: Sequence[Parameter]) -> list[Json]:
    return [picked(each, "name type value=text") for each in parameters]


def transformation_json(transformation: Transformation) -> Json:
    return {
        **picked(transformation, "label type source node isolated cost"),
        "parameters": _parameters_json(transformation.parameters),
        "ports": [picked(port, "name direction datatype tags") for port in transformation.ports],
        "specification": transformation.to_xml(),
    }


#: Returns the transports of a port of a nodelet to other processes.
Transports = Callable[[str, "PortStatistics"], List[str]]


def statistics_json(name: str, statistics: NodeletStatistics, transports: Transports) -> Json:
    """The statistics of a nodelet; times in s, rates in Hz, null where nothing is counted."""
    counted = "name=port direction topic messages dropped rate mean_callback max_callback"
    ports = [
        {**picked(each, counted), "transports": transports(name, each)}
        for each in sorted(statistics.ports, key=lambda port: port.port)
    ]
    return {
        "nodelet": name,
        **picked(statistics, "uptime reconfigurations callback_errors"),
        "ports": ports,
    }


def stream_json(stream: StreamStatus) -> Json:
    """A claim; its lease ends at `expires`, in seconds of ROS time, or never if that is null."""
    named = "claim=claim_id client=client_id tag topic datatype state detail nodelets"
    bindings = list(stream.bindings)
    return {**picked(stream, named), "expires": stream.expires or None, "bindings": bindings}


def event_json(event: StreamEvent) -> Json:
    """A change of a claim; ``before`` is null for a new one."""
    return {
        "stamp": event.stamp,
        "before": stream_json(event.before) if event.before is not None else None,
        "after": stream_json(event.after),
        "reason": event.reason,
    }


def state_of(nodelet: NodeletStatus) -> str:
    return nodelet.state.name.lower()


def unknown_nodelet(name: str, model: Model) -> str:
    """Write that no nodelet has this name, with similar names."""
    known = [nodelet.name for nodelet in model.nodelets]
    hint = did_you_mean(name, known) or "; see 'dyknow list'"
    return f"no nodelet named '{name}' runs{hint}"


def columns(rows: Sequence[Sequence[object]], right: Sequence[int] = ()) -> list[str]:
    """Return a line for each row of cells; the columns ``right`` are aligned right.

    None is written as a dash.
    """
    texts = [["-" if cell is None else str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts)]
    return [
        "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in texts
    ]


def count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


_HOME = "\x1b[H"
_CLEAR = "\x1b[2J"
_CLEAR_LINE = "\x1b[K"
_CLEAR_BELOW = "\x1b[J"


class Screen:
    """Shows a value that changes, every ``period`` seconds.

    On a terminal each value replaces the one before, cut to the window; lines are rewritten
    without clearing the screen, so that nothing flickers. Elsewhere an empty line separates
    values; as JSON each is one line.
    """

    def __init__(self, shell: Shell, period: float) -> None:
        self._shell = shell
        self._period = period
        self._in_place = shell.out.isatty() and not shell.as_json
        self._shown = False

    def show(self, value: Any, lines: Sequence[str]) -> None:
        out = self._shell.out
        if self._shell.as_json:
            out.write(json.dumps(value) + "\n")
        elif self._in_place:
            out.write(self._page(lines))
        else:
            out.write(("\n" if self._shown else "") + "".join(line + "\n" for line in lines))
        self._shown = True
        out.flush()

    def wait(self, begin: float) -> None:
        """Wait until a period has passed since `begin`, a time of the steady clock."""
        time.sleep(max(0.0, begin + self._period - time.monotonic()))

    def _page(self, lines: Sequence[str]) -> str:
        width, height = shutil.get_terminal_size()
        shown = list(lines)
        if len(shown) > height - 1:
            hidden = len(shown) - (height - 2)
            shown = [*shown[: height - 2], f"... {hidden} more lines"]
        text = _HOME if self._shown else _CLEAR + _HOME
        text += "".join(line[:width] + _CLEAR_LINE + "\n" for line in shown)
        return text + _CLEAR_BELOW


class CannotWrite(DyKnowError):
    """A file cannot be written."""


def write_file(path: str, data: bytes) -> None:
    """Write a file; an existing one is replaced once the new one is complete.

    Raises:
        CannotWrite: with the reason.
    """
    try:
        if os.path.exists(path) and not os.path.isfile(path):  # /dev/stdout, a pipe
            with open(path, "wb") as special:
                special.write(data)
            return
        _replace(os.path.realpath(path), data)
    except OSError as error:
        raise CannotWrite(f"{path}: cannot be written: {error.strerror}") from error


def _replace(path: str, data: bytes) -> None:
    handle, draft = tempfile.mkstemp(dir=os.path.dirname(path), prefix=".dyknow-")
    try:
        with open(handle, "wb") as file:
            file.write(data)
        os.chmod(draft, _mode_of(path))
        os.replace(draft, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(draft)
        raise


def _mode_of(path: str) -> int:
    try:
        return os.stat(path).st_mode & 0o777
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask
