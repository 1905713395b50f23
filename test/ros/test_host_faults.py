#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Random faults, one after the other, between three hosts whose streams are signed.

Claims may use every host. Beside them each host has a stream of its own, made by hand and pinned
to it, whose messages are numbered. Claims with a part on the host that has the fault are repaired,
once. Everything else goes on without a change and without a lost message, and no message that does
not meet the demand of its receiver comes anywhere. The parameters ~faults and ~seed say how many
(long/host_faults.test).
"""

from __future__ import annotations

import contextlib
import json
import random
import statistics
import sys
import time
from pathlib import Path
from typing import Callable, Collection, ContextManager, Iterator

import hosts_suite
import rospy
from graph import PACKAGES, Heard
from hosts_suite import HostsCase
from manager_suite import CHILD, ManagerProcess, listed
from processes import Running, eventually, suspended
from std_msgs.msg import Header

from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter, Port, Transformation

sys.path.append(str(PACKAGES / "dyknow_manager_test" / "src"))
import signatures

#: Seconds from a fault to the first message of the repaired stream, on a quiet machine.
REPAIRED = 3.0
#: Seconds for which a fault goes on when all is repaired.
HELD = 1.0
CLAIMS = ("Found(left)", "Found(right)", "Clean(left)")
#: By host, its nodelet manager; those of the far ones are external.
MANAGERS = {"desk": CHILD, "rover": "/rover_manager", "scout": "/scout_manager"}


def signed(label: str, inputs: str, output: str, report: Path, is_whole: bool = False) -> str:
    """Write a transformation whose nodelets sign, with one in-port, one out-port, or both."""
    ends = [("in", "in", inputs), ("out", "out", output)]
    listed_ends = [each for each in ends if each[2]]
    ports = tuple(Port(name, way, "std_msgs/Header", (tag,)) for name, way, tag in listed_ends)
    values = {"ports": json.dumps(listed_ends), "kinds": "{}", "report": str(report), "rate": "20"}
    parameters = [Parameter(name, "string", value) for name, value in values.items()]
    parameters.append(Parameter("whole", "bool", str(is_whole).lower()))
    source = "dyknow_manager_test/Signed"
    return Transformation(label, source, "nodelet", 1, tuple(parameters), ports).to_xml()


class Client(Heard):
    """Reads a stream: notes the sender and number of each message, and those with wrong tags."""

    def __init__(self, topic: str, tag: str) -> None:
        self.wrong: list[str] = []

        def read(message: Header) -> tuple[str, int]:
            found = signatures.signature(message)
            if not signatures.all_met(found["tags"], [tag], {}):
                self.wrong.append(f"the client of {tag} on {topic} got {found}")
            return found["by"], found["number"]

        super().__init__(topic, note=read)

    def lost(self, since: int, senders: Collection[str]) -> list[str]:
        """Gaps in the numbers of these senders since the message of that index.

        Messages that a replaced part sent before its link was cut may still come.
        """
        numbers = [each for each in self[since:] if each[0] in senders]
        pairs = zip(numbers, numbers[1:])
        return [f"{a} is followed by {b}" for a, b in pairs if b != (a[0], a[1] + 1)]

    def resumed(self, since: float) -> float:
        """Seconds from a moment to the end of the longest pause after it."""
        times = [since, *(each for each in list(self.times) if each > since)]
        pauses = [(later - earlier, later) for earlier, later in zip(times, times[1:])]
        return max(pauses)[1] - since


class HostFaultsTest(HostsCase):
    def start(self) -> None:
        self.far = {"rover": self.host(), "scout": self.host()}
        self.processes: dict[str, Running] = {}
        for name in self.far:
            self.start_far(name)
        self.manager: ManagerProcess = self.make(
            nodelet_managers=[MANAGERS["rover"], MANAGERS["scout"]], linger=1.0
        )
        self.manager.command = self.network.desk.command(*self.manager.command)
        self.manager.start()
        self.report = Path(self.manager.state, "report.txt")
        client = self.manager.client
        for side in ("left", "right"):
            client.add_transformation(signed(f"source {side}", "", f"Raw({side})", self.report))
        client.add_transformation(signed("worker", "Raw(?x)", "Clean(?x)", self.report))
        client.add_transformation(signed("finder", "Clean(?x)", "Found(?x)", self.report))
        client.add_transformation(signed("own", "", "Own(stream)", self.report))
        client.add_transformation(signed("check", "Own(stream)", "", self.report, True))
        addresses = {"desk": self.network.desk, **self.far}
        self.names = {host.address: name for name, host in addresses.items()}
        eventually(lambda: len(self.away()) == 0, 20.0, "all hosts are known", self.shown)
        self.own: dict[str, Client] = {}
        for name, host in addresses.items():
            topic, place = f"/own_{name}/out", f"@{host.address}"
            client.spawn("check", f"/check_{name}", {"in": topic}, manager=place)
            client.spawn("own", f"/own_{name}", {"out": topic}, manager=place)
            self.own[name] = self.enter(Client(topic, "Own(stream)"))
        self.heard = self.events()
        self.clients: dict[str, Client] = {}
        for tag in CLAIMS:
            answer = client.acquire_stream(StreamRequest(tag, client_id="faults"))
            self.clients[answer.claim_id] = self.enter(Client(answer.topic, tag))
        self.is_whole()

    def start_far(self, name: str) -> None:
        manager = MANAGERS[name].lstrip("/")
        self.processes[name] = self.nodelet_manager(self.far[name], manager)

    def away(self) -> list[str]:
        """Hosts that the manager does not know as present."""
        there = {e.name for e in self.manager.client.list_hosts() if not e.is_away and e.managers}
        return sorted(self.names.keys() - there)

    def shown(self) -> str:
        model = self.manager.client.get_model()
        nodelets = "\n".join(
            f"{e.name} {e.host} {e.state.name} {e.detail}" for e in model.nodelets
        )
        claims = "\n".join(map(str, self.manager.claims()))
        hosts = "\n".join(map(str, self.manager.client.list_hosts()))
        return f"{nodelets}\n{claims}\n{hosts}\n{self.manager.output[-6000:]}"

    def is_whole(self) -> None:
        """Wait until every host is there, all claims are met, and nothing unused runs."""
        left: list[str] = []

        def holds() -> bool:
            claims = self.manager.claims()
            model = self.manager.client.get_model()
            running = [name for each in MANAGERS.values() for name in listed(each) or ()]
            needed = {name for claim in claims for name in claim.nodelets}
            needed |= {f"/{kind}_{name}" for kind in ("own", "check") for name in MANAGERS}
            left[:] = [
                *(f"{each} is away" for each in self.away()),
                *(f"{e.claim_id}: {e}" for e in claims if e.state is not ClaimState.ACTIVE),
                *(f"{e.name} does not run" for e in model.nodelets if e.state != State.RUNNING),
                *(f"{name} runs, and is not used" for name in running if name not in needed),
                *(f"{name} runs twice" for name in set(running) if running.count(name) > 1),
                *(f"{name} is missing" for name in needed.difference(running)),
            ]
            return not left

        def shown() -> str:
            return "\n".join([*left, self.shown()])

        eventually(holds, 30.0, "all is whole again", shown)
        for each in (*self.clients.values(), *self.own.values()):
            each.flows()

    # Faults

    def faults(self) -> dict[str, Callable[[str], ContextManager[object]]]:
        """Faults of hosts, by name; the desk has only those of its nodelet manager."""
        network, desk = self.network, self.network.desk
        return {
            "its link is cut": lambda name: network.cut(self.far[name]),
            "it is not heard": lambda name: network.without((self.far[name], desk)),
            "it hears nothing": lambda name: network.without((desk, self.far[name])),
            "its link is slow": lambda name: network.far(self.far[name], 0.1),
            "SIGSTOP": self.stopped,
            "SIGKILL": self.killed,
            "the far hosts do not reach each other": self.apart,
        }

    def stopped(self, name: str) -> ContextManager[object]:
        if name == "desk":
            return self.manager.child_stopped()
        return suspended(self.processes[name].pid)

    @contextlib.contextmanager
    def killed(self, name: str) -> Iterator[None]:
        if name == "desk":
            self.manager.kill_child()
            yield
            return
        self.processes[name].__exit__()
        yield
        self.start_far(name)

    def apart(self, name: str) -> ContextManager[object]:
        rover, scout = self.far.values()
        return self.network.without((rover, scout), (scout, rover))

    def live_through(self, fault: str, name: str) -> None:
        """Let a host have a fault, and judge its effects."""
        claims = {each.claim_id: each for each in self.manager.claims()}
        places = {
            each.name: self.names.get(each.host, "desk")
            for each in self.manager.client.get_model().nodelets
        }
        used = {key: {places[each] for each in claim.nodelets} for key, claim in claims.items()}
        is_loss = fault in self.losses
        involved = (
            {"rover", "scout"} if fault == "the far hosts do not reach each other" else {name}
        )
        hit = {key for key, hosts in used.items() if is_loss and name in hosts}
        calm = {key for key, hosts in used.items() if not hosts & involved}
        calm |= set() if is_loss else {key for key, hosts in used.items() if len(hosts) == 1}
        untouched = {
            **{key: self.clients[key] for key in calm},
            **{host: client for host, client in self.own.items() if host not in involved},
        }
        marks = {key: len(client) for key, client in untouched.items()}
        since = len(self.heard)

        def is_calm() -> bool:
            return not any(self.heard.changes(since, key) for key in calm)

        began = time.monotonic()
        with self.faults()[fault](name):
            for key in sorted(hit):
                self.is_repaired(key, name)
                self.repairs.append((self.clients[key].resumed(began), fault))
            self.stays(HELD, is_calm, lambda: self.heard.reasons()[since:])
        self.is_whole()
        self.assertTrue(is_calm(), f"{fault} of {name}: {self.heard.reasons()[since:]}")
        for key in sorted(hit):
            events = [each for each in self.heard[since:] if each.after.claim_id == key]
            losses = [each for each in self.heard.changes(since, key) if "RECOVERING" in each]
            is_mended = any(each.reason.startswith("mended") for each in events)
            self.assertTrue(is_mended and len(losses) <= 1, f"{fault} of {name}: {events}")
        senders = {key: claims[key].nodelets for key in calm}
        senders.update((host, [f"/own_{host}"]) for host in self.own)
        lost = {key: client.lost(marks[key], senders[key]) for key, client in untouched.items()}
        self.assertEqual({k: v for k, v in lost.items() if v}, {}, f"{fault} of {name}")
        self.late += sum(
            each[0] not in senders[key]
            for key, client in untouched.items()
            for each in client[marks[key] :]
        )
        self.untouched += sum(len(client) - marks[key] for key, client in untouched.items())
        clients = (*self.clients.values(), *self.own.values())
        wrong = [text for client in clients for text in client.wrong]
        for ending in ("", ".mixed", ".lost"):
            file = Path(f"{self.report}{ending}")
            wrong += file.read_text().splitlines() if file.exists() else []
        self.assertEqual(wrong, [], f"{fault} of {name}")
        print(f"{fault} of {name}: {len(hit)} claims hit, {len(untouched)} streams untouched")

    def is_repaired(self, claim_id: str, host: str) -> None:
        """Wait until a claim is met without a host, and flows."""

        def is_elsewhere() -> bool:
            claim = self.claim(self.manager, claim_id)
            model = self.manager.client.get_model()
            hosts = {
                self.names.get(each.host, "desk")
                for each in model.nodelets
                if each.name in claim.nodelets and each.state is State.RUNNING
            }
            is_back = host == "desk" and listed(CHILD) is not None
            return claim.state is ClaimState.ACTIVE and (host not in hosts or is_back)

        eventually(is_elsewhere, 2 * REPAIRED, f"{claim_id} is repaired", self.shown)
        self.clients[claim_id].flows()

    #: Faults by which a host's parts of claims are lost.
    losses = ("its link is cut", "it is not heard", "it hears nothing", "SIGSTOP", "SIGKILL")

    def test_random_faults(self):
        choice = random.Random(rospy.get_param("~seed", 1))
        self.repairs: list[tuple[float, str]] = []
        self.untouched = self.late = 0
        self.start()
        for _ in range(rospy.get_param("~faults", 5)):
            model = self.manager.client.get_model()
            needed = {name for claim in self.manager.claims() for name in claim.nodelets}
            busy = [self.names.get(e.host, "desk") for e in model.nodelets if e.name in needed]
            name = choice.choice([*busy, *MANAGERS])  # where claims have parts, mostly
            able = [each for each in self.faults() if name in self.far or each.startswith("SIG")]
            self.live_through(choice.choice(able), name)
        times = sorted(self.repairs)
        read = sum(len(each) for each in (*self.clients.values(), *self.own.values()))
        print(f"{read} messages read, {self.untouched} of untouched streams, none lost")
        print(f"{self.late} messages came late, of parts that had been replaced")
        if times:
            slow = [f"{seconds:.2f} s ({fault})" for seconds, fault in times if seconds > REPAIRED]
            middle = statistics.median(seconds for seconds, _ in times)
            print(
                f"{len(times)} repairs: median {middle:.2f} s, longest {times[-1][0]:.2f} s "
                f"({times[-1][1]}); longer than {REPAIRED:g} s: {slow or 'none'}"
            )


if __name__ == "__main__":
    hosts_suite.run()
