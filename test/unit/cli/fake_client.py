"""The client of the command line on a manager without ROS, and a way to run commands with it."""

from __future__ import annotations

import io
import json
import shlex
from dataclasses import dataclass
from typing import Any, Callable, Container, Mapping, Sequence

from unit.manager.world import World

from dyknow.cli.main import execute
from dyknow.cli.parser import parse
from dyknow.cli.shell import Shell
from dyknow.errors import (
    DyKnowError,
    HostError,
    NodeletUnreachable,
    NoPlanFound,
    Refused,
    Result,
    StreamRefused,
)
from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.manager.claims.advice import unknown_labels
from dyknow.manager.claims.reconciler import Acquired, StreamReconciler
from dyknow.manager.planning.explanation import as_tree
from dyknow.model.graph import Model, SpawnRequest
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamEvent, StreamRequest, StreamStatus
from dyknow.model.transformation import Added


class FakeClient:
    """Does what `ShellClient` does, with the manager of a `World`.

    Attributes:
        calls: the changes that were asked for, in order.
        fail: called before each of them with its name and subject; may raise.
        hung: nodelets that do not answer.
        ordinary: topics that ordinary nodes publish on.
    """

    namespace = "/"

    def __init__(self, world: World) -> None:
        self.world = world
        self.calls: list[tuple[str, str]] = []
        self.fail: Callable[[str, str], None] = lambda call, subject: None
        self.hung: set[str] = set()
        self.uncounted: set[str] = set()
        self.ordinary: set[str] = set()
        self.reconciler = StreamReconciler(world.manager, clock=lambda: 0.0)
        #: What happens, one after the other, while a command waits for events.
        self.script: list[Callable[[], object]] = []

    def get_graph(self) -> Model:
        return self.world.manager.graph_model()

    def get_model(self) -> Model:
        return self.world.manager.get_model()

    def add_transformation(self, specification: str) -> Added:
        self._note("add_transformation", specification)
        found = _answered(lambda: self.world.manager.add_transformation(specification))
        return Added(
            tuple(sorted(each.label for each in found.transformations)),
            "\n".join(map(str, found.warnings)),
        )

    def remove_transformation(self, label: str) -> None:
        self._note("remove_transformation", label)
        _answered(lambda: self.world.manager.remove_transformation(label))

    def spawn(
        self,
        label: str,
        name: str,
        config: Mapping[str, str] | None = None,
        is_protected: bool = False,
        isolated: bool = False,
        manager: str = "",
    ) -> None:
        self._note("spawn", name)
        request = SpawnRequest(label, name, config or {}, is_protected, isolated, manager)
        _answered(lambda: self.world.manager.spawn(request))

    def destroy(self, name: str) -> None:
        self._note("destroy", name)
        _answered(lambda: self.world.manager.destroy(name))

    def set_protection(self, name: str, is_protected: bool) -> None:
        self._note("set_protection", name)
        _answered(lambda: self.world.manager.set_protection(name, is_protected))

    def get_config(self, nodelet: str) -> Any:
        return self._asked(nodelet, lambda: self.world.host.ports(nodelet))

    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        self._note("set_config", nodelet)
        self._asked(nodelet, lambda: self.world.host.ports(nodelet))
        _answered(lambda: self.world.host.connect(nodelet, config))
        self.world.manager.look({nodelet})

    def get_statistics(self, nodelet: str) -> NodeletStatistics:
        ports = self._asked(nodelet, lambda: self.world.host.ports(nodelet))
        counted = (None,) * 6 if nodelet in self.uncounted else (2, 300, 4, 5.0, 0.001, 0.0025)
        return NodeletStatistics(
            60.0,
            1,
            counted[0],
            tuple(
                PortStatistics(port.name, port.direction, port.topic, *counted[1:])
                for port in ports
            ),
        )

    def acquire_stream(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        self._note("plan" if dry_run else "acquire", request.tag)
        try:
            acquired = self.reconciler.acquire(request, dry_run)
        except NoPlanFound as error:
            raise StreamRefused(str(error), Result.NO_PLAN, error.claim_id) from error
        except DyKnowError as error:
            raise StreamRefused(str(error), Result.SPAWN_FAILED) from error
        claim = acquired.claim
        return Acquisition(
            claim.claim_id,
            claim.topic,
            claim.datatype,
            tuple(sorted(acquired.spawned)),
            acquired.reused,
            acquired.cost,
            0.0,
            _tree(acquired),
            claim.detail,
            unknown_labels(self.world.manager, request.exclude),
        )

    def release_stream(self, claim_id: str) -> None:
        self._note("release", claim_id)
        self.reconciler.release(claim_id)

    def renew_stream(self, claim_id: str, lease: float) -> float:
        self._note("renew", claim_id)
        _answered(lambda: self.reconciler.renew(claim_id, lease))
        return lease

    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        self._note("replan", claim_id)
        done = _answered(lambda: self.reconciler.replan(claim_id, dry_run))
        return Replanned(done.spawned, done.reused, done.cost, _tree(done), "")

    def list_streams(self) -> tuple[StreamStatus, ...]:
        return tuple(_stream_view(claim) for claim in self.reconciler.claims())

    def stream_events(self) -> FakeEvents:
        return FakeEvents(self)

    def wait_for_model(self, condition: Callable[[Model], bool]) -> bool:
        return condition(self.get_graph())

    def nodelet_managers(self) -> list[str]:
        return sorted(self.world.host.processes)

    def managers(self) -> list[str]:
        return ["/dyknow_manager"]

    def topics(self) -> list[str]:
        return ["/rosout"]

    def stored_parameters(self, nodelet: str, parameters: Sequence[str]) -> dict[str, Any]:
        known = self.world.host.parameters
        return {
            name: known[f"{nodelet}/{name}"] for name in parameters if f"{nodelet}/{name}" in known
        }

    def published(self, hosts: Container[str]) -> frozenset[str]:
        return frozenset(self.ordinary)

    def is_own_manager(self, name: str) -> bool:
        return name.startswith("/fake_")

    def _note(self, call: str, subject: str) -> None:
        self.calls.append((call, subject))
        self.fail(call, subject)

    def _asked(self, nodelet: str, ask: Callable[[], Any]) -> Any:
        if nodelet in self.hung:
            raise NodeletUnreachable(f"nodelet '{nodelet}' did not answer within 5 s")
        try:
            return ask()
        except HostError as error:
            raise NodeletUnreachable(f"nodelet '{nodelet}' does not answer") from error


class FakeEvents:
    """Events of the reconciler; plays the client's script while it is waited for, then Ctrl-C."""

    def __init__(self, client: FakeClient) -> None:
        self.waiting: list[ClaimEvent] = []
        self._client = client
        client.reconciler.on_event = self.waiting.append

    def next(self, timeout: float) -> StreamEvent | None:
        if self.waiting:
            event = self.waiting.pop(0)
            after = _stream_view(event.after)
            before = None if event.reason == "requested" else _stream_view(event.before)
            return StreamEvent(0.0, before, after, event.reason)
        if not self._client.script:
            raise KeyboardInterrupt
        self._client.script.pop(0)()
        return None

    def close(self) -> None:
        self._client.reconciler.on_event = lambda event: None


@dataclass(frozen=True)
class Outcome:
    """What a command came to."""

    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()

    @property
    def json(self) -> Any:
        return json.loads(self.out)


def run(client: FakeClient, line: str) -> Outcome:
    """Run a command line that parses; without `dyknow` at its beginning."""
    arguments = parse(shlex.split(line))
    out, err = io.StringIO(), io.StringIO()
    shell = Shell(lambda: client, arguments.json, out, err)  # type: ignore[arg-type,return-value]
    code = execute(arguments, shell)
    return Outcome(code, out.getvalue(), err.getvalue())


def _answered(act: Callable[[], Any]) -> Any:
    try:
        return act()
    except DyKnowError as error:
        raise Refused(str(error)) from error


def _tree(acquired: Acquired) -> str:
    return as_tree(acquired.plan) if acquired.plan is not None else ""


def _stream_view(claim: Claim) -> StreamStatus:
    return StreamStatus(
        claim.claim_id,
        claim.request.client_id,
        claim.request.tag,
        claim.topic,
        claim.datatype,
        claim.state,
        claim.detail,
        claim.nodelets,
        claim.deadline or 0.0,
    )
