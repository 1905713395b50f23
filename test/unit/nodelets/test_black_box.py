# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The black box: the messages that it keeps, when it writes a bag, and the bag's content."""

from __future__ import annotations

import errno
import io
import threading
from pathlib import Path

import pytest
import rosbag
import rospy
from dyknow_msgs.msg import Model, Nodelet, StreamEvent, StreamStatus, Verdict
from geometry_msgs.msg import PoseStamped, TransformStamped
from hypothesis import example, given
from hypothesis import strategies as st
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Int32, String
from std_srvs.srv import TriggerRequest
from tf2_msgs.msg import TFMessage

from dyknow.errors import LoadFailed
from dyknow.nodelets import black_box
from dyknow.nodelets.black_box import CAUSE, BlackBox
from dyknow.nodelets.recording import OVERHEAD, KeptMessage, Recording, memory_of, write_bag

EVENTS, MODEL = "/dyknow_manager/stream_events", "/dyknow_manager/model"
SECONDS, MOST = 10.0, 50_000


@given(
    st.lists(
        st.tuples(st.sampled_from("abc"), st.floats(0.0, 4.0), st.integers(0, 20_000)), max_size=60
    )
)
@example([(topic, 4.0, 1) for topic in "ababba"])  # a state and old messages go, the state stays
def test_a_recording_has_the_newest_messages_within_its_bounds(steps):
    recording = Recording(SECONDS, MOST)
    now, sent = 0.0, []
    for topic, pause, size in steps:
        now += pause
        sent.append(KeptMessage(topic, String("x" * size), now, size + OVERHEAD))
        recording.add(topic, sent[-1].message, now, is_state=topic == "a")
        assert recording.size <= MOST
    recent = [each for each in sent if each.received >= now - SECONDS]
    while sum(each.size for each in recent) > MOST / 2:  # states may take the other half
        recent.pop(0)
    taken = recording.taken()
    count = max(
        n for n in range(len(taken) + 1) if taken[len(taken) - n :] == sent[len(sent) - n :]
    )
    assert count >= len(recent)
    assert all(each.received >= now - SECONDS for each in sent[len(sent) - count :])
    states = [each.message for each in taken[: len(taken) - count]]
    gone = [each.message for each in sent[: len(sent) - count] if each.topic == "a"]
    assert states == (gone[-1:] if count else [])


def test_sizes_are_close_to_those_on_the_wire():
    for message in (
        Image(data=bytes(10_000), encoding="rgb8"),
        JointState(name=["joint"] * 40, position=[0.5] * 100),
        TFMessage([TransformStamped(child_frame_id="x" * 100)] * 30),
    ):
        buffer = io.BytesIO()
        message.serialize(buffer)
        assert buffer.tell() / 2 <= memory_of(message) <= buffer.tell() * 5
        assert memory_of(any_message(message)) == buffer.tell()


def test_latched_topics_of_other_processes_begin_with_their_states():
    recording = Recording(SECONDS, 1e6)
    for number, publisher in enumerate(["/a", "/b", "/c", "/a"]):
        message = Int32(number)
        message._connection_header = {"callerid": publisher, "latching": "01"[publisher != "/c"]}
        recording.add("/map", message, 0.0)
    recording.add("/other", Int32(4), 2 * SECONDS)
    assert [each.message.data for each in recording.taken()] == [1, 3, 4]


def test_time_that_is_set_back_begins_again_with_the_states():
    recording = Recording(SECONDS, 1e6)
    for topic, text in (("model", "older"), ("model", "state"), ("a", "old")):
        recording.add(topic, String(text), 100.0, is_state=topic == "model")
    recording.add("a", String("new"), 1.0)
    assert [each.message.data for each in recording.taken()] == ["state", "new"]


def test_the_states_of_many_publishers_are_bounded_and_leave_room_for_messages():
    recording = Recording(SECONDS, MOST)
    for number in range(100):
        command = String(f"{number:05}" + "x" * 1995)
        command._connection_header = {"callerid": f"/rostopic_{number}", "latching": "1"}
        recording.add("/command", command, 60.0 * number)
        assert sum(each.size for each in recording.taken()) == recording.size <= MOST
    for _ in range(20):
        recording.add("/odom", String("x" * 1000), 6000.0)
    taken = recording.taken()
    assert [int(each.message.data[:5]) for each in taken if each.topic == "/command"] == [
        *range(92, 100)
    ]
    assert [each.topic for each in taken].count("/odom") == 13


def any_message(message):
    """The message as a subscriber of any type receives it."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    found = rospy.AnyMsg()
    found._buff = buffer.getvalue()
    found._connection_header = {
        "type": message._type,
        "md5sum": message._md5sum,
        "message_definition": message._full_text,
    }
    return found


class Box:
    """A black box in the harness, with the topics that a master would list."""

    def __init__(self, harness, folder, **parameters):
        self.harness = harness
        self.folder = folder
        self.box = harness.load(
            BlackBox,
            parameters={"topics": ["/kept/*"], "folder": str(folder), **parameters},
        )

    def send(self, topic, message):
        self.harness.publish(topic, message)
        self.harness.drain()

    def pass_time(self, seconds):
        self.harness.advance(seconds)
        for thread in threading.enumerate():
            if thread.name == "writing a bag":
                thread.join(20.0)

    def bags(self):
        found = []
        for path in sorted(self.folder.glob("*.bag")):
            with rosbag.Bag(str(path)) as bag:
                found.append([(topic, message) for topic, message, _ in bag.read_messages()])
        return found

    def causes(self):
        return [[m.data for topic, m in bag if topic == CAUSE] for bag in self.bags()]


@pytest.fixture
def box(nodelet_harness, tmp_path, monkeypatch):
    types = {"/kept/a": "std_msgs/String", "/v": "dyknow_msgs/Verdict", "/not": "x/Y"}
    monkeypatch.setattr(BlackBox, "published", lambda self: types)
    return lambda **parameters: Box(nodelet_harness, tmp_path, **parameters)


def verdict(value, why=""):
    return Verdict(value=value, why=why)


def test_a_violated_formula_writes_what_was_before_and_after(box):
    box = box()
    box.send("/kept/a", String("before"))
    box.send("/v", verdict(Verdict.TRUE))
    box.pass_time(1.0)
    box.send("/v", verdict(Verdict.FALSE, "speed = 3.1 at 0.5"))
    box.send("/v", verdict(Verdict.FALSE))
    box.pass_time(1.0)
    box.send("/kept/a", String("after"))
    assert box.bags() == []
    box.pass_time(1.5)
    (bag,) = box.bags()
    assert [m.data for topic, m in bag if topic == "/kept/a"] == ["before", "after"]
    assert box.causes() == [["the formula of /v is violated: speed = 3.1 at 0.5"]]


@pytest.mark.parametrize("causes", [[], ["the formula of /v is violated: slow"]])
def test_causes_that_wait_are_written_at_the_end(box, causes):
    box = box()
    box.send("/v", verdict(Verdict.FALSE if causes else Verdict.TRUE, "slow"))
    box.harness.unload(box.box)
    assert box.causes() == ([causes] if causes else [])


def test_a_topic_that_cannot_be_kept_is_skipped(box, nodelet_harness):
    nodelet_harness.publish("/kept/a", Int32(1))  # of another type than the master says
    box = box()
    box.pass_time(3.0)
    (told,) = [each.text for each in nodelet_harness.log if "is not kept" in each.text]
    assert "/kept/a is not kept: topic '/kept/a' carries std_msgs/Int32" in told
    box.send("/v", verdict(Verdict.FALSE))
    box.pass_time(3.0)
    assert len(box.causes()) == 1


def test_a_repair_and_a_lost_nodelet_are_causes(box):
    box = box()
    before = StreamStatus(claim_id="c1", tag="Ball(x)", state=StreamStatus.ACTIVE)
    after = StreamStatus(claim_id="c1", tag="Ball(x)", state=StreamStatus.RECOVERING)
    box.send(EVENTS, StreamEvent(before=before, after=after, reason="/camera died"))
    for state in (Nodelet.RUNNING, Nodelet.LOST, Nodelet.LOST):
        box.box.readable = 0.0
        nodelets = [Nodelet(name="/camera", state=state, detail="its process is gone")]
        box.send(MODEL, Model(nodelets=nodelets))
    box.pass_time(3.0)
    assert box.causes() == [
        [
            "stream Ball(x) of claim c1: /camera died",
            "nodelet /camera is lost: its process is gone",
        ]
    ]
    topics = {topic for topic, _ in box.bags()[0]}
    assert topics == {EVENTS, MODEL, CAUSE}


@pytest.mark.parametrize("state", ["ACTIVE", "DEGRADED", "RECOVERING", "FAILED"])
def test_a_claim_that_loses_its_stream_is_a_cause(box, state):
    box = box()
    after = StreamStatus(claim_id="c1", tag="Ball(x)", state=StreamStatus.PENDING)
    box.send(EVENTS, StreamEvent(after=after, reason="requested; nothing supplies Ball(x)"))
    before = StreamStatus(claim_id="c1", tag="Ball(x)", state=getattr(StreamStatus, state))
    box.send(EVENTS, StreamEvent(before=before, after=after, reason="/camera is gone"))
    box.pass_time(3.0)
    assert box.causes() == [["stream Ball(x) of claim c1: /camera is gone"]]


def test_causes_in_a_row_make_few_bags_and_old_bags_go(box):
    box = box(pause=10.0, bags=2)
    for _ in range(40):
        box.send("/v", verdict(Verdict.FALSE))
        box.send("/v", verdict(Verdict.TRUE))
        box.pass_time(1.0)
    box.pass_time(15.0)
    assert len(box.bags()) == 2


def test_bags_of_another_black_box_stay(box):
    box = box(bags=1)
    for name in ("nodelet_2", "nodelet_arm"):
        (box.folder / f"{name}_2026-11-27-10-00-00.bag").touch()
    for _ in range(2):
        assert box.harness.call("/nodelet/write_bag", TriggerRequest()).success
    names = [path.name for path in box.folder.glob("*.bag")]
    assert len(names) == 3 and len([each for each in names if each.startswith("nodelet_20")]) == 1


def test_a_message_that_cannot_be_serialised_is_left_out(box, monkeypatch):
    box, warned = box(), []
    monkeypatch.setattr(box.box.nh, "logwarn", lambda *words: warned.append(words[0] % words[1:]))
    for message in (String("before"), String(5), String("half \ud800"), String("after")):
        box.send("/kept/a", message)
    box.send("/v", verdict(Verdict.FALSE))
    box.pass_time(3.0)
    (bag,) = box.bags()
    assert [m.data for topic, m in bag if topic == "/kept/a"] == ["before", "after"]
    assert any("2 messages cannot be serialised" in line for line in warned)


def unusual_messages():
    float_stamp, no_header, no_position = PoseStamped(), PoseStamped(), JointState()
    float_stamp.header.stamp = 1700000000.5  # rospy.Time forgotten
    no_header.header = no_position.position = None
    no_definition = any_message(String("a"))
    del no_definition._connection_header["message_definition"]
    return [
        float_stamp,
        no_header,
        no_position,
        JointState(name=[b"x", 3]),
        no_definition,
        rospy.AnyMsg(),
    ]


def test_a_bag_has_messages_of_classes_and_of_any_type_and_none_costs_it(tmp_path):
    path = str(tmp_path / "x.bag")
    messages = [String("before"), *unusual_messages(), any_message(String("after"))]
    kept = [KeptMessage(f"/t{n}", each, float(n), 10) for n, each in enumerate(messages)]
    assert write_bag(path, kept) == len(unusual_messages())
    with rosbag.Bag(path) as bag:
        found = [(topic, m.data, when.to_sec()) for topic, m, when in bag.read_messages()]
    assert found == [("/t0", "before", pytest.approx(0.0, abs=1e-6)), ("/t7", "after", 7.0)]


def test_a_disk_that_is_full_is_an_error(tmp_path, monkeypatch):
    def refuse(*unused, **also_unused):
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(rosbag.Bag, "write", refuse)
    with pytest.raises(OSError, match="no space left"):
        write_bag(str(tmp_path / "x.bag"), [KeptMessage("/t", String("a"), 1.0, 10)])
    assert list(tmp_path.iterdir()) == []


def test_a_clock_that_was_set_back_costs_no_new_bag(box, monkeypatch):
    box = box(bags=3)
    for day in (1, 2, 3):
        (box.folder / f"nodelet_2026-11-0{day}-10-00-00.bag").touch()
    times = iter(["2024-01-01-00-00-09", "2024-01-01-00-00-05"])
    monkeypatch.setattr(black_box.time, "strftime", lambda form: next(times))
    for _ in range(2):
        answer = box.harness.call("/nodelet/write_bag", TriggerRequest())
        assert answer.success
        assert Path(answer.message).exists()
    assert {path.name for path in box.folder.glob("*.bag")} == {
        "nodelet_2026-11-03-10-00-00.bag",
        "nodelet_2024-01-01-00-00-09.bag",
        "nodelet_2024-01-01-00-00-05.bag",
    }


def test_after_simulated_time_was_set_back_a_bag_is_written_within_the_pause(box):
    box = box(pause=10.0)
    box.box.written = box.box.nh.get_time() + 1000.0
    box.send("/v", verdict(Verdict.FALSE))
    box.pass_time(10.5)
    assert len(box.bags()) == 1


def test_a_request_writes_at_once(box):
    box = box()
    box.send("/kept/a", String("x"))
    answer = box.harness.call("/nodelet/write_bag", TriggerRequest())
    assert answer.success
    assert answer.message.startswith(str(box.folder))
    assert [[topic for topic, _ in bag] for bag in box.bags()] == [["/kept/a"]]


def test_messages_are_kept_while_a_bag_is_written_and_while_the_master_is_silent(box, monkeypatch):
    box, kept = box(), []

    def wait():
        box.harness.publish("/kept/a", String("x"))
        box.harness._executor.drain()  # as another thread would
        kept.append(len(box.box.recording.taken()))

    monkeypatch.setattr(BlackBox, "published", lambda self: wait() or {})
    box.pass_time(1.0)
    monkeypatch.setattr(black_box, "write_bag", lambda *unused: wait() or 0)
    assert box.harness.call("/nodelet/write_bag", TriggerRequest()).success
    assert kept == [1, 2]


def test_a_folder_that_cannot_be_written_is_an_answer(box, tmp_path):
    box = box()
    box.box.folder = str(tmp_path / "file" / "folder")
    (tmp_path / "file").write_text("")
    answer = box.harness.call("/nodelet/write_bag", TriggerRequest())
    assert not answer.success
    assert "file" in answer.message


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("topics", "/a", "a list of topics or patterns, such as"),
        ("topics", [1], "a list of topics or patterns, such as"),
        ("memory", 0, "a number above 0, in MB"),
        ("seconds", "long", "a number above 0, in s"),
    ],
)
def test_a_bad_parameter_is_an_error_at_the_load(nodelet_harness, name, value, expected):
    with pytest.raises(LoadFailed, match=expected):
        nodelet_harness.load(BlackBox, parameters={name: value})
