#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Thousands of random operations: neither the manager nor its nodelet managers grow.

Nothing forces a garbage collection here: on a robot, too, Python alone frees memory.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import Any, Callable
from urllib.parse import urlsplit

import graph
import psutil
import rosgraph
from cpp_suite import RUN
from manager_suite import MANAGER, ManagerCase, everything
from processes import Ended, eventually, run
from stream_suite import transformation
from test_boot import LIBRARY, TAGS, Promises, Work

from dyknow.errors import DyKnowError
from dyknow.model.streams import StreamRequest

OPERATIONS = int(os.environ.get("DYKNOW_SOAK_OPERATIONS", "10000"))
SEED = int(os.environ.get("DYKNOW_SOAK_SEED", "1"))
#: Operations until caches are full and pools as large as they become.
WARM = 1000
#: Operations between two readings.
STRETCH = 500
#: Bytes that a process may grow in 1,000 operations.
MOST = 1_000_000
#: Connections to the ROS master that a process keeps: two for each of its parts that ask it.
MOST_ASKING = 16
PROCESSES = 3
#: The output and the crash record of each nodelet manager, and the outputs of the last that ended.
KEPT_OUTPUTS = 2 * 2 + 10
LAUNCH = ("rosrun", "dyknow", "dyknow", "launch", "--skip-log-check")
LAUNCH_FILE = str(Path(__file__).resolve().parent.parent / "launch" / "soak.launch")
#: Kinds of nodelets, mostly those that need no process; none in C++, whose library keeps memory.
SOAKED = [0] * 8 + [4] * 8 + [5, 5, 1, 7]


class SoakTest(ManagerCase):
    def test_nothing_grows(self):
        print(f"{OPERATIONS} operations, DYKNOW_SOAK_SEED={SEED}", flush=True)
        self.manager = self.started(num_nodelet_managers=2)
        self.client = self.manager.client
        self.client.add_transformation(LIBRARY)
        self.work = Work(self.manager, Promises(), SEED)
        self.random = self.work.dice
        self.processes: list[Ended] = []
        self.addCleanup(self.end_processes)
        self.number, self.refused = 0, 0
        self.counts: dict[str, int] = {}
        self.use_each()
        self.rest()
        readings: dict[int, dict[str, Any]] = {}
        named: dict[int, set[str]] = {}
        began = time.monotonic()
        for number in range(1, OPERATIONS + 1):
            self.operate()
            if number % STRETCH == 0:
                self.rest()
                readings[number] = self.reading()
                named[number] = everything()
                seconds = time.monotonic() - began
                print(f"{number}: {seconds:.0f} s, {readings[number]}", flush=True)
        print(f"{self.counts}, {self.refused} refused")
        new = sorted(named[max(named)] - named[min(named)])
        self.judge(readings, f"at the master now, but not at first: {new}")

    def use_each(self) -> None:
        """Let each nodelet manager start the threads that stay from their first use on.

        Those for timers and leases may else start after the first readings, in the one that the
        manager chooses less often.
        """
        children = sorted(self.manager.children())
        self.assertEqual(len(children), 2)
        for chosen, other in (children, reversed(children)):
            busy = [f"/busy_{number}" for number in range(3)]
            for name in busy:  # so that the parts of claims go where there is less
                self.spawned(self.manager, name, other)
            self.client.spawn("heavy", "/used", manager=chosen)
            for tag in TAGS:
                claim = self.client.acquire_stream(StreamRequest(tag))
                parts = {name: self.manager.nodelet(name).manager for name in claim.spawned}
                self.assertIn(chosen, parts.values(), parts)
                self.client.release_stream(claim.claim_id)
                eventually(
                    lambda parts=parts: not parts.keys() & {n.name for n in self.nodelets()},
                    30.0,
                    f"{tag} is given up",
                )
            for name in (*busy, "/used"):
                self.client.destroy(name)

    def nodelets(self) -> Any:
        return self.client.get_model().nodelets

    def judge(self, readings: dict[int, dict[str, Any]], remark: str) -> None:
        last = max(readings)
        early = [found for number, found in readings.items() if number <= WARM]
        late = [found for number, found in readings.items() if number > (WARM + last) / 2]
        grown = {}
        for key in readings[last]:
            if key.endswith(" memory"):
                span = max(last - WARM, 2 * WARM)  # fluctuations count less in a long run
                share = (readings[last][key] - readings[WARM][key]) / span * 1000
                print(f"{key}: {share / 1e6:.2f} MB in 1,000 operations")
                if share > MOST:
                    grown[key] = f"{share / 1e6:.2f} MB in 1,000 operations"
            else:  # some come and go by themselves: one that grows is always more than it was
                before, after = max(each[key] for each in early), min(each[key] for each in late)
                if after > before:
                    grown[key] = f"at most {before} at first, at least {after} at last"
        self.assertEqual(grown, {}, remark)

    # Operations

    def operate(self) -> None:
        kinds: dict[Callable[[], None], float] = {
            lambda: self.work.change_nodelet(SOAKED): 85,
            self.work.change_claim: 16,
            self.reload: 2,
            self.specify: 2,
            self.load_a_failing_one: 1,
            self.run_node: 0.3,
            self.launch: 0.1,
            self.stop: 0.4,
        }
        operation = self.random.choices(list(kinds), list(kinds.values()))[0]
        self.counts[operation.__name__] = self.counts.get(operation.__name__, 0) + 1
        try:
            operation()
        except DyKnowError as error:
            self.refused += 1
            if self.refused < 10:
                print(f"{operation.__name__}: {error}", flush=True)

    def reload(self) -> None:
        """Unload a nodelet behind the manager's back."""
        names = [
            name
            for name, made in sorted(self.work.promises.nodelets.items())
            if made.label in ("relay", "heavy") and not made.is_protected
        ]
        if names:
            name = self.random.choice(names)
            graph.ManagerServices(self.manager.nodelet(name).manager).unload(name)
            del self.work.promises.nodelets[name]
            self.manager.is_gone(name)

    def specify(self) -> None:
        """Add or remove a transformation."""
        label = f"more {self.random.randrange(10)}"
        if self.random.random() < 0.5:
            self.client.add_transformation(transformation(label, "Counter", "Raw(other)"))
        else:
            with contextlib.suppress(DyKnowError):
                self.client.remove_transformation(label)

    def load_a_failing_one(self) -> None:
        with self.assertRaises(DyKnowError):
            self.client.spawn("fails", "/fails", {})

    def run_node(self) -> None:
        self.number += 1
        name = f"__name:=other_{self.number}"
        self.start(*RUN, "topic_tools", "relay", "/t1", "/t2", name)

    def launch(self) -> None:
        self.number += 1
        self.start(*LAUNCH, LAUNCH_FILE, f"name:=launched_{self.number}")

    def start(self, *command: str) -> None:
        if len(self.processes) >= PROCESSES:
            self.stop()
        self.processes.append(Ended(*command))

    def stop(self) -> None:
        if self.processes:
            self.processes.pop(self.random.randrange(len(self.processes))).__exit__()

    def end_processes(self) -> None:
        while self.processes:
            self.processes.pop().__exit__()

    # Readings

    def rest(self) -> None:
        """End everything, and wait until the manager has done so too."""
        self.end_processes()
        self.work.undo()
        eventually(lambda: not self.nodelets(), 30.0, "nothing runs any more", self.nodelets)
        self.settled()

    def settled(self) -> None:
        """Wait until counts that vary by themselves stand still for a while."""
        last: Any = None
        since = time.monotonic()
        while time.monotonic() - since < 8.0:  # longer than idle threads and connections stay
            now = {key: value for key, value in self.reading().items() if "memory" not in key}
            if now != last:
                last, since = now, time.monotonic()
            time.sleep(0.25)

    def reading(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        children = self.manager.children()
        pids = {"manager": self.manager.process.pid}
        pids.update({name: child.pid for name, child in sorted(children.items())})
        for name, pid in pids.items():
            process = psutil.Process(pid)
            node = self.manager.node if name == "manager" else name
            asked, asking = self.connections(process, node)
            self.assertLessEqual(asking, MOST_ASKING, name)
            found[f"{name} memory"] = process.memory_info().rss
            found[f"{name} descriptors"] = process.num_fds() - asked - asking
            found[f"{name} threads"] = process.num_threads() - asked
        found["at the master"] = len(everything())
        found["state files"] = len(list(Path(self.manager.state).rglob("*")))
        logs = Path(os.environ["ROS_HOME"], "log")
        # Files that ROS writes for each node are not ours; ours of the last that ended are kept.
        outputs = [file for each in logs.glob("dyknow-*") for file in each.iterdir()]
        found["outputs of children"] = max(0, len(outputs) - KEPT_OUTPUTS)
        return found

    def connections(self, process: psutil.Process, node: str) -> tuple[int, int]:
        """Count the connections to a node's XML-RPC server, and those of the node to the master.

        Each of the first takes a descriptor and a thread of it. The ROS master keeps up to three,
        one for each of its own threads, to the nodes that it informed lately. Of the second each
        part of a node that asks the master keeps two, once it has asked twice at one moment.
        """
        master = rosgraph.Master(MANAGER)
        own, its = (urlsplit(uri).port for uri in (master.lookupNode(node), master.getUri()))
        connections = [
            each for each in process.connections("tcp") if each.status == psutil.CONN_ESTABLISHED
        ]
        return (
            sum(each.laddr.port == own for each in connections),
            sum(each.raddr.port == its for each in connections),
        )


if __name__ == "__main__":
    run()
