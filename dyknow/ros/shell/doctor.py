# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Examines a running system: each check yields findings, each of them with a cure.

A check asks the processes themselves, with a time limit, and changes nothing. What only the kernel
knows (descriptors, disks, the age of a process) is examined for the processes of this machine.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Callable, Iterator, NamedTuple

import psutil
import rosgraph
import rospkg
from dyknow_msgs.srv import PollResponse

import dyknow
from dyknow import names
from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.manager.specifications.given import undeclared
from dyknow.model.graph import Model, NodeletStatus, State
from dyknow.model.streams import ClaimState
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.installed import missing_here
from dyknow.ros.manager.manager_settings import MAX_CLOCK_OFFSET, state_path, unknown_parameters
from dyknow.ros.nodelets.owner import is_taken
from dyknow.ros.shell.shell_client import ShellClient
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.poll_client import PollClient
from dyknow.ros.wire.service_client import OTHER_VERSION

#: Seconds for each answer of a node.
PATIENCE = 2.0
#: Share of the descriptors in use from which a process is reported.
_MANY_DESCRIPTORS = 0.8
#: Share of a disk, and bytes, below which the free space is reported.
_LITTLE_SPACE = 0.05, 200 * 2**20
_ASKERS = 16


@dataclass(frozen=True)
class Finding:
    """A defect of the system.

    Attributes:
        subject: the node, nodelet, topic, transformation, host or folder that has it.
        problem: the observed state.
        cure: a remedy for the user.
        is_error: whether something does not work now; else it may soon, or be a mistake.
    """

    subject: str
    problem: str
    cure: str
    is_error: bool = True


_warning = partial(Finding, is_error=False)


class NodeFacts(NamedTuple):
    """A registered node: its address, process id (0 if it does not answer) and error."""

    name: str
    uri: str
    pid: int = 0
    trouble: BaseException | None = None

    @property
    def host(self) -> str:
        """The host in its address."""
        return str(rosgraph.network.parse_http_host_and_port(self.uri)[0])


@dataclass
class Doctor:
    """Examines the system of one DyKnow manager.

    Attributes:
        client: speaks with the manager.
        code: folder of the installed code.
        disk_usage: returns total, used and free bytes of the disk that holds a path.
    """

    client: ShellClient
    code: Path = Path(dyknow.__file__).resolve().parent
    disk_usage: Callable[[str], tuple[int, int, int]] = shutil.disk_usage

    def checks(self) -> list[tuple[str, Callable[[], Iterator[Finding]]]]:
        """List the checks, each with the name of its subject."""
        return [
            ("names of hosts", self.names_of_hosts),
            ("hosts", self.hosts),
            ("nodes", self.dead_nodes),
            ("processes of an earlier master", self.unregistered_processes),
            ("DyKnow manager", self.manager),
            ("nodelets", self.nodelets),
            ("remains of nodelets", self.remains),
            ("streams", self.streams),
            ("library", self.library),
            ("parameters", self.parameters),
            ("versions", self.versions),
            ("descriptors", self.descriptors),
            ("disks", self.disks),
        ]

    # The graph

    @cached_property
    def _master(self) -> Master:
        return Master(f"/dyknow_{os.getpid()}", timeout=PATIENCE)

    @cached_property
    def nodes(self) -> dict[str, NodeFacts]:
        """Every registered node, by name."""
        state = self._master.ask("getSystemState")
        found = sorted({node for side in state for _, nodes in side for node in nodes})
        with ThreadPoolExecutor(_ASKERS) as pool:
            return {each.name: each for each in pool.map(self._ask_node, found)}

    def _ask_node(self, name: str) -> NodeFacts:
        uri = self._master.node(name)
        try:
            return NodeFacts(name, uri, self._master.pid(name, uri, PATIENCE))
        except (PeerTimeout, LookupError) as error:
            return NodeFacts(name, uri, trouble=error.__cause__ or error)

    @cached_property
    def _polls(self) -> dict[str, PollResponse | str]:
        """How each process that runs nodelets answers a poll; or a text that says why not."""
        _, _, services = self._master.ask("getSystemState")
        offered = dict(services)

        def offering(service: str) -> set[str]:
            # `nodelet load` is a node of its nodelet's name; its nodelet manager has the services.
            return {
                name for name in self.nodes if name in offered.get(names.join(name, service), ())
            }

        managers, nodes = offering("load_nodelet"), offering("get_config")
        found = sorted(managers | nodes)

        def poll(name: str) -> PollResponse | str:
            if names.join(name, "get_counts") in offered:  # a service of earlier versions
                return OTHER_VERSION
            with contextlib.closing(PollClient(self._master, name, name in nodes)) as client:
                try:
                    return client.ask(PATIENCE)
                except (DyKnowError, PeerTimeout) as error:
                    return str(error)

        with ThreadPoolExecutor(_ASKERS) as pool:
            return dict(zip(found, pool.map(poll, found)))

    @cached_property
    def _is_here(self) -> bool:
        """Whether the DyKnow manager runs on this machine, or nowhere."""
        node = self.nodes.get(self.client.manager)
        return node is None or not node.uri or rosgraph.network.is_local_address(node.host)

    @cached_property
    def model(self) -> Model:
        """The model with its transformations; empty where the manager does not answer."""
        try:
            return self.client.get_model()
        except DyKnowError:
            return Model(0, 0, ())

    def names_of_hosts(self) -> Iterator[Finding]:
        """Find names of hosts that this machine cannot resolve, its own among them."""
        hosts: dict[str, str] = {}
        for each in self.nodes.values():
            try:
                hosts[each.host] = each.name
            except ValueError:
                if each.uri:
                    cure = "end the program that has registered it, and start it again"
                    yield Finding(each.name, f"its address '{each.uri}' is no URL", cure)
        hosts[rosgraph.network.get_host_name()] = "this machine"
        for host, node in sorted(hosts.items()):
            try:
                socket.getaddrinfo(host, None)
            except (OSError, ValueError) as error:
                why = error.strerror if isinstance(error, OSError) else "it is no name of a host"
                yield Finding(
                    host,
                    f"the name of the host of {node} does not resolve here: {why}",
                    "set ROS_IP or ROS_HOSTNAME where the node starts, or add the name to "
                    "/etc/hosts on every host",
                )

    def hosts(self) -> Iterator[Finding]:
        """Find hosts that do not answer, and hosts whose clocks differ."""
        limit = self._parameter(f"{self.client.manager}/max_clock_offset")
        for host in self.client.list_hosts() if self.model.revision else ():
            if host.is_away:
                yield _warning(
                    host.name,
                    f"none of its processes has answered for {host.lasts:.0f} s",
                    "see whether it can be reached, and whether its nodelet managers run",
                )
            if host.clock.exceeds(MAX_CLOCK_OFFSET if limit is None else limit):
                yield _warning(
                    host.name,
                    f"its clock differs by {host.offset:+.3f} s (± {host.error:.3f} s) from that "
                    "of the DyKnow manager's host",
                    "let both follow one time server (chrony, systemd-timesyncd): stamps, tf and "
                    "limits of age compare their clocks",
                )

    def dead_nodes(self) -> Iterator[Finding]:
        """Find nodes that are registered and gone, or do not answer."""
        for node in self.nodes.values():
            if isinstance(node.trouble, ConnectionRefusedError):
                problem = f"is registered, but no process answers at {node.uri}"
                yield Finding(node.name, problem, "rosnode cleanup")
            elif node.trouble is not None and not isinstance(node.trouble, socket.gaierror):
                yield Finding(
                    node.name,
                    f"does not answer within {PATIENCE:g} s at {node.uri}",
                    f"see whether its host is reachable and its process is suspended (kill -CONT "
                    f"PID); else end it: rosnode kill {node.name}",
                )

    def unregistered_processes(self) -> Iterator[Finding]:
        """Find a DyKnow manager and its processes that run, but are unknown to the master."""
        unknown = (
            "runs, but this ROS master does not know it: the master was restarted, or another one "
            "was used before"
        )
        if self.client.manager not in self.nodes and is_taken(self._state_path("lock")):
            yield Finding(
                self.client.manager,
                f"its process {unknown}",
                "end the process, and start the DyKnow manager again; nodelets and claims come "
                "back",
            )
        for child in child_records.running(self._state_path("lock")):
            node = self.nodes.get(child.name)
            pid = child.process.pid if child.process is not None else 0
            if node is None or node.pid not in (0, pid):
                cure = f"kill {pid}; the DyKnow manager starts it again"
                yield Finding(child.name, f"its process {pid} {unknown}", cure)

    # DyKnow

    def manager(self) -> Iterator[Finding]:
        """Find a DyKnow manager that does not answer."""
        try:
            self.client.get_graph()
        except DyKnowError as error:
            problem, _, advice = str(error).partition(": ")
            yield Finding(self.client.manager, problem, advice or "rosrun dyknow manager")

    def nodelets(self) -> Iterator[Finding]:
        """Find nodelets that do not run, hang, or have errors."""
        running = [each for each in self.model.nodelets if each.state is State.RUNNING]
        for each in self.model.nodelets:
            info = f"dyknow info {each.name}"
            if each.state in (State.LOST, State.FAILED):
                problem = f"is {each.state.name}: {each.detail}"
                yield Finding(each.name, problem, f"{info}; see the log of {each.node}")
            elif each.detail:
                is_restarted = each.outdated and each.transformation
                cure = f"dyknow restart {each.name}" if is_restarted else info
                yield _warning(each.name, each.detail, cure)
        with ThreadPoolExecutor(_ASKERS) as pool:
            yield from (found for found in pool.map(self._statistics, running) if found)

    def _statistics(self, nodelet: NodeletStatus) -> Finding | None:
        if nodelet.is_fixed:
            return None  # it has no proxy
        try:
            errors = self.client.get_statistics(nodelet.name).callback_errors
        except DyKnowError as error:
            if not nodelet.ports:
                return None  # it has no proxy either
            return Finding(nodelet.name, str(error), f"dyknow info {nodelet.name}")
        if not errors:
            return None
        problem = f"{errors} of its callbacks raised an exception"
        return _warning(nodelet.name, problem, f"see the tracebacks in the log of {nodelet.node}")

    def remains(self) -> Iterator[Finding]:
        """Find code of nodelets that were unloaded, and that still runs."""
        for host, answer in self._polls.items():
            for text in [] if isinstance(answer, str) else answer.remains:
                yield Finding(
                    host,
                    text,
                    f"rosnode kill {host}: the DyKnow manager starts its own again, with the "
                    "other nodelets; spawn such a nodelet isolated",
                )

    def streams(self) -> Iterator[Finding]:
        """Find claims whose stream does not flow as it was requested."""
        for each in self.client.list_streams() if self.model.revision else ():
            if not each.state.ended and each.state is not ClaimState.ACTIVE:
                yield Finding(
                    f"claim {each.claim_id} ({each.tag})",
                    f"is {each.state.name}: {each.detail}",
                    f"dyknow plan '{each.tag}'",
                    is_error=each.state is ClaimState.FAILED,
                )

    def library(self) -> Iterator[Finding]:
        """Find transformations whose nodelet type, program or message type is not installed."""
        if not self._is_here:
            return
        missing = list(missing_here("library", self.model.transformations))
        if missing and not self._has_packages_of_manager():
            yield _warning(
                "library",
                "not all sources and types are found here, but the DyKnow manager has another "
                "ROS_PACKAGE_PATH",
                "source the manager's workspace in this terminal, and ask again",
            )
            return
        for problem in missing:
            yield _warning(
                "library",
                problem.message,
                "build and source the package on every host, or import a corrected specification",
            )

    def _has_packages_of_manager(self) -> bool:
        """Whether the manager's process has our ROS_PACKAGE_PATH, as far as we may read that."""
        for name, process in self._processes:
            with contextlib.suppress(psutil.Error):
                path = process.environ().get("ROS_PACKAGE_PATH")
                if name == self.client.manager and path != os.environ.get("ROS_PACKAGE_PATH"):
                    return False
        return True

    def parameters(self) -> Iterator[Finding]:
        """Find parameters that nothing reads."""
        manager = self.client.manager
        for name, hint in unknown_parameters(self._parameter(manager) or {}):
            parameter = names.join(manager, name)
            problem = f"the DyKnow manager has no such parameter{hint}"
            yield _warning(parameter, problem, f"rosparam delete {parameter}")
        known = {each.label: each for each in self.model.transformations}
        for nodelet in self.model.nodelets:
            for problem in undeclared(known.get(nodelet.transformation), nodelet.parameters):
                yield _warning(nodelet.name, problem, "destroy it, and spawn it again")

    # This machine

    @cached_property
    def _processes(self) -> list[tuple[str, psutil.Process]]:
        """The processes of DyKnow on this machine, each with a node that it is."""
        hosts = {each.node for each in self.model.nodelets} | {self.client.manager}
        found: dict[int, tuple[str, psutil.Process]] = {}
        for node in self.nodes.values():
            if node.name in hosts and node.pid and rosgraph.network.is_local_address(node.host):
                with contextlib.suppress(psutil.Error):
                    found[node.pid] = node.name, psutil.Process(node.pid)
        return list(found.values())

    def versions(self) -> Iterator[Finding]:
        """Find processes that run older code than the installed one, or of another version."""
        for name, answer in self._polls.items():
            if isinstance(answer, str) and OTHER_VERSION in answer:
                yield Finding(name, "was started with another version of DyKnow", "restart it")
        changed = _last_change(self.code)
        moment = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(changed))
        for name, process in self._processes:
            with contextlib.suppress(psutil.Error):
                if process.create_time() < changed:
                    yield _warning(
                        name,
                        f"was started before DyKnow was changed on disk (at {moment}), and may be "
                        "of another version",
                        "restart it",
                    )

    def descriptors(self) -> Iterator[Finding]:
        """Find processes that are about to run out of file descriptors."""
        for name, process in self._processes:
            with contextlib.suppress(psutil.Error):
                used = process.num_fds()
                limit, hard = process.rlimit(psutil.RLIMIT_NOFILE)
                if used >= _MANY_DESCRIPTORS * limit:
                    raised = f"ulimit -n {hard}" if hard > limit else "the system's limit"
                    yield Finding(
                        name,
                        f"uses {used} of {limit} file descriptors",
                        f"spread the nodelets with ~num_nodelet_managers, or raise {raised} where "
                        "it is started",
                    )

    def disks(self) -> Iterator[Finding]:
        """Find disks of the durable state and of the logs that are nearly full."""
        seen: set[int] = set()
        places = [("the logs of ROS", rospkg.get_log_dir())]
        if self._is_here:
            state = os.path.dirname(self._state_path(""))
            places.insert(0, ("the state of the DyKnow manager", state))
        for what, path in places:
            path = os.path.abspath(path)  # the folder above a relative one is ""
            while not os.path.exists(path):
                path = os.path.dirname(path)
            device = os.stat(path).st_dev
            total, _, free = self.disk_usage(path)
            if device not in seen and free < min(_LITTLE_SPACE[0] * total, _LITTLE_SPACE[1]):
                yield Finding(
                    path,
                    f"the disk that holds {what} has {free / 2**20:.0f} MiB left",
                    "free space, for instance: rosclean purge",
                )
            seen.add(device)

    def _state_path(self, ending: str) -> str:
        folder = self._parameter(names.join(self.client.manager, "state_dir")) or ""
        return state_path(str(folder), self._master.uri, self.client.manager, ending)

    def _parameter(self, name: str) -> Any:
        """Return the value of a parameter; None if it is not set."""
        try:
            return self._master.ask("getParam", name)
        except LookupError:
            return None


def _last_change(code: Path) -> float:
    """Return when the newest module in a folder was changed; a dangling link is none."""
    changed = 0.0
    for file in code.rglob("*.py"):
        with contextlib.suppress(OSError):
            changed = max(changed, file.stat().st_mtime)
    return changed
