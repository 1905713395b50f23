# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registers all nodes again when a new ROS master has taken the place of the last one.

A ROS master keeps its contents in memory, and nodes of ROS 1 register once. The DyKnow manager
looks at the master every second, and keeps a mirror of it: in memory, and in a file for its next
life. A master that does not know the manager, or is another process than before, is new. Missing
parts of the mirror are put back, of each node that still answers at its address: parameters first,
then services and publishers, then subscribers. Each node lists its topics itself, so those that it
has given up meanwhile stay away; a node that does not answer in time gets back those that it had.
Where no node answers, the mirror is that of an earlier session, and nothing comes back.

Connections between nodes outlive a master. Since all publishers are registered before the first
subscriber, no subscriber ever hears of some of its publishers alone, which would make it close its
connections to the rest. A subscriber is notified only of publishers that it does not know yet.
"""

from __future__ import annotations

import bisect
import contextlib
import logging
import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Callable, Mapping

from rospy.impl.registration import get_service_manager

from dyknow.errors import PeerTimeout
from dyknow.periodic import ControlLoop
from dyknow.ros.hosting.external import may_be_there
from dyknow.ros.manager.mirror import MasterLoss, MasterMirror, NodeAddress, NodeTopics
from dyknow.ros.process.os_process import only_for_owner
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import is_offered

#: Its key in the manager's control loop.
MIRROR = "mirroring the ROS master"
#: Seconds between two looks, while there is no master, and at least.
_PERIOD, _AWAY_PERIOD, _PAUSE = 1.0, 0.25, 0.25
#: Least seconds between two writes of the file.
_SAVE_PERIOD = 5.0
#: Seconds for each answer of a node.
_PATIENCE = 1.0
_ASKERS = 32
#: Nodes of which a service is looked up again at each look: that of a node with a fixed port shows
#: that it was started again, and the master's registrations do not.
_IN_TURN = 20

_log = logging.getLogger("rosout.dyknow")


class MasterKeeper:
    """Keeps the mirror of a master; for one thread at a time."""

    def __init__(
        self, master: Master, path: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Read the mirror of an earlier life from a file, if there is one."""
        self._master = master
        self._me = master.caller
        #: For the questions of each look, whose answers seldom change.
        self._contents, self._names, self._services = (
            Master(master.caller, master.uri, compares=True) for _ in range(3)
        )
        #: The last node of which a service was looked up again.
        self._looked_up = ""
        self._path = path
        self._clock = clock
        self._kept = self._saved = self._load()
        self._save_at = clock()

    def look(self) -> float:
        """Complete a new master, or mirror the present one; returns the seconds until the next."""
        try:
            present = self._read()
            kept = self._kept
            if kept is not None and self._is_new(kept, present):
                self._heal(kept, present)
                present = self._read()
        except (PeerTimeout, LookupError):
            self._save()
            return _AWAY_PERIOD
        self._kept = self._with_processes(present)
        self._save()
        return _PERIOD

    def watch(self, loop: ControlLoop) -> None:
        """Look periodically, as ``MIRROR`` of the loop."""
        loop.add(MIRROR, self.look, 0.0, _PAUSE)

    def leave(self) -> None:
        """Mirror the master without this node, which leaves; its next life goes on from there."""
        self.look()
        if self._kept is not None:
            nodes = {node: at for node, at in self._kept.nodes.items() if node != self._me}
            self._kept = replace(self._kept, nodes=nodes)
            self._save_at = self._clock()
            self._save()

    def close(self) -> None:
        """Forget the mirror: the manager ends on purpose."""
        with contextlib.suppress(OSError):
            os.remove(self._path)

    # The mirror

    def _read(self) -> MasterMirror:
        """Read the contents of the master, with the process ids of nodes that are known.

        The types of topics are looked up once, as are the addresses of services: a process has one
        for all of them. Where a node has another one by now, a new process has taken its place.
        """
        me, known = self._me, self._kept or MasterMirror(0)
        asked = ("getPid",), ("getSystemState",), ("getParam", "/")
        pid, state, parameters = self._contents.ask_all((each[0], me, *each[1:]) for each in asked)
        if state is None:
            raise LookupError("the ROS master does not list its registrations")
        publishers, subscribers, offered = map(dict, state)
        services = {service: nodes[0] for service, nodes in offered.items()}
        names = sorted({each for part in state for _, nodes in part for each in nodes})
        uris = self._names.ask_all(("lookupNode", me, each) for each in names)
        nodes = {node: NodeAddress(uri) for node, uri in zip(names, uris) if uri}
        kept = {
            service: address
            for service, address in known.addresses.items()
            if services.get(service) == known.services.get(service)
        }
        of_nodes = self._in_turn(services)
        found = self._services.ask_all(("lookupService", me, each) for each in of_nodes.values())
        present = dict(zip(of_nodes, found))
        moved = {node for node, at in present.items() if kept.get(of_nodes[node], at) != at}
        same = {
            node: at
            for node, at in known.nodes.items()
            if _uri(nodes, node) == at.uri and node not in moved
        }
        addresses = {
            service: address
            for service, address in kept.items()
            if services[service] in same and address == present.get(services[service], address)
        }
        new = [each for each in services if each not in addresses]
        types = known.types
        if not (known.publishers.keys() | known.subscribers.keys()).issuperset(
            publishers.keys() | subscribers.keys()
        ):
            types = dict(self._master.ask("getTopicTypes"))
        looked_up = self._master.ask_all(("lookupService", me, each) for each in new)
        addresses.update((service, at) for service, at in zip(new, looked_up) if at)
        return MasterMirror(
            pid or 0,
            {**nodes, **same},
            publishers,
            subscribers,
            services,
            addresses,
            types,
            known.parameters if parameters is None else parameters,
        )

    def _in_turn(self, services: Mapping[str, str]) -> dict[str, str]:
        """Return one service of each node, of a few nodes at each look."""
        of_nodes = {node: service for service, node in services.items()}
        nodes = sorted(of_nodes)
        begin = bisect.bisect(nodes, self._looked_up)
        chosen = [*nodes[begin:], *nodes[:begin]][:_IN_TURN]
        self._looked_up = chosen[-1] if chosen else ""
        return {node: of_nodes[node] for node in chosen}

    def _with_processes(self, present: MasterMirror) -> MasterMirror:
        """Add the process ids of nodes that are new, by asking them."""
        unknown = [each for each, at in present.nodes.items() if not at.pid]
        if not unknown:
            return present
        with ThreadPoolExecutor(_ASKERS) as pool:
            uris = {each: present.nodes[each].uri for each in unknown}
            pids = pool.map(lambda each: self._master.pid_at(each, uris[each], _PATIENCE), uris)
            found = {each: NodeAddress(uris[each], pid) for each, pid in zip(uris, pids)}
        return replace(present, nodes={**present.nodes, **found})

    def _load(self) -> MasterMirror | None:
        try:
            with open(self._path, encoding="utf-8") as file:
                return MasterMirror.from_text(file.read())
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            _log.warning("the mirror of the ROS master in '%s' is not used: %s", self._path, error)
            return None

    def _save(self) -> None:
        """Write the file if that is due; a reboot, which may lose it, ends all nodes."""
        mirror = self._kept
        if mirror is None or mirror == self._saved or self._clock() < self._save_at:
            return
        self._saved, self._save_at = mirror, self._clock() + _SAVE_PERIOD
        made = self._path + ".new"
        try:
            os.makedirs(os.path.dirname(self._path), 0o700, exist_ok=True)
            with open(made, "w", encoding="utf-8", opener=only_for_owner) as file:
                file.write(mirror.to_text())
            os.replace(made, self._path)
        except OSError as error:
            _log.debug("the mirror of the ROS master is not on disk: %s", error)

    # A new master

    def _is_new(self, kept: MasterMirror, present: MasterMirror) -> bool:
        is_missing = self._me in kept.nodes and self._me not in present.nodes
        return is_missing or not present.is_of_the_same_master(kept)

    def _heal(self, kept: MasterMirror, present: MasterMirror) -> None:
        kept = self._with_own_services(kept)
        missing = {
            node: at
            for node, at in kept.nodes.items()
            if _uri(present.nodes, node) in ("", at.uri)
        }
        with ThreadPoolExecutor(_ASKERS) as pool:
            asked = list(pool.map(lambda each: self._ask_topics(each, missing[each]), missing))
            living = {node: found for node, found in zip(missing, asked) if found is not None}
            if all(found == NodeTopics() for found in living.values()):
                return  # of an earlier session
            loss = MasterLoss(kept, present, living, self._me)
            services = loss.services()
            there = pool.map(
                lambda each: is_offered(each, kept.addresses[each], self._me, _PATIENCE), services
            )
            offered = [service for service, is_there in zip(services, there) if is_there]
            loss = replace(loss, living=self._without_newcomers(living, missing))
            parameters = loss.parameters()
            self._master.ask_all(("setParam", self._me, name, value) for name, value in parameters)
            publishers = loss.publisher_registrations()
            self._master.ask_all([*loss.service_registrations(offered), *publishers])
            subscribers = loss.subscriber_registrations()
            heard = self._master.ask_all(subscribers)
            news = [
                (node, uri, topic, found)
                for (_, node, topic, _, uri), found in zip(subscribers, heard)
                if found and loss.is_news(node, topic, found)
            ]
            list(pool.map(self._notify, news))
        if not (offered or publishers or subscribers or parameters):
            return  # another keeper was first
        _log.warning(
            "the ROS master at %s is a new one; registered with it again: %d nodes, with %d "
            "publishers, %d subscribers, %d services, and %d parameters or namespaces",
            self._master.uri,
            len(living),
            len(publishers),
            len(subscribers),
            len(offered),
            len(parameters),
        )
        dead = sorted(missing.keys() - living.keys())
        if dead:
            _log.warning("nodes that have ended are not registered again: %s", ", ".join(dead))

    def _with_own_services(self, kept: MasterMirror) -> MasterMirror:
        """Add the services that this node has offered since the last look."""
        own = dict(get_service_manager().get_services())
        return replace(
            kept,
            services={**kept.services, **dict.fromkeys(own, self._me)},
            addresses={**kept.addresses, **own},
        )

    def _ask_topics(self, node: str, at: NodeAddress) -> NodeTopics | None:
        """Ask a node for its topics; None if it has ended."""
        try:
            if at.pid not in (0, self._master.pid(node, at.uri, _PATIENCE)):
                return None  # another process is there
            return NodeTopics(*self._master.topics(node, at.uri, _PATIENCE))
        except LookupError:
            return NodeTopics()
        except PeerTimeout as error:
            return NodeTopics() if may_be_there(error) else None

    def _without_newcomers(
        self, living: Mapping[str, NodeTopics], missing: Mapping[str, NodeAddress]
    ) -> dict[str, NodeTopics]:
        """Leave out nodes of which a new process has registered while all were being asked.

        The master would tell that one to end.
        """
        uris = self._master.ask_all(("lookupNode", self._me, each) for each in living)
        return {
            node: topics
            for (node, topics), uri in zip(living.items(), uris)
            if not uri or uri == missing[node].uri
        }

    def _notify(self, news: tuple[str, str, str, list[str]]) -> None:
        node, uri, topic, publishers = news
        with contextlib.suppress(PeerTimeout, LookupError):
            self._master.update(node, uri, topic, publishers, _PATIENCE)


def _uri(nodes: Mapping[str, NodeAddress], node: str) -> str:
    return nodes[node].uri if node in nodes else ""
