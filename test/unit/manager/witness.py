# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Watches from outside the messages that each in-port receives, and judges them by tags alone.

Independent of the manager's code: it reads and compares terms in its own way, reads the real ports
of the fake host, and checks after every single change.
"""

from __future__ import annotations

import itertools
import re
from typing import Callable, Dict, FrozenSet, Iterable, Iterator, List, Mapping, Set, Tuple

from dyknow.manager.claim import Claim
from dyknow.model.streams import ClaimState
from dyknow.simulated.host import FakeHost

Wrong = Tuple[str, str, str, str]
"""Who receives, at which port, on which topic, from whom."""
Tags = Tuple[str, ...]
Sources = Dict[str, List[Tuple[str, Tags]]]
"""For each topic who sends there, and what it signs that with."""
SILENT = ("sends nothing",)
"""Instead of tags: what it sends depends on what it receives, and it receives nothing."""
ORDINARY = "ordinary nodes"


class Concepts:
    """A small ontology: for each name the class above it."""

    def __init__(self, above: Mapping[str, str]) -> None:
        self._above = above

    def canonical(self, name: str) -> str:
        return name

    def written(self, name: str) -> str:
        return name

    def is_class(self, name: str) -> bool:
        return name in self._above.values()

    def names_above(self, name: str) -> FrozenSet[str]:
        found = {name}
        while name in self._above:
            name = self._above[name]
            found.add(name)
        return frozenset(found)

    def individuals(self, concept: str) -> Tuple[str, ...]:
        return tuple(sorted(name for name, above in self._above.items() if above == concept))

    def unlabelled(self, concept: str) -> Tuple[str, ...]:
        return ()


def satisfies(
    supplied: str, demanded: str, concepts: Concepts, names: Mapping[str, str] = {}
) -> bool:
    """Whether a stream of one tag is one of another tag, where variables stand for names."""
    have, want = re.split(r"[(),]\s*", supplied), re.split(r"[(),]\s*", demanded)
    if "?" in supplied or len(have) != len(want):
        return False
    stands_for = dict(names)
    for one, other in zip(have, want):
        variable, _, kind = other.partition(": ")
        if variable[:1] == "?":
            if stands_for.setdefault(variable, one) != one:
                return False
            if kind and kind not in concepts.names_above(one):
                return False
        elif other not in concepts.names_above(one):
            return False
    return True


def variables_in(tags: Iterable[str]) -> Set[str]:
    return {variable for tag in tags for variable in re.findall(r"\?\w+", tag)}


class Witness:
    """Finds in-ports that receive streams that they do not demand.

    Attributes:
        signed: for each nodelet type its ports' tags, with which its messages are signed.
        described: tags of topics of ordinary nodes, by the label that says so.
        by_hand: nodelets made by hand.
        given: returns the names that were given for the variables of a nodelet.
        wrong: the present violations.
        confused: nodelets that have received messages of several individuals at ports that share
            a variable, and were not connected elsewhere in between; not by people's connections.
        guilt: violations by a change that the manager made, with its last call.
    """

    def __init__(self, host: FakeHost, concepts: Concepts) -> None:
        self.host = host
        self.concepts = concepts
        self.signed: Dict[str, Dict[str, Tags]] = {}
        self.described: Dict[str, Tuple[str, Tags]] = {}
        self.by_hand: Set[str] = set()
        self.given: Callable[[str], Mapping[str, str]] = lambda name: {}
        self.claims: Callable[[], List[Claim]] = list
        self.wrong: Set[Wrong] = set()
        self.confused: Set[str] = set()
        #: For each nodelet its state, and the tags received since; whether people wanted them.
        self._heard: Dict[str, Tuple[Tuple[int, int], Dict[Tuple[Tags, Tags], bool]]] = {}
        self._willed: Set[Tuple[str, str, str]] = set()  # where people want a misfit
        self.guilt: List[Tuple[Wrong, Tuple[str, str]]] = []
        host.on_change = self._watch

    def excuse(self) -> None:
        """Do not blame the manager for the present violations."""
        self.wrong = self.look(hidden=True)
        self.confused = self._listen()
        self._willed |= {each[:3] for each in self.look() if each[0] in self.by_hand}

    def _watch(self) -> None:
        for each in sorted(self.look() - self.wrong):
            if not self._is_will(each):
                self.guilt.append((each, self.host.calls[-1]))
        self.wrong = self.look(hidden=True)
        confused = self._listen()
        for name in sorted(confused - self.confused):
            self.guilt.append(((name, "", "", "another individual"), self.host.calls[-1]))
        self.confused = confused

    def _listen(self) -> Set[str]:
        """Note each nodelet's received tags; return those whose variables stand for no name.

        A nodelet forgets these tags when it is connected elsewhere, and when it is loaded.
        One that people confused comes back so.
        """
        sources, before = self._sources(), self._heard
        self._heard = {}
        for name, port, direction, topic in self._ports():
            nodelet = self.host.nodelet(name)
            state = id(nodelet), nodelet.reconfigurations
            asked = self._signature(name).get(port, ())
            known = before.get(name, (state, {}))
            heard = self._heard.setdefault(name, known if known[0] == state else (state, {}))[1]
            if direction == "in" and variables_in(asked):
                for source, tags in sources.get(topic, ()):
                    if tags != SILENT and self._fits_alone(asked, tags):
                        is_will = self._is_will((name, port, topic, source))
                        heard[asked, tags] = is_will or heard.get((asked, tags), False)
        return {
            name
            for name, (_, heard) in self._heard.items()
            if not self._read(self.given(name), heard)
            and self._read(self.given(name), [each for each, is_will in heard.items() if is_will])
        }

    def _fits_alone(self, asked: Tags, tags: Tags) -> bool:
        return bool(self._read({}, [(asked, tags)]))

    def _read(
        self, given: Mapping[str, str], receives: Iterable[Tuple[Tags, Tags]]
    ) -> List[Dict[str, str]]:
        """Return the names for variables that all received tags allow, trying all names."""
        receives = list(receives)
        unknown = variables_in(tag for asked, _ in receives for tag in asked) - given.keys()
        return [
            {**given, **names}
            for names in self._guesses(unknown, [tags for _, tags in receives])
            if all(self._serves(tags, asked, {**given, **names}) for asked, tags in receives)
        ]

    def _is_will(self, wrong: Wrong) -> bool:
        """Whether people connected the two; nodelets that died come back with such connections."""
        receiver, port, topic, sender = wrong
        if receiver not in self.by_hand:
            return False
        if sender.partition(".")[0] in (*self.by_hand, ORDINARY):
            return True
        return (receiver, port, topic) in self._willed

    def look(self, hidden: bool = False) -> Set[Wrong]:
        """Compare all receivers' messages with their demands.

        Args:
            hidden: also count ordinary nodes that are invisible beside nodelets: they were
                heard before, when the nodelets leave.
        """
        sources = self._sources(hidden)
        wrong = set()
        for name, port, direction, topic in self._ports():
            asked = self._signature(name).get(port, ())
            if direction == "in" and asked:
                for source, tags in sources.get(topic, ()):
                    if not self._fits(name, port, tags, sources):
                        wrong.add((name, port, topic, source))
        for claim in self.claims():
            if claim.topic and not claim.state.ended:
                for source, tags in sources.get(claim.topic, ()):
                    if source != ORDINARY and not self._serves(tags, (claim.request.tag,)):
                        wrong.add(("client", claim.request.tag, claim.topic, source))
        return wrong

    def lasting(self) -> Set[Wrong]:
        """Violations whose ends the manager could part, but for nodelets made by hand."""
        needed = {
            (name, port, topic)
            for claim in self.claims()
            for name, topics in claim.wiring.items()
            for port, topic in topics.items()
        }
        fixed = {*self.host.slow, *filter(self._is_fixed, self.host.running)}
        return {
            (receiver, port, topic, sender)
            for receiver, port, topic, sender in self.look()
            if receiver not in self.by_hand
            if not (receiver in {"client", *fixed} and _publisher(sender) in {ORDINARY, *fixed})
            # Nor is a sender cut off for a receiver that is not to be there, but cannot be moved.
            if not (
                receiver in self.host.slow
                and _publisher(sender) in self.by_hand
                and (receiver, port, topic) not in needed
            )
        }

    def _is_fixed(self, name: str) -> bool:
        """Whether a nodelet is in a stock C++ manager, where no port can be moved."""
        return any(
            name in process.nodelets and not process.state.rewirable
            for process in self.host.processes.values()
        )

    def fed_while_pending(self) -> List[str]:
        """Topics of claims that wait, on which something that was made for claims publishes."""
        sources = self._sources()
        return [
            f"{source} publishes for {claim.request.tag}, which is pending"
            for claim in self.claims()
            if claim.state is ClaimState.PENDING and claim.topic
            for source, _ in sources.get(claim.topic, ())
            if source != ORDINARY and _publisher(source) not in {*self.by_hand, *self.host.slow}
        ]

    def bound(self) -> List[Tuple[str, str]]:
        """Outputs of nodelets made for claims that name received individuals: topic and tag."""
        return sorted(
            {
                (topic, tag)
                for topic, sources in self._sources().items()
                for source, tags in sources
                for name, _, port in [source.partition(".")]
                if " through " not in source and source != ORDINARY and name not in self.by_hand
                if variables_in(self._signature(name).get(port, ())) and tags != SILENT
                for tag in tags
            }
        )

    def _serves(self, tags: Tags, asked: Tags, names: Mapping[str, str] = {}) -> bool:
        return tags == SILENT or all(
            any(satisfies(each, tag, self.concepts, names) for each in tags) for tag in asked
        )

    def _fits(self, name: str, port: str, tags: Tags, sources: Sources) -> bool:
        """Whether a nodelet may receive this at a port, beside its inputs at the other ports."""
        if tags == SILENT:
            return True
        asked = self._signature(name)[port]
        others = self._readings(name, sources, but=port) or [dict(self.given(name))]
        return any(
            self._serves(tags, asked, {**names, **more})
            for names in others
            for more in self._guesses(variables_in(asked) - names.keys(), [tags])
        )

    def _readings(self, name: str, sources: Sources, but: str = "") -> List[Dict[str, str]]:
        """Return the names for variables that the inputs of a nodelet allow, trying all names."""
        receives = [
            (self._signature(name)[port], tags)
            for other, port, direction, topic in self._ports()
            if (other, direction) == (name, "in") and port != but and self._signature(name)[port]
            for _, tags in sources.get(topic, ())
            if tags != SILENT
        ]
        return self._read(self.given(name), receives)

    def _guesses(self, variables: Set[str], supplied: Iterable[Tags]) -> Iterator[Dict[str, str]]:
        names = {
            name
            for tags in supplied
            for tag in tags
            for name in re.split(r"[(),]\s*", tag)[1:]
            if name
        }
        for choice in itertools.product(sorted(names), repeat=len(variables)):
            yield dict(zip(sorted(variables), choice))

    def _sources(self, hidden: bool = False) -> Sources:
        """The signers and tags on each topic, under the names that variables stand for."""
        signed: Dict[Tuple[str, str], Tags] = {}
        for _ in range(len(self._ports()) + 1):
            sources = self._sources_if(hidden, signed)
            now: Dict[Tuple[str, str], Tags] = {}
            for name, port, direction, topic in self._ports():
                tags = self._signature(name).get(port, ())
                if direction == "out" and topic and variables_in(tags):
                    now[name, port] = self._signed(tags, self._readings(name, sources))
            if now == signed:
                break
            signed = now
        return sources

    @staticmethod
    def _signed(tags: Tags, readings: List[Dict[str, str]]) -> Tags:
        if any(variables_in(tags) - names.keys() for names in readings):
            return SILENT
        written = []
        for names in readings:
            for tag in tags:
                for variable, name in names.items():
                    tag = re.sub(re.escape(variable) + r"\b(: \w+)?", name, tag)
                written.append(tag)
        return tuple(dict.fromkeys(written))

    def _sources_if(self, hidden: bool, signed: Mapping[Tuple[str, str], Tags]) -> Sources:
        """The signers and tags on each topic; relays pass on messages of other signers."""
        found: Dict[str, List[Tuple[str, Tags]]] = {}
        relays: Dict[str, Dict[str, str]] = {}
        for name, port, direction, topic in self._ports():
            if self.host.nodelet(name).request.source == "dyknow/Relay":
                relays.setdefault(name, {})[direction] = topic
            elif direction == "out" and topic:
                tags = self._signature(name).get(port, ())
                if variables_in(tags):
                    tags = signed.get((name, port), SILENT)
                found.setdefault(topic, []).append((f"{name}.{port}", tags))
        for topic in self.host.topics:
            texts = [tags for where, tags in self.described.values() if where == topic]
            if hidden or texts or topic not in found:  # else invisible, beside nodelets
                tags = tuple(itertools.chain.from_iterable(texts))
                found.setdefault(topic, []).append((ORDINARY, tags))
        for _ in relays:  # one may feed another
            for name, topics in relays.items():
                if topics["in"] and topics["out"]:
                    there = found.setdefault(topics["out"], [])
                    for source, tags in found.get(topics["in"], ()):
                        passed = (f"{source} through {name}", tags)
                        if name not in source and passed not in there:
                            there.append(passed)
        return found

    def _ports(self) -> List[Tuple[str, str, str, str]]:
        """Every port that can send or receive now: name of the nodelet, port, direction, topic."""
        return [
            (name, port.name, port.direction, port.topic)
            for manager, process in self.host.processes.items()
            if not self.host.is_hung(manager)
            for name, nodelet in process.nodelets.items()
            for port in nodelet.ports.values()
        ]

    def _signature(self, name: str) -> Mapping[str, Tags]:
        return self.signed.get(self.host.nodelet(name).request.source, {})


def _publisher(sender: str) -> str:
    """Name the publisher on the topic itself: the signer, or the last relay on the way."""
    return sender.rpartition(" through ")[2].partition(".")[0]
