# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Restarts nodelets and nodelet managers with today's code and specification, and moves nodelets.

A nodelet is unloaded and loaded again, under its name, with its connections, parameters and
protection. It receives nothing in between. Meanwhile it is STARTING, on disk too, so that the next
life of a manager that is killed brings it back; claims wait for it (``Graph.restarting``). One
that is moved to another nodelet manager goes the same way, and messages are kept for it.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Iterator

from dyknow.errors import (
    CannotMove,
    DyKnowError,
    HostError,
    HostTimeout,
    MoveFailed,
    RestartFailed,
    UnknownNodelet,
)
from dyknow.manager.host import Host, ProcessState
from dyknow.manager.library import Library
from dyknow.manager.record import NOTHING_HEARD, Record
from dyknow.manager.specifications.given import completed, undeclared
from dyknow.manager.supervision.lifecycle import Lifecycle, ManagerContext, parameter_names
from dyknow.model.graph import OUTDATED, NodeletKind, Restarted, State
from dyknow.model.transformation import NODE, Program, Transformation

_RESTARTING = "it is being restarted"


class Restarts:
    """Restarts nodelets and processes that this manager made."""

    def __init__(self, context: ManagerContext, lifecycle: Lifecycle) -> None:
        self._host = context.host
        self._graph = context.graph
        self._library = context.library
        self._guards = context.guards
        self._lifecycle = lifecycle

    def restart(self, name: str, is_forced: bool = False) -> Restarted:
        """Restart a nodelet, or a nodelet manager with all its nodelets.

        Those that could not be made today run on, unless ``is_forced``: then the rest comes back.

        Raises:
            UnknownNodelet: there is none of that name.
            HostError: this manager did not make it, or it does not answer.
            RestartFailed: it did not come up again.
        """
        state = None if self._graph.find(name) else self._host.states().get(name)
        if state is None:
            return self._restart_nodelet(name, is_forced)
        if state.isolated_for:
            return self._restart_nodelet(state.isolated_for, is_forced)
        if not state.own:
            raise HostError(
                f"nodelet manager '{name}' was not started by this manager: restart it where it "
                "was started"
            )
        return self._restart_process(state, is_forced)

    def move(self, name: str, target: str) -> None:
        """Move a nodelet to another nodelet manager: no message is lost, or received twice.

        It is a new instance there, with the same parameters and connections.

        Raises:
            UnknownNodelet: there is none of that name.
            CannotMove: it runs on where it is.
            MoveFailed: it did not come up there.
            HostError: its nodelet manager does not answer; the next look finds how it is.
        """
        with self._graph.restart([name]) as records, contextlib.ExitStack() as moving:
            if not records:
                raise UnknownNodelet(name, self._graph.records)
            (record,) = records
            if not is_movable(record) or record.manager == target:
                raise CannotMove(name, f"expected a Python nodelet that runs outside of {target}")
            try:
                hand_over = moving.enter_context(self._host.moving(name, record.manager, target))
            except HostError as error:
                raise CannotMove(name, error) from error
            detail = f"it is being moved to {target}"
            self._graph.put(_ending(record, detail))
            try:
                hand_over()
            except HostError as error:
                self._graph.put(_late(record, f"{detail}: {error}"))
                if not isinstance(error, HostTimeout) and name in self._host.list(record.manager):
                    self._graph.put(record)
                    raise CannotMove(name, error) from error
                raise
            self._lifecycle.dispose(record)
            problem = self._lifecycle.restore(replace(record, manager=target, detail=detail))
            if problem is not None:
                back = replace(record, detail=f"it was not up in {target}")
                is_back = self._lifecycle.restore(back) is None
                raise MoveFailed(name, target, problem, is_back) from problem

    def _restart_nodelet(self, name: str, is_forced: bool) -> Restarted:
        with self._graph.restart([name]) as records:  # once it is there, if it is being made
            if not records:
                raise UnknownNodelet(name, {*self._graph.records, *self._host.states()})
            (record,) = records
            fresh = self._renewed(record, is_forced)
            self._graph.put(_ending(record))
            try:
                self._lifecycle.end(record)
            except HostTimeout:
                later = "it is restarted as soon as it is unloaded"
                self._put_late(fresh if fresh.manager else record, record, later)
                raise
            except HostError:
                self._graph.put(record)
                raise
            self._bring_back(record, fresh)
            return Restarted((name,), "\n".join(self._remarks(record)))

    def _restart_process(self, state: ProcessState, is_forced: bool) -> Restarted:
        hosted = [each.name for each in self._graph.all() if each.manager == state.name]
        with self._graph.restart(hosted) as found:
            records = [each for each in found if not each.unwanted]
            strangers = [each.name for each in records if not each.is_spawned]
            if strangers:
                raise HostError(
                    f"nodelet manager '{state.name}' runs {', '.join(strangers)}, which this "
                    "manager did not make and cannot bring back; unload that first"
                )
            renewed = [(each, self._renewed(each, is_forced)) for each in records]
            self._graph.put(*[_starting(each) for each in records])
            self._host.renew(state.name)  # if that fails, the next look finds how they are
            for record in found:
                if record.unwanted:  # its destruction waited for this process
                    self._lifecycle.forget(record)
            problems = []
            for record, fresh in renewed:
                try:
                    self._lifecycle.dispose(record)
                    self._bring_back(record, fresh)
                except RestartFailed as error:
                    problems.append(str(error))
            if problems:
                raise HostError("; ".join(problems))
            remarks = [text for record in records for text in self._remarks(record)]
        return Restarted(tuple([each.name for each in records]), "\n".join(remarks))

    def _renewed(self, record: Record, is_forced: bool) -> Record:
        """Return a nodelet as it would be made today.

        If it cannot be, it is returned as it is if that ``is_forced``; else DyKnowError is raised.
        """
        made = record.transformation
        if made is None or not record.is_spawned:
            raise HostError(
                f"'{record.name}' was not made by this manager: restart it where it was started"
            )
        if record.unwanted:
            raise HostError(f"'{record.name}' is to be destroyed as soon as it answers")
        try:
            return self._todays(record, made)
        except DyKnowError:
            if not is_forced:
                raise
            return replace(record, detail=_RESTARTING)

    def _todays(self, record: Record, made: Transformation) -> Record:
        blueprint = todays(record, self._library) or made
        if blueprint.type == NODE:
            self._guards.check_program(Program.of(blueprint.source).name, is_own=True)
        self._host.check_code(blueprint)
        parameters = completed(blueprint, record.parameters, self._library.ontology)
        kind = self._host.kind_of(blueprint)
        isolated = record.isolated or kind.is_node
        kind = kind.alone if isolated else kind
        stays = (kind.host, isolated) == (record.kind.host, record.isolated)
        gone = {port.name for port in made.ports} - {port.name for port in blueprint.ports}
        return replace(
            record,
            transformation=blueprint,
            parameters=parameters,
            kind=kind,
            isolated=isolated,
            manager=record.manager if stays else "",
            topics={port: topic for port, topic in record.topics.items() if port not in gone},
            detail=_RESTARTING,
            outdated="",
        )

    def _bring_back(self, record: Record, fresh: Record) -> None:
        """Load a nodelet as it is made today, else, if its specification is new, as it was."""
        error = self._lifecycle.restore(fresh)
        if error is None:
            return
        is_back = False
        if fresh.transformation != record.transformation:
            failed = self._graph.get(record.name)
            if failed.superseded:  # its load may end yet, and is undone first
                former = replace(record, manager=failed.manager, incarnation=failed.incarnation)
                self._put_late(former, failed, failed.detail)
            else:
                is_back = self._lifecycle.restore(replace(record, detail=_RESTARTING)) is None
        raise RestartFailed(record.name, error, is_back) from error

    def _put_late(self, record: Record, before: Record, detail: str) -> None:
        """Show a nodelet that the observer unloads, and brings back without former parameters."""
        kept = parameter_names(record)
        gone = [each for each in parameter_names(before) if each not in kept]
        self._host.forget(record.name, gone)
        self._graph.put(_late(record, detail))

    def _remarks(self, before: Record) -> Iterator[str]:
        """List the parts that a restart has not kept, or not renewed."""
        after = self._graph.get(before.name)
        present = {port.name for port in after.declared}
        for port in before.declared:
            topic = before.topics.get(port.name)
            if port.name in present:
                if topic and not after.topics.get(port.name):
                    what = f"its connection to {topic} does not fit now"
                    yield f"port '{port.name}' of {before.name} is cut: {what}"
            else:
                tail = f", and its connection to {topic} with it" if topic else ""
                yield f"port '{port.name}' of {before.name} is gone{tail}"
        yield from undeclared(after.transformation, after.parameters)
        left = outdated(after, self._library, self._host)
        if left:
            yield f"{after.name} is still {left}"


def todays(record: Record, library: Library) -> Transformation | None:
    """Return the blueprint by which a spawned nodelet would be made today."""
    found = library.find(record.label) if record.is_spawned else None
    return record.transformation if found is None or found.is_described else found


def outdated(record: Record, library: Library, host: Host) -> str:
    """Say why a restart would make a nodelet differently; empty if it would not."""
    made = record.transformation
    if made is None or not record.is_spawned:
        return ""
    old = ["specification"] if todays(record, library) != made else []
    code = host.code_of(record.manager, made) if record.code else ""
    if code not in ("", record.code):
        old.append("code")
    if not old:
        return ""
    text = f"{OUTDATED}its {' and its '.join(old)} changed since it was loaded"
    try:
        host.check_code(made)
    except HostError as error:
        return f"{text}, but {error}"
    if code not in ("", record.code) and record.kind is NodeletKind.CPP and not record.isolated:
        text += f", and new code in C++ is loaded by a restart of {record.manager}"
    return text


def is_movable(record: Record) -> bool:
    """Whether a nodelet can be moved to another nodelet manager without a lost message."""
    return (
        record.is_spawned
        and record.kind is NodeletKind.PYTHON
        and record.state is State.RUNNING
        and not (record.isolated or record.unwanted)
    )


def _starting(record: Record, detail: str = _RESTARTING) -> Record:
    return replace(record, state=State.STARTING, detail=detail, heard=NOTHING_HEARD)


def _ending(record: Record, detail: str = _RESTARTING) -> Record:
    """Show a nodelet that is to be unloaded: the next life of the manager unloads it again."""
    return replace(_starting(record, detail), superseded=True)


def _late(record: Record, detail: str) -> Record:
    """Show a nodelet that may yet be unloaded: the observer unloads it, and brings it back."""
    return replace(record, state=State.LOST, detail=detail, superseded=True)
