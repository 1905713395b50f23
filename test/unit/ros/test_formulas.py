# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas on topics: the streams of individuals, and damaged bags."""

from __future__ import annotations

import random
import threading
from types import SimpleNamespace
from typing import Any, Callable, List, Optional

import pytest
import rosbag
import rospy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Bool, Header, String

from dyknow.cli.commands import holds
from dyknow.cli.shell import Shell
from dyknow.errors import Denied, DyKnowError
from dyknow.formulas import parse
from dyknow.model.streams import ClaimState
from dyknow.ros import acquiring
from dyknow.ros.formulas import individuals, sources
from dyknow.ros.formulas.bags import Bag
from dyknow.ros.shell.story import moments

# The streams of a formula's individuals: claims that end, that are of no use, that come late


class Stream:
    """A claim, among those that are open."""

    def __init__(self, open_: List[str], tag: str, datatype: str) -> None:
        self.tag, self.datatype, self.topic, self.detail = tag, datatype, f"/{tag}", ""
        self.state, self.bindings = ClaimState.ACTIVE, {"?c": "a"}
        self._open = open_
        open_.append(tag)

    def release(self):
        self._open.remove(self.tag)

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self.release()


class Surroundings:
    """A manager and topics; a test makes the rounds.

    Attributes:
        names: of the individuals that the manager knows.
        open: tags of claims that were not released.
        acquired: all claims, in the order of their requests.
        subscribed: topics with a subscriber.
        refusal: the individual whose topic is guarded.
        impossible: tags of which no stream can be made.
        requests: all tags that were requested.
        meanwhile: called when a claim was made.
    """

    manager = "/manager"

    def __init__(self):
        self.names = ["a", "b"]
        self.datatypes = {}
        self.open: List[str] = []
        self.acquired: List[Stream] = []
        self.subscribed: List[str] = []
        self.meanwhile: Callable[[], None] = lambda: None
        self.refusal: Optional[str] = None
        self.impossible: List[str] = []
        self.requests: List[str] = []

    def find_bindings(self, tag, datatype=""):
        return [f"?c={name}" for name in self.names]

    def list_streams(self):
        return ()

    def acquire(self, tag, kind="", **unused):
        self.requests.append(tag)
        if tag in self.impossible:
            raise DyKnowError("nothing supplies it")
        stream = Stream(self.open, tag, self.datatypes.get(tag, Bool._type))
        self.acquired.append(stream)
        self.meanwhile()
        return stream

    def subscribe(self, port, name, topic, kind):
        if name == self.refusal:
            raise Denied(topic, "guarded")
        self.subscribed.append(topic)
        return SimpleNamespace(unregister=lambda: self.subscribed.remove(topic))


@pytest.fixture
def around(monkeypatch):
    around = Surroundings()
    monkeypatch.setattr(individuals, "acquire", around.acquire)
    idle = SimpleNamespace(start=lambda: None, close=lambda: None)
    monkeypatch.setattr(individuals, "PeriodicWorker", lambda *unused: idle)
    return around


@pytest.fixture
def told(monkeypatch):
    lines: List[str] = []
    monkeypatch.setattr(rospy, "logwarn", lambda text, *args: lines.append(text % args))
    return lines


@pytest.fixture
def now(monkeypatch):
    """The steady time, moved by the test."""
    now = [0.0]
    monkeypatch.setattr(individuals.time, "monotonic", lambda: now[0])
    return now


def streams(around):
    return individuals.IndividualStreams(around, {"f": "Flag(?c)"}, {}, around.subscribe)


@pytest.mark.parametrize("state", [ClaimState.RELEASED, ClaimState.EXPIRED])
def test_an_individual_whose_claim_has_ended_is_acquired_again(around, state):
    found = streams(around)
    found._look()
    first = around.acquired[0]
    first.state = state
    found._look()
    assert [each.tag for each in around.acquired] == ["Flag(a)", "Flag(b)", "Flag(a)"]
    assert found.present() == {"?c": ["a", "b"]}
    assert sorted(around.subscribed) == ["/Flag(a)", "/Flag(b)"]


def test_an_individual_whose_claim_has_ended_and_cannot_be_made_again_is_gone(around, told, now):
    found = streams(around)
    found._look()
    around.acquired[0].state = ClaimState.EXPIRED
    around.impossible = ["Flag(a)"]
    around.requests.clear()
    for now[0] in range(100):
        found._look()
        assert found.present() == {"?c": ["b"]}
    assert told == ["the individual a has no stream Flag(a): nothing supplies it"]
    assert around.requests.count("Flag(a)") < 10  # each may have spawned nodelets


def test_a_stream_of_no_use_is_released_and_the_next_one_acquired(around, told, now):
    around.datatypes["Flag(a)"] = "nobody_msgs/Foo"
    found = streams(around)
    for now[0] in range(100):
        found._look()
    assert found.present() == {"?c": ["b"]}
    assert around.open == ["Flag(b)"]
    assert len(told) == 1
    assert "individual a has no stream Flag(a): the message type nobody_msgs/Foo" in told[0]
    assert len(around.acquired) < 10  # each may have spawned nodelets
    around.datatypes.clear()
    now[0] += 100.0
    found._look()
    assert found.present() == {"?c": ["a", "b"]}


def test_an_individual_is_present_while_it_has_a_stream(around, told):
    """Its claim stays meanwhile: the manager hears the verdicts that claims need."""
    around.meanwhile = lambda: vars(around.acquired[-1]).update(
        topic="", state=ClaimState.PENDING, detail="it is FALSE"
    )
    found = streams(around)
    found._look()
    found._look()
    assert found.present() == {"?c": []}
    assert around.subscribed == []
    first, _ = around.acquired
    first.topic = "/Flag(a)"
    for state in (ClaimState.ACTIVE, ClaimState.FAILED, ClaimState.DEGRADED):
        first.state = state
        found._look()
        assert found.present() == {"?c": ["a"] if state is not ClaimState.FAILED else []}
    assert around.subscribed == ["/Flag(a)"]
    assert around.requests == ["Flag(a)", "Flag(b)"]
    assert told == [f"the individual {c} has no stream Flag({c}): it is FALSE" for c in "ab"]
    found.close()
    assert around.open == around.subscribed == []


def test_a_subscriber_that_is_refused_leaves_no_claim(around, told):
    around.refusal = "a"
    found = streams(around)
    found._look()
    assert around.open == ["Flag(b)"]
    assert len(told) == 1


def test_holds_keeps_messages_until_their_individual_is_present(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(sources, "_PATIENCE", 0.01)
    monkeypatch.setattr(rospy.core, "is_initialized", lambda: True)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(now[0]))
    live = sources.LiveTopics()
    live._note("f", "a", Bool(True))

    def present():
        now[0] += 1.0
        return {"?c": ["a"]} if now[0] > 2.0 else None

    verdicts = live.verdicts(parse("every ?c (f)").monitor(), present, lambda: False)
    assert next(verdicts).value == 1


def test_holds_keeps_messages_until_ros_time_begins(monkeypatch):
    times = iter([0, 0, 100, 103])
    monkeypatch.setattr(sources, "_PATIENCE", 0.01)
    monkeypatch.setattr(rospy.core, "is_initialized", lambda: True)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(next(times)))
    live = sources.LiveTopics()
    live._note("f", "", PointStamped(header=Header(stamp=rospy.Time(100))))
    verdicts = live.verdicts(parse("present(f)").monitor(1.0), dict, lambda: False)
    assert [next(verdicts).value for _ in range(3)] == [1, 1, 1]


def test_holds_takes_messages_of_several_threads_in_the_order_of_their_times(monkeypatch):
    """A time before the last one, by more than a period, would begin a new sequence."""
    monkeypatch.setattr(rospy.core, "is_initialized", lambda: True)
    live = sources.LiveTopics()
    second = threading.Thread(target=live._note, args=("f", "", Bool(True)))

    def now():
        if threading.current_thread() is second:
            return rospy.Time(2)
        second.start()
        second.join(0.1)  # it does not end before this one
        return rospy.Time(1)

    monkeypatch.setattr(rospy.Time, "now", now)
    live._note("f", "", Bool(True))
    second.join()
    assert [live._received.get().when.secs for _ in range(2)] == [1, 2]


def test_what_is_acquired_after_the_end_is_released_at_once(around):
    found = streams(around)
    around.meanwhile = found.close
    found._look()
    assert around.open == []
    assert around.subscribed == []
    assert [each.tag for each in around.acquired] == ["Flag(a)"]


@pytest.mark.parametrize("topics", [{}, {"f": "f"}])
def test_holds_hears_topics_of_the_namespace_of_the_manager(topics):
    client: Any = SimpleNamespace(namespace="/robot1/", datatypes=dict)
    formula = parse("f")
    shell = Shell(lambda: client)
    verdicts = holds._live(shell, formula, lambda datatypes: formula.monitor(), topics, {}, 0.0)
    with pytest.raises(DyKnowError, match="the topic /robot1/f of the port 'f' is not published"):
        next(verdicts)


def test_holds_forgets_the_messages_of_another_individual(around, monkeypatch):
    """As the nodelet does: the stream of its claim stays, on the same topic."""
    forgotten: List[str] = []

    class Topics:
        subscribe = around.subscribe

        def verdicts(self, monitor, present, is_over):
            for bound in ("a", "a", "b", "b"):
                around.acquired[1].bindings = {"?c": bound}
                is_over()
                yield list(forgotten)

    monkeypatch.setattr(acquiring, "acquire", around.acquire)
    monkeypatch.setattr(sources, "LiveTopics", Topics)
    shell: Any = SimpleNamespace(client=around, resolve=str)
    monitor: Any = SimpleNamespace(forget=forgotten.extend)
    tags = {"f": "Flag(a)", "g": "Flag(?c)"}
    verdicts: Any = holds._live(shell, parse("f or g"), lambda types: monitor, {}, tags, None)
    assert [*verdicts] == [[], [], ["g"], ["g"]]


def test_holds_ends_with_a_stream_that_has_ended(around, monkeypatch):
    class Topics:
        subscribe = around.subscribe

        def verdicts(self, monitor, present, is_over):
            assert not is_over()
            around.acquired[0].detail = "no such stream"
            around.acquired[0].state = ClaimState.EXPIRED
            is_over()
            yield

    monkeypatch.setattr(acquiring, "acquire", around.acquire)
    monkeypatch.setattr(sources, "LiveTopics", Topics)
    shell: Any = SimpleNamespace(client=around, resolve=str)
    formula = parse("f")
    tags = {"f": "Flag(a)"}
    verdicts = holds._live(shell, formula, lambda datatypes: formula.monitor(), {}, tags, None)
    with pytest.raises(DyKnowError, match=r"the stream Flag\(a\) has ended: no such stream"):
        next(verdicts)
    assert around.open == []


# Damaged bags, and files that are not bags: one error for each, whatever rosbag raises


FORMULA = parse('a.data == "x"')


def read(path):
    """Read a bag as ``why`` and as ``holds`` do; returns the errors."""
    errors = []
    for reading in (
        lambda: moments(path),
        lambda: list(Bag(path).verdicts(FORMULA.monitor(), {"a": "/a"}, lambda seconds: None)),
    ):
        try:
            reading()
        except DyKnowError as error:
            errors.append(str(error))
    return errors


@pytest.mark.parametrize("seed", range(30))
def test_a_damaged_bag_is_read_or_refused(tmp_path, seed):
    chance, path = random.Random(seed), str(tmp_path / "run.bag")
    with rosbag.Bag(path, "w") as bag:
        for number in range(20):
            bag.write("/a", String(str(number)), rospy.Time(1 + number))
    with open(path, "r+b") as file:
        size = file.seek(0, 2)
        if seed % 3 == 0:
            file.truncate(chance.randrange(size))
        for _ in range(3):
            file.seek(chance.randrange(size))
            file.write(bytes([chance.randrange(256)]))
    assert all(path in error for error in read(path))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x89PNG\r\n", "is damaged, or is no bag (UnicodeDecodeError"),
        (b"", "cannot be read"),
        (b"text\n", "cannot be read"),
        (None, "cannot be read: No such file"),
    ],
)
def test_a_file_that_is_no_bag_is_refused(tmp_path, content, said):
    path = tmp_path / "run.bag"
    if content is not None:
        path.write_bytes(content)
    errors = read(str(path))
    assert len(errors) == 2 and all(said in error for error in errors)


def test_a_bag_whose_recorder_was_killed_says_how_it_gets_an_index(tmp_path):
    path = tmp_path / "run.bag"
    with rosbag.Bag(str(path), "w") as bag:
        bag.write("/a", String("x"), rospy.Time(1))
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"op=\x07")])  # without its index
    said = f"bag '{path}' cannot be read: it has no index; 'rosbag reindex {path}' makes one"
    assert read(str(path)) == [said, said]


def test_a_bag_without_topics_says_so(tmp_path):
    path = str(tmp_path / "run.bag")
    rosbag.Bag(path, "w").close()
    with pytest.raises(DyKnowError, match="no topic '/a' for the port 'a'; it has none"):
        Bag(path).topic("a", {})
