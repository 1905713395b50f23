# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Random tests with signed messages: libraries whose sources sign, a client that reads the
signatures, and random steps of users, faults and other programs."""

from __future__ import annotations

import json
import random
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Iterable, Sequence
from xml.sax.saxutils import escape

import rospy
from graph import PACKAGES
from manager_suite import CHILD, ManagerProcess, eventually
from nodelet.srv import NodeletUnload
from roslib.message import get_message_class
from std_msgs.msg import String

from dyknow.errors import DyKnowError
from dyknow.model.streams import ClaimState, StreamRequest

sys.path.append(str(PACKAGES / "dyknow_manager_test" / "src"))
import signatures

HEADER = "std_msgs/Header"


@dataclass(frozen=True)
class SignedPort:
    """A port and the tags that its stream supplies or must satisfy."""

    name: str
    direction: str
    tags: tuple[str, ...]
    datatype: str = HEADER


@dataclass(frozen=True)
class SignedTransformation:
    """A transformation whose nodelets sign."""

    label: str
    ports: tuple[SignedPort, ...]
    cost: int = 1
    topic: str = ""
    rate: int = 20

    def xml(self, kinds: signatures.Kinds, report: str) -> str:
        kind = ' type="topic"' if self.topic else ""
        ports = "".join(
            f'<port type="{port.direction}" datatype="{port.datatype}">{port.name}</port>'
            for port in self.ports
        )
        tags = "".join(
            f'<tag port="{port.name}">{escape(tag)}</tag>'
            for port in self.ports
            for tag in port.tags
        )
        shown = [[port.name, port.direction, port.datatype, port.tags] for port in self.ports]
        params = "" if self.topic else parameters(shown, kinds, report, self.rate)
        source = self.topic or "dyknow_manager_test/Signed"
        return (
            f'<transformation{kind} cost="{self.cost}"><label>{escape(self.label)}</label>'
            f"<source>{source}</source>{params}<ports>{ports}</ports><tags>{tags}</tags>"
            "</transformation>"
        )

    def replaced(self, choice: random.Random) -> SignedTransformation:
        """A transformation with this label whose out-ports keep the functors of their tags."""
        ports = tuple(
            SignedPort(port.name, port.direction, _other(port.tags, choice), port.datatype)
            if port.direction == "out"
            else port
            for port in self.ports
        )
        return SignedTransformation(self.label, ports, choice.randrange(10), self.topic)


def parameters(ports: Any, kinds: signatures.Kinds, report: str, rate: int) -> str:
    values = {"ports": json.dumps(ports), "kinds": json.dumps(kinds), "report": report}
    values["rate"] = str(rate)
    lines = [
        f'<param name="{name}" type="string">{escape(value)}</param>'
        for name, value in values.items()
    ]
    return f"<params>{''.join(lines)}</params>"


def _other(tags: Iterable[str], choice: random.Random) -> tuple[str, ...]:
    functors = [signatures.parse(tag)[0] for tag in tags]
    return tuple(f"{functor}({choice.choice(INDIVIDUALS)})" for functor in functors)


INDIVIDUALS = ("left", "right", "above")
FUNCTORS = ("Raw", "Clean", "Found", "Placed")


@dataclass
class SignedLibrary:
    """Transformations, the subclass relation, and the tags that clients may request."""

    transformations: list[SignedTransformation]
    kinds: dict[str, list[str]]
    ontology: str
    goals: list[str]


def random_library(seed: int) -> SignedLibrary:
    """Layers of random transformations over three individuals; some demand a superclass."""
    choice = random.Random(seed)
    found: list[SignedTransformation] = []
    for individual in INDIVIDUALS:
        ports = (SignedPort("out", "out", (f"Raw({individual})",)),)
        found.append(SignedTransformation(f"source {individual}", ports, choice.randrange(6)))
    outside = (SignedPort("out", "out", ("Raw(left)",)),)
    found.append(SignedTransformation("outside", outside, 0, topic="/outside"))
    for number in range(10):
        layer = choice.randrange(1, len(FUNCTORS))
        inputs = []
        for index in range(choice.choice((1, 1, 2))):
            functor = FUNCTORS[choice.randrange(layer)] if choice.random() < 0.8 else "Stream"
            argument = choice.choice((*INDIVIDUALS, "?x", "?x", "Place"))
            inputs.append(SignedPort(f"in{index}", "in", (f"{functor}({argument})",)))
        bound = ["?x"] if any("?x" in tag for port in inputs for tag in port.tags) else []
        arguments = (*INDIVIDUALS, *bound, *bound, *bound)
        outputs = [
            SignedPort(f"out{index}", "out", (f"{FUNCTORS[layer]}({choice.choice(arguments)})",))
            for index in range(choice.choice((1, 1, 2)))
        ]
        ports = (*inputs, *outputs)
        found.append(SignedTransformation(f"worker {number}", ports, choice.randrange(6)))
    kinds = {functor: ["Stream"] for functor in FUNCTORS}
    kinds.update({individual: ["Place"] for individual in INDIVIDUALS})
    goals = [f"{functor}({each})" for functor in FUNCTORS for each in (*INDIVIDUALS, "?any")]
    return SignedLibrary(found, kinds, _turtle(kinds), goals)


def _turtle(kinds: dict[str, list[str]]) -> str:
    lines = [
        "@prefix : <http://dyknow.example.org/signed#> .",
        "@prefix owl: <http://www.w3.org/2002/07/owl#> .",
        "@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .",
    ]
    for name in ("Stream", "Place"):
        lines.append(f':{name} a owl:Class ; rdfs:label "{name}" .')
    for functor in FUNCTORS:
        lines.append(
            f':{functor} a owl:Class ; rdfs:label "{functor}" ; rdfs:subClassOf :Stream .'
        )
    for individual in INDIVIDUALS:
        lines.append(f':{individual} a :Place ; rdfs:label "{individual}" .')
    return "\n".join(lines)


class Reader:
    """A client's subscriber: records messages whose signature does not meet its request."""

    def __init__(self, topic: str, datatype: str, tag: str, kinds: signatures.Kinds) -> None:
        self.topic, self.tag, self.count = topic, tag, 0
        self.wrong: list[str] = []
        self.last: Sequence[str] = ()
        self._kinds = kinds
        self._subscriber = rospy.Subscriber(topic, get_message_class(datatype), self._read)

    def _read(self, message: Any) -> None:
        self.count += 1
        found = signatures.signature(message)
        self.last = found["tags"]
        if not signatures.all_met(found["tags"], [self.tag], self._kinds):
            self.wrong.append(f"the client of {self.tag} on {self.topic} got {found}")

    def close(self) -> None:
        self._subscriber.unregister()


@dataclass
class RandomLife:
    """Takes random steps, and checks after each of them."""

    manager: ManagerProcess
    library: SignedLibrary
    report: Path
    seed: int
    readers: dict[str, Reader] = field(default_factory=dict)
    trace: list[str] = field(default_factory=list)
    checked: int = 0

    def __post_init__(self) -> None:
        self.choice = random.Random(self.seed)
        self.present = {each.label: each for each in self.library.transformations}
        self.orders = rospy.Publisher("/orders", String, queue_size=100)
        self.outside: dict[str, Any] = {}
        self.timer = rospy.Timer(rospy.Duration(0.05), self._publish_outside)
        self.spawned = 0

    def close(self) -> None:
        self.timer.shutdown()
        self.orders.unregister()
        for publisher, *_ in list(self.outside.values()):
            publisher.unregister()
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
            self.trace[-1] += f" {kind() or ''}"
        except DyKnowError as error:
            self.trace[-1] += f" refused: {str(error)[:300]}"
        self.check()

    def add_all(self) -> None:
        for each in self.present.values():
            self._add(each)

    def _add(self, transformation: SignedTransformation) -> None:
        xml = transformation.xml(self.library.kinds, str(self.report))
        self.manager.client.add_transformation(xml)

    def acquire(self) -> str:
        if len(self._living()) >= 5:
            return self.release()
        tag = self.choice.choice(self.library.goals)
        silence = self.choice.choice((0.0, 1.0))
        request = StreamRequest(tag, client_id="signed", max_silence=silence)
        self.trace[-1] += f" {tag}"
        answer = self.manager.client.acquire_stream(request)
        return f"{answer.claim_id} on {answer.topic}"

    def release(self) -> str:
        living = sorted(each.claim_id for each in self._living())
        if not living:
            return "nothing"
        claim_id = self.choice.choice(living)
        if claim_id in self.readers:  # first: the topic may serve another claim next
            self.readers.pop(claim_id).close()
        self.manager.client.release_stream(claim_id)
        return claim_id

    def remove(self) -> str:
        label = self.choice.choice(sorted(self.present))
        self.manager.client.remove_transformation(label)
        return label

    def add_back(self) -> str:
        label = self.choice.choice(sorted(self.present))
        self._add(self.present[label])
        return label

    def replace(self) -> str:
        label = self.choice.choice(sorted(self.present))
        self._add(self.present[label].replaced(self.choice))
        return label

    def _nodelet(self) -> str:
        names = [each.name for each in self.manager.client.get_model().nodelets]
        return self.choice.choice(sorted(names)) if names else "/nobody"

    def destroy(self) -> str:
        name = self._nodelet()
        self.manager.client.destroy(name)
        return name

    def unload(self) -> str:
        name = self._nodelet()
        try:
            rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)(name)
        except rospy.ServiceException as error:
            return f"{name}: {error}"
        return name

    def _order(self, order: str) -> str:
        name = self._nodelet()
        self.orders.publish(f"{name} {order}")
        return name

    def silence(self) -> str:
        return self._order("silent")

    def speak(self) -> str:
        self.orders.publish("all speak")
        return "all"

    def exit_one(self) -> str:
        return self._order("exit") if self.choice.random() < 0.3 else self.wait()

    def spawn(self) -> str:
        label = self.choice.choice(sorted(self.present))
        if self.present[label].topic:
            return "nothing"
        self.spawned += 1
        name = f"/hand_{self.spawned}"
        outs = [port.name for port in self.present[label].ports if port.direction == "out"]
        self.manager.client.spawn(label, name, {outs[0]: f"{name}/here"})
        return f"{label} as {name}"

    def rewire(self) -> str:
        """Move an out-port of a nodelet spawned by hand to a topic of its own."""
        model = self.manager.client.get_model()
        mine = [each for each in model.nodelets if each.name.startswith("/hand_")]
        if not mine:
            return "nothing"
        nodelet = self.choice.choice(mine)
        ports = [port.name for port in nodelet.ports if port.direction == "out"]
        port, topic = self.choice.choice(ports), self.choice.choice(("", "there", "elsewhere"))
        target = f"{nodelet.name}/{port}/{topic}" if topic else ""
        self.manager.client.set_config(nodelet.name, {port: target})
        return f"{nodelet.name} {port} to '{target}'"

    def toggle_outside(self) -> str:
        topics = [each for each in self.present.values() if each.topic]
        if not topics:
            return "nothing"
        chosen = self.choice.choice(topics)
        if chosen.topic in self.outside:
            self.outside.pop(chosen.topic)[0].unregister()
            return f"{chosen.topic} is silent"
        port = chosen.ports[0]
        message_class = get_message_class(port.datatype)
        publisher = rospy.Publisher(chosen.topic, message_class, queue_size=10)
        self.outside[chosen.topic] = (publisher, message_class, port.tags)
        return f"{chosen.topic} is published"

    def _publish_outside(self, event: Any) -> None:
        for topic, (publisher, message_class, tags) in list(self.outside.items()):
            message = signatures.sign(message_class(), topic, 0, tags)
            try:
                publisher.publish(message)
            except rospy.ROSException:
                continue  # it was withdrawn just now

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

    def _living(self) -> list[Any]:
        claims = self.manager.client.list_streams()
        return [each for each in claims if not each.state.ended]

    def _read_what_is_made_later(self) -> None:
        for each in self._living():
            if each.topic and each.claim_id not in self.readers:
                reader = Reader(each.topic, each.datatype, each.tag, self.library.kinds)
                self.readers[each.claim_id] = reader

    def check(self) -> None:
        """Check that no wrong message arrived, and that pending claims deliver nothing."""
        self._read_what_is_made_later()
        wrong = [text for reader in self.readers.values() for text in reader.wrong]
        if self.report.exists():
            wrong += self.report.read_text().splitlines()
        assert not wrong, self._account(wrong)
        if self._waiting():
            delivering: list[str] = []

            def is_silent() -> bool:
                before = {claim_id: self.readers[claim_id].count for claim_id in self._waiting()}
                time.sleep(0.2)
                waiting = self._waiting() & set(before)
                delivering[:] = [c for c in waiting if self.readers[c].count != before[c]]
                self.checked += len(waiting)
                return not delivering

            # Earlier messages may still arrive.
            what = "claims that are PENDING deliver nothing"
            eventually(is_silent, 2.0, what, lambda: self._account(delivering))

    def _waiting(self) -> set[str]:
        return {
            each.claim_id
            for each in self._living()
            if each.state is ClaimState.PENDING and each.claim_id in self.readers
        }

    def make_whole(self) -> None:
        """Restore all parts: each claim comes back and flows."""
        self.add_all()
        self.orders.publish("all speak")
        counts: dict[str, int] = {}
        lagging: list[str] = []

        def all_flow() -> bool:
            self.orders.publish("all speak")
            states = {each.claim_id: each for each in self.manager.client.list_streams()}
            lagging[:] = [
                f"{claim_id}: {states[claim_id].state.name} {states[claim_id].detail}"
                for claim_id, reader in self.readers.items()
                if states[claim_id].state is not ClaimState.ACTIVE
                or reader.count <= counts.setdefault(claim_id, reader.count) + 5
            ]
            return not lagging

        eventually(all_flow, 60.0, "every claim flows", lambda: self._account(lagging))
        self.check()

    def _account(self, wrong: Sequence[str]) -> str:
        return "\n".join(
            [
                f"seed {self.seed}",
                *wrong[:20],
                "",
                *self.trace[-40:],
                "",
                self.manager.output[-4000:],
            ]
        )
