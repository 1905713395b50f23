# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The output of commands: JSON, tables, values that change, and files."""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import math
import os
import shutil
import sys
import time
from dataclasses import fields
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Sequence

from dyknow.cli.shell import Shell, written
from dyknow.errors import DyKnowError
from dyknow.model.graph import Model, NodeletStatus
from dyknow.model.hosts import HostStatus
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.model.streams import StreamEvent, StreamStatus
from dyknow.model.transformation import Parameter, Transformation
from dyknow.similar import did_you_mean
from dyknow.wiring.ports import by_name

Json = Dict[str, Any]


def as_json(value: Any) -> Any:
    """Make JSON of a value: of sequences lists, of sets sorted ones, of dataclasses objects.

    NaN, which JSON does not have, is null.
    """
    if isinstance(value, enum.Enum):
        return value.name.lower() if isinstance(value, enum.IntEnum) else value.value
    if dataclasses.is_dataclass(value):
        return {field.name: as_json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [as_json(each) for each in (sorted(value) if isinstance(value, set) else value)]
    return None if isinstance(value, float) and math.isnan(value) else value


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
        "ports": [
            picked(port, "name direction datatype tags rate latency")
            for port in transformation.ports
        ],
        "requires": [picked(each, "tag initially") for each in transformation.requires],
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
    return {**picked(stream, f"{named} expires bindings"), "expires": stream.expires or None}


def event_json(event: StreamEvent) -> Json:
    """A change of a claim; ``before`` is null for a new one."""
    return {
        "stamp": event.stamp,
        "before": stream_json(event.before) if event.before is not None else None,
        "after": stream_json(event.after),
        "reason": event.reason,
    }


def host_json(host: HostStatus) -> Json:
    """A host; times in s, load and memory as shares, null where they are not known."""
    named = "name address own=is_own away=is_away lasts managers nodelets pinned cores pause"
    return picked(host, f"{named} load memory offset offset_error=error")


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


def host_table(hosts: Sequence[HostStatus], now: float) -> Iterator[str]:
    """Write a line for each host; a host is away since some time before ``now`` (s)."""
    rows: list[tuple[object, ...]] = [
        ("HOST", "ADDRESS", "STATE", "LOAD", "MEMORY", "CLOCK", "MANAGERS", "NODELETS")
    ]
    for each in hosts:
        rows.append(
            (
                each.name,
                each.address or None,
                _presence(each, now),
                _percent(each.load),
                _percent(each.memory),
                "own" if each.is_own else _clock(each),
                ", ".join(each.managers) or None,
                len(each.nodelets),
            )
        )
    yield from columns(rows, right=(3, 4, 5, 7))
    for each in hosts:
        if each.pause:
            yield (
                f"{each.name}: it was away repeatedly; for {each.pause:.0f} s nothing new is "
                "placed there if there is another host"
            )


def _presence(host: HostStatus, now: float) -> str:
    if not host.is_away:
        return "here"
    return f"away since {time.strftime('%H:%M:%S', time.localtime(now - host.lasts))}"


def _percent(share: float) -> str | None:
    return None if math.isnan(share) else f"{share:.0%}"


def _clock(host: HostStatus) -> str | None:
    """Milliseconds by which the clock is ahead, and by which that may be wrong."""
    if math.isnan(host.offset):
        return None
    return f"{host.offset * 1e3:+.1f} ms ± {host.error * 1e3:.1f}"


_HOME = "\x1b[H"
_CLEAR = "\x1b[2J"
_CLEAR_LINE = "\x1b[K"
_CLEAR_BELOW = "\x1b[J"


class Screen:
    """Shows a value that changes.

    On a terminal each value replaces the one before, cut to the window; lines are rewritten
    without clearing the screen, so that nothing flickers. Elsewhere an empty line separates
    values; as JSON each is one line.
    """

    def __init__(self, shell: Shell) -> None:
        self._shell = shell
        self._in_place = shell.out.isatty() and not shell.as_json
        self._shown = False

    def show(self, value: Any, lines: Sequence[str]) -> None:
        if self._in_place:
            self._shell.write(self._page(lines))
        else:
            self._shell.show(value, ["", *lines] if self._shown else lines, indent=None)
        self._shown = True

    def _page(self, lines: Sequence[str]) -> str:
        width, height = shutil.get_terminal_size()
        shown = list(lines)
        if len(shown) > height - 1:
            hidden = len(shown) - (height - 2)
            shown = [*shown[: height - 2], f"... {hidden} more lines"]
        text = _HOME if self._shown else _CLEAR + _HOME
        text += "".join(line[:width] + _CLEAR_LINE + "\n" for line in shown)
        return text + _CLEAR_BELOW


STDIO = "-"  # the name of standard input, or output, among files
_LARGEST = 2**30  # bytes of a file; managers allow less, unless their limits were raised


def read_file(path: str) -> bytes:
    """Read a file, or standard input."""
    try:
        if path == STDIO:
            data = sys.stdin.buffer.read(_LARGEST + 1)
        else:
            with open(path, "rb") as stream:
                data = stream.read(_LARGEST + 1)
    except OSError as error:
        raise DyKnowError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > _LARGEST:  # it may have no end, as /dev/zero
        raise DyKnowError(f"{path}: is too large; expected at most {_LARGEST} bytes")
    return data


def write_file(path: str, data: bytes) -> None:
    """Write a file, or standard output; an existing file is replaced by the complete new one."""
    if path == STDIO:
        with written(sys.stdout):
            sys.stdout.buffer.write(data)
        return
    whole = Path(os.path.realpath(path))
    draft = whole.parent / f".dyknow-{os.getpid()}"
    try:
        if os.path.exists(path) and not os.path.isfile(path):  # /dev/stdout, a pipe
            Path(path).write_bytes(data)
            return
        try:
            with draft.open("wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())  # before the old one goes: after a crash there is one
            if whole.exists():
                shutil.copymode(whole, draft)
            draft.replace(whole)
        finally:
            with contextlib.suppress(FileNotFoundError):
                draft.unlink()
    except OSError as error:
        raise DyKnowError(f"{path}: cannot be written: {error.strerror}") from error
