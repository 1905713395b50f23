#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ends the manager, or it and all its processes, at any moment, and compares the restored state.

Three threads work until then: two make, connect, protect and destroy nodelets of every kind, one
acquires and releases streams. All that was acknowledged has to be there afterwards, once, and no
more; a change that was under way was made completely or not at all.
"""

from __future__ import annotations

import collections
import random
import signal
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

import rospy
from manager_suite import (
    CPP_CHILD,
    ManagerCase,
    ManagerProcess,
    everything,
    library,
    listed,
    specification,
)
from processes import BUSY, becomes, eventually, nodes, run, suspended
from stream_suite import CAMERA, CEILING, FILTER, TRACKER

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.model.graph import NodeletStatus, State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter
from dyknow.ros.hosting import child_records
from dyknow.ros.wire.master import Master

LIBRARY = library(
    specification("relay", "dyknow_manager_test/Relay", ">in out>", rate=1.0),
    specification("heavy", "dyknow_manager_test/Heavy", ">in out>", rate=1.0),
    specification("half", "image_proc/resize", ">image ~image>", use_scale=True),
    specification("talker", "dyknow_test/talker.py", "words>", "node", rate=10),
    specification("copier", "topic_tools/relay words copy", ">words copy>", "node", lazy=False),
    *(CAMERA, CEILING, FILTER, TRACKER),
)
#: Label, in-port or none, out-port, and whether it has a process of its own.
KINDS = (
    ("relay", "in", "out", False),
    ("relay", "in", "out", True),
    ("half", "image", "~image", False),
    ("half", "image", "~image", True),
    ("heavy", "in", "out", False),
    ("talker", "", "words", False),
    ("talker", "", "words", True),
    ("copier", "words", "copy", False),
)
#: Last parts of the names of parameters.
SET_BY_DYKNOW = ("owner", "crash_record", "rate", "use_scale", "lazy", "note")
#: Without and with a variable.
TAGS = ("Raw(own)", "Position(ball)")


@dataclass(frozen=True)
class Made:
    """A nodelet as it should be."""

    label: str
    is_isolated: bool
    is_protected: bool
    topics: Tuple[Tuple[str, str], ...]
    parameters: Tuple[Parameter, ...]

    @classmethod
    def of(cls, nodelet: NodeletStatus) -> Made:
        declared = {port for kind in KINDS for port in kind[1:3]}
        topics = sorted((p.name, p.topic) for p in nodelet.ports if p.name in declared)
        isolated = nodelet.isolated and nodelet.transformation != "copier"
        return cls(
            nodelet.transformation,
            isolated,
            nodelet.is_protected,
            tuple(topics),
            nodelet.parameters,
        )


@dataclass
class Promises:
    """Acknowledged changes, and those under way, which may be made or not."""

    nodelets: Dict[str, Made] = field(default_factory=dict)
    claims: Dict[str, str] = field(default_factory=dict)  # topics by id
    doubtful: Dict[str, Tuple[Optional[Made], ...]] = field(default_factory=dict)
    #: Tags by id, "" for one that has none yet.
    doubtful_claims: Dict[str, str] = field(default_factory=dict)


class Work:
    """Changes of one sort, until the manager is gone."""

    def __init__(self, manager: ManagerProcess, promises: Promises, seed: int) -> None:
        self.client = manager.client
        self.promises = promises
        self.dice = random.Random(seed)
        self.over = threading.Event()
        self.troubles: List[str] = []

    def run(self, kinds: Sequence[int]) -> None:
        try:
            while not self.over.is_set():
                try:
                    if kinds:
                        self.change_nodelet(kinds)
                    else:
                        self.change_claim()
                        self.over.wait(self.dice.uniform(0.0, 0.3))
                except DyKnowError as error:
                    assert self.over.wait(20.0 * BUSY), f"refused: {error}"
        except Exception as error:
            self.troubles.append(repr(error))

    def change_nodelet(self, kinds: Sequence[int]) -> None:
        number = self.dice.choice(kinds)
        label, port_in, port_out, isolated = KINDS[number]
        name = f"/hand_{number}_{self.dice.randrange(2)}"
        old = self.promises.nodelets.get(name)
        topics = {port_out: self.dice.choice(["", f"{name}/a", f"{name}/b"])}
        if port_in:
            topics[port_in] = self.dice.choice(["", "/x", "/y"])
        pairs = tuple(sorted(topics.items()))
        if old is None:
            given = (Parameter("note", "string", str(self.dice.random())),)
            new: Optional[Made] = Made(label, isolated, self.dice.random() < 0.3, pairs, given)
        elif self.dice.random() < 0.6:
            new = Made(label, isolated, old.is_protected, pairs, old.parameters)
        elif old.is_protected:
            new = Made(label, isolated, False, old.topics, old.parameters)
        else:
            new = None
        self.promises.doubtful[name] = (old, new)
        if old is None:
            assert new is not None
            self.client.spawn(
                label,
                name,
                {port: topic for port, topic in topics.items() if topic},
                new.is_protected,
                isolated,
                parameters=new.parameters,
            )
        elif new is None:
            self.client.destroy(name)
        elif new.topics != old.topics:
            self.client.set_config(name, topics)
            while self.shown(name) != new and not self.over.is_set():
                time.sleep(0.02)  # its own proxy has acknowledged it, the manager has not yet
            if self.over.is_set():
                return
        else:
            self.client.set_protection(name, new.is_protected)
        if new is None:
            self.promises.nodelets.pop(name)
        else:
            self.promises.nodelets[name] = new
        del self.promises.doubtful[name]

    def shown(self, name: str) -> Optional[Made]:
        found = self.client.get_graph().nodelet(name)
        return Made.of(found) if found is not None else None

    def change_claim(self) -> None:
        promises = self.promises
        if len(promises.claims) < 3 and self.dice.random() < 0.7:
            tag = self.dice.choice(TAGS)
            promises.doubtful_claims[""] = tag
            found = self.client.acquire_stream(StreamRequest(tag))
            promises.claims[found.claim_id] = found.topic
            del promises.doubtful_claims[""]
        elif promises.claims:
            claim_id = self.dice.choice(sorted(promises.claims))
            promises.doubtful_claims[claim_id] = "released"
            self.client.release_stream(claim_id)
            del promises.claims[claim_id], promises.doubtful_claims[claim_id]

    def undo(self) -> None:
        for claim_id in self.promises.claims:
            self.client.release_stream(claim_id)
        for name, made in self.promises.nodelets.items():
            if made.is_protected:
                self.client.set_protection(name, False)
            self.client.destroy(name)
        self.promises.claims.clear()
        self.promises.nodelets.clear()


class BootTest(ManagerCase):
    """Lives of one manager, with all that it has made."""

    def test_everything_is_back_after_the_end_of_everything(self):
        seed = rospy.get_param("~seed", 0) or random.randrange(10000)
        print(f"seed {seed}")
        dice = random.Random(seed)
        self.promises = Promises()
        self.manager = self.started(own=True)
        self.manager.client.add_transformation(LIBRARY)
        before = self.at_the_master()
        for life in range(rospy.get_param("~lives", 1)):
            print(f"life {life}", flush=True)
            self.work(dice)
            while dice.random() < 0.25:  # once more, while it comes back
                self.manager.start(wait=False)
                time.sleep(dice.uniform(0.0, 4.0))
                self.end(everything=dice.random() < 0.5)
            self.manager.start()
            self.resolve()
            eventually(lambda: not self.wrong(), 30.0, "all is there again", self.told)
        Work(self.manager, self.promises, 0).undo()
        becomes(lambda: self.at_the_master() ^ before, set(), 20.0)

    def work(self, dice: random.Random) -> None:
        """Make changes until everything ends at once."""
        works = [Work(self.manager, self.promises, dice.randrange(1 << 30)) for _ in range(3)]
        kinds = (range(4), range(4, len(KINDS)), ())
        threads = [
            threading.Thread(target=work.run, args=(each,)) for work, each in zip(works, kinds)
        ]
        for thread in threads:
            thread.start()
        time.sleep(dice.uniform(0.1, 6.0 if rospy.has_param("~lives") else 2.0))
        self.end(everything=dice.random() < 0.7, works=works)
        for thread in threads:
            thread.join()
        self.assertEqual([each.troubles for each in works], [[]] * 3, self.manager.output)

    def end(self, everything: bool, works: Sequence[Work] = ()) -> None:
        """Kill the manager, and perhaps all processes that it started, in one moment."""
        with suspended(self.manager.process.pid):
            running = self.processes() if everything else []
            for work in works:
                work.over.set()
            for record in running:
                record.process.signal(signal.SIGKILL)
            self.manager.kill()
        for record in running:
            record.process.wait(10.0 * BUSY)

    def processes(self) -> List[Any]:
        """The processes of the manager, as the system knows them."""
        for lock in Path(self.manager.state).glob("*.lock"):
            return child_records.running(str(lock))
        return []

    # The state

    def resolve(self) -> None:
        """Accept either outcome of the changes that were under way."""
        promises, client = self.promises, self.manager.client
        eventually(self.is_calm, 60.0, "nothing is starting any more", self.told)
        found = {each.name: Made.of(each) for each in client.get_graph().nodelets}
        for name, outcomes in promises.doubtful.items():
            self.assertIn(found.get(name), outcomes, name)
            promises.nodelets.pop(name, None)
            if name in found:
                promises.nodelets[name] = found[name]
        living = {each.claim_id: each for each in self.manager.claims()}
        for claim_id, tag in promises.doubtful_claims.items():
            if claim_id and claim_id not in living:
                promises.claims.pop(claim_id)
            strange = [each for each in living.values() if each.claim_id not in promises.claims]
            if not claim_id and strange:
                self.assertEqual([each.tag for each in strange], [tag])
                promises.claims[strange[0].claim_id] = strange[0].topic
        promises.doubtful.clear()
        promises.doubtful_claims.clear()

    def is_calm(self) -> bool:
        nodelets = self.manager.client.get_graph().nodelets
        return all(each.state is State.RUNNING for each in nodelets) and all(
            each.state is ClaimState.ACTIVE for each in self.manager.claims()
        )

    def wrong(self) -> List[str]:
        """Report lost, doubled, orphaned and leftover things."""
        client, promises = self.manager.client, self.promises
        nodelets = {each.name: each for each in client.get_graph().nodelets}
        claims = self.manager.claims()
        found = [f"{name} is {each}" for name, each in nodelets.items() if each.state != 1]
        made = {name: Made.of(each) for name, each in nodelets.items() if "/hand_" in name}
        found += differences("nodelet", promises.nodelets, made)
        found += differences("claim", promises.claims, {e.claim_id: e.topic for e in claims})
        found += [f"{each}" for each in claims if each.state is not ClaimState.ACTIVE]
        needed = {name for each in claims for name in each.nodelets}
        parts = dict.fromkeys(set(nodelets) - set(made))
        found += differences("part", dict.fromkeys(needed), parts)

        running = self.processes()
        counted = collections.Counter(each.name for each in running)
        found += [f"{name} runs {times} times" for name, times in counted.items() if times > 1]
        processes = {each.name: each.process for each in running}
        found += differences("child", self.manager.children(), processes)
        alone = {name for name, each in nodelets.items() if each.isolated}
        for_one = {each.isolated_for for each in running} - {""}
        found += differences("process of", dict.fromkeys(alone), dict.fromkeys(for_one))
        hosted = [name for each in running for name in self.hosted(each)]
        found += differences("hosted", dict.fromkeys(nodelets), collections.Counter(hosted))
        found += [f"{name} is hosted twice" for name in hosted if hosted.count(name) > 1]

        living = {each.name for each in running} | {self.manager.node, rospy.get_name(), "/rosout"}
        found += [f"{what} is dead" for what in self.dead() if what not in living]
        owners = tuple(f"parameter {name}/" for name in living | set(nodelets))
        return found + [each for each in set_by_dyknow() if not each.startswith(owners)]

    def hosted(self, record: Any) -> List[str]:
        if record.kind.is_node:
            return [record.name]
        found = listed(record.name)
        return [f"{record.name} does not answer"] if found is None else found

    def dead(self) -> List[str]:
        """Nodes at the master that do not answer."""
        master, found = Master(rospy.get_name()), []
        for node in sorted(nodes()):
            try:
                master.pid(node, master.node(node), 5.0)
            except (PeerTimeout, LookupError):
                found.append(node)
        return found

    def at_the_master(self) -> Set[str]:
        """All registrations and parameters, without the test's own and shared C++ processes."""
        registered = {each for each in everything() if not each.startswith("parameter ")}
        others = registered | {*set_by_dyknow()}
        return {each for each in others if CPP_CHILD not in each and rospy.get_name() not in each}

    def told(self) -> str:
        return "\n".join([*self.wrong(), "", self.manager.output[-20000:]])


def set_by_dyknow() -> List[str]:
    """Parameters that the manager sets; those that a nodelet sets for itself are its own."""
    return [
        each
        for each in everything()
        if each.startswith("parameter ")
        and (each.rpartition("/")[2] in SET_BY_DYKNOW or "/guards/" in each)
    ]


def differences(what: str, wanted: Mapping[str, Any], found: Mapping[str, Any]) -> List[str]:
    """Report missing, surplus and different entries; counts are not compared."""
    both = set() if isinstance(found, collections.Counter) else set(wanted) & set(found)
    return (
        [f"{what} {name} is missing" for name in sorted(set(wanted) - set(found))]
        + [f"{what} {name} is too much" for name in sorted(set(found) - set(wanted))]
        + [
            f"{what} {name} is {found[name]}, not {wanted[name]}"
            for name in sorted(both)
            if wanted[name] != found[name]
        ]
    )


if __name__ == "__main__":
    run()
