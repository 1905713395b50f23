#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sources sign their messages, and no receiver gets a message that does not meet its demand.

Random libraries live through random steps of users, faults and other programs. The parameters
~seeds and ~steps say how often and how long (long/signed_streams.test).
"""

from __future__ import annotations

import contextlib
import json
import random
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Sequence

import rospy
from graph import PACKAGES, Heard
from manager_suite import CHILD, ManagerCase, ManagerProcess
from nodelet.srv import NodeletUnload
from processes import becomes, eventually, run
from std_msgs.msg import Header, String

from dyknow.errors import DyKnowError
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter, Port, Transformation

sys.path.append(str(PACKAGES / "dyknow_manager_test" / "src"))
import signatures

INDIVIDUALS = ("left", "right", "above")
FUNCTORS = ("Raw", "Clean", "Found", "Placed")
KINDS = {**dict.fromkeys(FUNCTORS, ("Stream",)), **dict.fromkeys(INDIVIDUALS, ("Place",))}
GOALS = [f"{functor}({each})" for functor in FUNCTORS for each in (*INDIVIDUALS, "?any")]
ONTOLOGY = """\
@prefix : <http://dyknow.example.org/signed#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
:Stream a owl:Class . :Place a owl:Class .
""" + "".join(
    [f":{each} a owl:Class ; rdfs:subClassOf :Stream .\n" for each in FUNCTORS]
    + [f':{each} a :Place ; rdfs:label "{each}" .\n' for each in INDIVIDUALS]
)


@dataclass(frozen=True)
class Signed:
    """A transformation whose nodelets sign; each port demands or supplies one tag."""

    label: str
    inputs: dict[str, str]
    outputs: dict[str, str]
    cost: int = 1
    topic: str = ""
    rate: int = 20

    def xml(self, report: str) -> str:
        both = (("in", self.inputs), ("out", self.outputs))
        listed = [(name, way, tag) for way, ports in both for name, tag in ports.items()]
        ports = tuple(Port(name, way, "std_msgs/Header", (tag,)) for name, way, tag in listed)
        if self.topic:
            return Transformation(self.label, self.topic, "topic", self.cost, (), ports).to_xml()
        values = {"ports": json.dumps(listed), "kinds": json.dumps(KINDS), "report": report}
        values["rate"] = str(self.rate)
        params = tuple(Parameter(name, "string", value) for name, value in values.items())
        source = "dyknow_manager_test/Signed"
        return Transformation(self.label, source, "nodelet", self.cost, params, ports).to_xml()

    def replaced(self, choice: random.Random) -> Signed:
        """Another one with this label, whose outputs keep their functors."""
        outputs = {
            name: f"{signatures.parse(tag)[0]}({choice.choice(INDIVIDUALS)})"
            for name, tag in self.outputs.items()
        }
        return replace(self, outputs=outputs, cost=choice.randrange(10))


def random_library(choice: random.Random) -> list[Signed]:
    """Layers of random transformations over three individuals; some demand a superclass."""
    found = [
        Signed(f"source {each}", {}, {"out": f"Raw({each})"}, choice.randrange(6))
        for each in INDIVIDUALS
    ]
    found.append(Signed("outside", {}, {"out": "Raw(left)"}, 0, "/outside"))
    for number in range(10):
        layer = choice.randrange(1, len(FUNCTORS))
        inputs = {}
        for index in range(choice.choice((1, 1, 2))):
            functor = FUNCTORS[choice.randrange(layer)] if choice.random() < 0.8 else "Stream"
            argument = choice.choice((*INDIVIDUALS, "?x", "?x", "Place"))
            inputs[f"in{index}"] = f"{functor}({argument})"
        bound = ["?x"] * 3 if "?x" in "".join(inputs.values()) else []
        outputs = {
            f"out{index}": f"{FUNCTORS[layer]}({choice.choice((*INDIVIDUALS, *bound))})"
            for index in range(choice.choice((1, 1, 2)))
        }
        found.append(Signed(f"worker {number}", inputs, outputs, choice.randrange(6)))
    return found


class Reader(Heard):
    """A client's subscriber: records messages whose signature does not meet its request."""

    def __init__(self, topic: str, tag: str) -> None:
        self.wrong: list[str] = []

        def read(message: Header) -> list[str]:
            found = signatures.signature(message)
            if not signatures.all_met(found["tags"], [tag], KINDS):
                self.wrong.append(f"the client of {tag} on {topic} got {found}")
            return found["tags"]

        super().__init__(topic, note=read)


@dataclass
class RandomLife:
    """Takes random steps, and checks after each of them."""

    manager: ManagerProcess
    choice: random.Random
    library: list[Signed]
    report: Path
    readers: dict[str, Reader] = field(default_factory=dict)
    trace: list[str] = field(default_factory=list)
    checked: int = 0
    spawned: int = 0

    def __post_init__(self) -> None:
        self.client = self.manager.client
        self.orders = rospy.Publisher("/orders", String, queue_size=100)
        self.outside: rospy.Publisher | None = None
        self.timer = rospy.Timer(rospy.Duration(0.05), self._publish_outside)

    def close(self) -> None:
        self.timer.shutdown()
        for each in (self.orders, self.outside):
            if each is not None:
                each.unregister()
        for reader in self.readers.values():
            reader.close()

    # The steps

    def step(self, kind: Callable[[], str] | None = None) -> None:
        """Take a step, by default a random one, and check everything."""
        kind = kind or self.choice.choice(
            [self.acquire] * 4
            + [self.release, self.remove, self.remove, self.add_back, self.add_back, self.replace]
            + [self.destroy, self.unload, self.silence, self.speak, self.spawn, self.rewire]
            + [self.toggle_outside, self.kill_child, self.kill_manager, self.exit_one, self.wait]
        )
        self.trace.append(f"{time.time():.2f} {kind.__name__}")
        try:
            self.trace[-1] += f" {kind()}"
        except (DyKnowError, rospy.ServiceException) as error:
            self.trace[-1] += f" refused: {str(error)[:300]}"
        self.check()

    def add(self, *transformations: Signed) -> str:
        for each in transformations:
            self.client.add_transformation(each.xml(str(self.report)))
        return transformations[-1].label

    def acquire(self) -> str:
        if len(self.manager.claims()) >= 5:
            return self.release()
        tag, silence = self.choice.choice(GOALS), self.choice.choice((0.0, 1.0))
        self.trace[-1] += f" {tag}"
        request = StreamRequest(tag, client_id="signed", max_silence=silence)
        answer = self.client.acquire_stream(request)
        return f"{answer.claim_id} on {answer.topic}"

    def release(self) -> str:
        living = sorted(each.claim_id for each in self.manager.claims())
        if not living:
            return "nothing"
        claim_id = self.choice.choice(living)
        if claim_id in self.readers:  # first: the topic may serve another claim next
            self.readers.pop(claim_id).close()
        self.client.release_stream(claim_id)
        return claim_id

    def remove(self) -> str:
        label = self.choice.choice(self.library).label
        self.client.remove_transformation(label)
        return label

    def add_back(self) -> str:
        return self.add(self.choice.choice(self.library))

    def replace(self) -> str:
        return self.add(self.choice.choice(self.library).replaced(self.choice))

    def remove_all(self) -> str:
        """Leave nothing of which a claim could be made: each is PENDING then."""
        for each in self.library:
            with contextlib.suppress(DyKnowError):
                self.client.remove_transformation(each.label)

        def is_pending() -> bool:
            for each in self.client.get_model().nodelets:
                with contextlib.suppress(DyKnowError):
                    self.client.destroy(each.name)
            return all(each.state is ClaimState.PENDING for each in self.manager.claims())

        eventually(is_pending, 20.0, "all claims are PENDING", lambda: self._account([]))
        return "all"

    def _nodelet(self) -> str:
        names = [each.name for each in self.client.get_model().nodelets]
        return self.choice.choice(sorted(names)) if names else "/nobody"

    def destroy(self) -> str:
        name = self._nodelet()
        self.client.destroy(name)
        return name

    def unload(self) -> str:
        name = self._nodelet()
        rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)(name)
        return name

    def _order(self, order: str) -> str:
        self.orders.publish(order)
        return order

    def silence(self) -> str:
        return self._order(f"{self._nodelet()} silent")

    def speak(self) -> str:
        return self._order("all speak")

    def exit_one(self) -> str:
        return self._order(f"{self._nodelet()} exit") if self.choice.random() < 0.3 else "no"

    def spawn(self) -> str:
        chosen = self.choice.choice([each for each in self.library if not each.topic])
        self.spawned += 1
        name = f"/hand_{self.spawned}"
        self.client.spawn(chosen.label, name, {next(iter(chosen.outputs)): f"{name}/here"})
        return f"{chosen.label} as {name}"

    def rewire(self) -> str:
        """Move an out-port of a nodelet spawned by hand to a topic of its own."""
        nodelets = self.client.get_model().nodelets
        mine = [each for each in nodelets if each.name.startswith("/hand_") and each.ports]
        if not mine:
            return "nothing"
        nodelet = self.choice.choice(mine)
        ports = [port.name for port in nodelet.ports if port.direction == "out"]
        port, topic = self.choice.choice(ports), self.choice.choice(("", "there", "elsewhere"))
        target = f"{nodelet.name}/{port}/{topic}" if topic else ""
        self.client.set_config(nodelet.name, {port: target})
        return f"{nodelet.name} {port} to '{target}'"

    def toggle_outside(self) -> str:
        outside, self.outside = self.outside, None
        if outside is not None:
            outside.unregister()
            return "silent"
        self.outside = rospy.Publisher("/outside", Header, queue_size=10)
        return "published"

    def _publish_outside(self, event: Any) -> None:
        outside = self.outside
        if outside is not None:
            with contextlib.suppress(rospy.ROSException):  # it was withdrawn just now
                outside.publish(signatures.sign(Header(), "/outside", 0, ["Raw(left)"]))

    def kill_child(self) -> str:
        if self.choice.random() < 0.5:
            return self.wait()
        self.manager.kill_child()
        return "kill -9"

    def kill_manager(self) -> str:
        if self.choice.random() < 0.5:
            return self.wait()
        self.manager.kill()
        self.manager.start()
        return "kill -9"

    def wait(self) -> str:
        seconds = self.choice.uniform(0.0, 1.5)
        time.sleep(seconds)
        return f"{seconds:.1f} s"

    # Invariants

    def check(self) -> None:
        """Check that no wrong message arrived, and that pending claims deliver nothing."""
        for each in self.manager.claims():
            if each.topic and each.claim_id not in self.readers:
                self.readers[each.claim_id] = Reader(each.topic, each.tag)
        wrong = [text for reader in self.readers.values() for text in reader.wrong]
        if self.report.exists():
            wrong += self.report.read_text().splitlines()
        assert not wrong, self._account(wrong)
        delivering: list[str] = []

        def is_silent() -> bool:
            before = self._waiting()
            if before:
                time.sleep(0.2)
            after = self._waiting()
            delivering[:] = [
                key for key, count in after.items() if before.get(key, count) != count
            ]
            self.checked += len(before)
            return not delivering

        # Earlier messages may still arrive.
        what = "claims that are PENDING deliver nothing"
        eventually(is_silent, 2.0, what, lambda: self._account(delivering))

    def _waiting(self) -> dict[str, int]:
        """The numbers of messages that clients of pending claims have received."""
        return {
            each.claim_id: len(self.readers[each.claim_id])
            for each in self.manager.claims()
            if each.state is ClaimState.PENDING and each.claim_id in self.readers
        }

    def make_whole(self) -> None:
        """Restore all parts: each claim comes back and flows."""
        self.add(*self.library)
        counts = {key: len(reader) for key, reader in self.readers.items()}
        lagging: list[str] = []

        def all_flow() -> bool:
            self.speak()
            states = {each.claim_id: each for each in self.client.list_streams()}
            lagging[:] = [
                f"{claim_id}: {states[claim_id]}"
                for claim_id, reader in self.readers.items()
                if states[claim_id].state is not ClaimState.ACTIVE
                or len(reader) <= counts[claim_id] + 5
            ]
            return not lagging

        eventually(all_flow, 60.0, "every claim flows", lambda: self._account(lagging))
        self.check()

    def _account(self, wrong: Sequence[str]) -> str:
        lines = [*wrong[:20], "", *self.trace[-40:], "", self.manager.output[-4000:]]
        return "\n".join(lines)


class SignedTest(ManagerCase):
    """A client reads signatures while random things happen."""

    def start(self) -> tuple[ManagerProcess, Path]:
        """Start a manager; returns it and the file for the nodelets' reports."""
        manager = self.make()
        ontology = Path(manager.state, "ontology.ttl")
        ontology.write_text(ONTOLOGY)
        manager.parameters["ontologies"] = str(ontology)
        manager.start()
        return manager, Path(manager.state, "report.txt")

    def test_one_camera_takes_the_place_of_another(self):
        """A subscriber of a claim's topic is reconfigured before it hears another camera."""
        manager, report = self.start()
        client = manager.client
        cameras = {
            each: Signed(
                f"camera {each}", {}, {"image": f"Raw({each})", "info": f"Clean({each})"}, rate=500
            ).xml(str(report))
            for each in ("left", "right")
        }
        inputs = {"image": "Raw(?x)", "info": "Clean(?x)"}
        rectifier = Signed("rectifier", inputs, {"out": "Found(?x)"}).xml(str(report))
        for text in (*cameras.values(), rectifier):
            client.add_transformation(text)
        client.acquire_stream(StreamRequest("Raw(?x)", client_id="signed"))
        answer = client.acquire_stream(StreamRequest("Found(?x)", client_id="signed"))
        reader = self.enter(Reader(answer.topic, "Found(?x)"))

        def is_seen(name: str) -> None:
            becomes(lambda: reader[-1:], [[f"Found({name})"]], 30.0)

        is_seen("left")
        for lost, other in (("left", "right"), ("right", "left"), ("left", "right")):
            client.remove_transformation(f"camera {lost}")
            for each in client.get_model().nodelets:
                if each.transformation == f"camera {lost}":
                    client.destroy(each.name)
            is_seen(other)
            client.add_transformation(cameras[lost])
        self.assertEqual(reader.wrong, [])
        for found in (report, Path(f"{report}.mixed")):
            self.assertEqual(found.read_text() if found.exists() else "", "")

    def test_random_libraries(self):
        first = rospy.get_param("~first_seed", 1)
        for seed in range(first, first + rospy.get_param("~seeds", 1)):
            with self.subTest(seed=seed):
                try:
                    self.live(random.Random(seed), rospy.get_param("~steps", 15))
                finally:
                    self.doCleanups()

    def live(self, choice: random.Random, steps: int) -> None:
        manager, report = self.start()
        life = RandomLife(manager, choice, random_library(choice), report)
        self.addCleanup(life.close)
        life.add(*life.library)
        for number in range(steps + 3):
            life.step(life.acquire if number < 3 else None)
        life.step(life.remove_all)
        life.make_whole()
        read = sum(len(reader) for reader in life.readers.values())
        print(f"{steps} steps, {read} messages read, {life.checked} looks at waiting")
        self.assertEqual((read > 0, life.checked > 0), (bool(life.readers),) * 2)


if __name__ == "__main__":
    run()
