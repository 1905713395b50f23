# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`record` and `why`, with the bags of a black box."""

from __future__ import annotations

import pytest
import rosbag
from dyknow_msgs.msg import Model, Nodelet, StreamEvent, StreamStatus, Verdict
from genpy import Time
from genpy.dynamic import generate_dynamic
from std_msgs.msg import Header
from unit.cli.fake_client import Outcome, run

from dyknow.errors import NodeletUnreachable, Refused
from dyknow.nodelets.recording import KeptMessage, write_bag
from dyknow.ros.shell.shell_client import ShellClient

ACTIVE, RECOVERING = StreamStatus.ACTIVE, StreamStatus.RECOVERING


def event(claim, before, after, reason, *nodelets):
    def status(state):
        return StreamStatus(claim_id=claim, tag="Ball(x)", state=state, nodelets=list(nodelets))

    return StreamEvent(before=status(before), after=status(after), reason=reason)


def model(**states):
    details = {Nodelet.LOST: "its process is gone"}
    return Model(
        nodelets=[
            Nodelet(name=f"/{name}", state=state, detail=details.get(state, ""))
            for name, state in states.items()
        ]
    )


@pytest.fixture
def bag(tmp_path):
    happened = [
        ("/m", model(camera=Nodelet.RUNNING, other=Nodelet.RUNNING)),
        ("/close", Verdict(value=Verdict.TRUE, why="distance = 0.9")),
        ("/close", Verdict(value=Verdict.TRUE)),
        ("/m", model(camera=Nodelet.LOST, other=Nodelet.LOST)),
        ("/e", event("c1", ACTIVE, RECOVERING, "/camera died", "/camera")),
        ("/e", event("c2", ACTIVE, RECOVERING, "/other died", "/other")),
        ("/close", Verdict(value=Verdict.FALSE, why="distance = 3.5")),
        ("/m", model(other=Nodelet.RUNNING)),
        ("/e", event("c1", RECOVERING, ACTIVE, "mended: ceiling instead", "/ceiling")),
    ]
    path = str(tmp_path / "box.bag")
    write_bag(path, [KeptMessage(topic, m, 10.5 + n, 0) for n, (topic, m) in enumerate(happened)])
    return path


def test_why_tells_the_story_of_a_claim(client, bag):
    client.boxes["/box"] = bag
    told = run(client, "why c1")
    assert told.code == 0
    assert [line.split(maxsplit=1)[1] for line in told.lines] == [
        "/close   verdict true: distance = 0.9",
        "/camera  is lost: its process is gone",
        "c1       Ball(x) active → recovering: /camera died",
        "/close   verdict false: distance = 3.5",
        "/camera  is gone",
        "c1       Ball(x) recovering → active: mended: ceiling instead",
        bag,
    ]
    found = run(client, f"why c2 --bag {bag} --json").json
    assert {each["subject"] for each in found["moments"]} == {"/close", "/other", "c2"}
    assert found["moments"][0]["when"] == pytest.approx(11.5)
    subjects = {each["subject"] for each in run(client, "why --json").json["moments"]}
    assert subjects == {"/close", "/camera", "/other", "c1", "c2"}


def test_a_bag_on_another_host_is_no_missing_file(client):
    client.boxes["/box"] = "/nowhere/box.bag"
    told = run(client, "why")
    assert (told.code, "box.bag is on the host of the black box" in told.err) == (1, True)


def test_why_says_what_a_bag_does_not_have(client, bag, tmp_path):
    (tmp_path / "no.bag").write_text("nothing")
    for claim, path, said in (
        ("c3", bag, "has no event of claim 'c3'; it has c1, c2"),
        ("c1", tmp_path / "no.bag", "no.bag' cannot be read"),
        ("c1", tmp_path / "gone.bag", "gone.bag' cannot be read"),
    ):
        told = run(client, f"why {claim} --bag {path}")
        assert (told.code, said in told.err) == (1, True)


@pytest.mark.parametrize(
    "unknown", [event("c1", ACTIVE, 99, "?"), Verdict(value=99), model(camera=99)]
)
def test_why_refuses_values_that_mean_nothing(client, tmp_path, unknown):
    path = str(tmp_path / "box.bag")
    messages = [model(), event("c1", ACTIVE, RECOVERING, "died", "/camera"), unknown]
    write_bag(path, [KeptMessage("/t", each, 1.0 + n, 0) for n, each in enumerate(messages)])
    told = run(client, f"why c1 --bag {path}")
    assert told.code == 1
    assert told.err.startswith(f"dyknow: bag '{path}' is damaged")


def test_the_times_of_a_story_are_rounded(client, tmp_path):
    path = str(tmp_path / "box.bag")
    write_bag(path, [KeptMessage("/e", event("c1", ACTIVE, RECOVERING, "died"), 12.9996, 0)])
    assert run(client, f"why --bag {path}").lines[0].split()[0].endswith(":13.000")


def test_record_writes_the_bags_of_all_or_of_some(client):
    refused = "'/b' writes no bag: disk full"
    client.boxes = {"/a": "/bags/a.bag", "/b": Refused(refused)}
    assert run(client, "record") == Outcome(1, "wrote /bags/a.bag\n", f"dyknow: {refused}\n")
    assert run(client, "record a") == Outcome(0, "wrote /bags/a.bag\n", "")
    told = "dyknow: '/c' is no black box; those of the manager: /a, /b\n"
    assert run(client, "record c") == Outcome(1, "", told)
    client.boxes["/a"] = NodeletUnreachable("it hangs")
    assert run(client, "record a") == Outcome(1, "", "dyknow: it hangs\n")


def test_a_black_box_is_started_for_some_topics_or_for_none(client):
    client.host.sources["dyknow/BlackBox"] = ()
    for topics, kept in (("'/camera/*' /odom", ["/camera/*", "/odom"]), ("", [])):
        said = "spawned /black_box from black box in /fake_0\n"
        assert run(client, f"record --black-box {topics}") == Outcome(0, said, "")
        assert client.world.host.parameters["/black_box/topics"] == kept
        assert client.world.host.parameters["/black_box/manager"] == client.manager
        told = "dyknow: '/black_box' runs already; end it first: dyknow destroy /black_box\n"
        assert run(client, f"record --black-box {topics}") == Outcome(1, "", told)
        client.destroy("/black_box")
    assert [call for call, _ in client.calls].count("add_transformation") == 1


def test_a_black_box_is_started_without_a_name(client):
    refused = run(client, "record box --black-box")
    assert refused.code == 2
    assert "expected it without names" in refused.err


def test_the_black_boxes_are_those_of_the_manager(monkeypatch):
    given = {
        "/r1/box": {"manager": "/r1/dyknow_manager"},
        "/r2/box": {"manager": "/r2/dyknow_manager"},
        "/r2/default": {},
        "/r2/relative": {"manager": "dyknow_manager"},
    }
    services = [[f"{name}/write_bag", [name]] for name in given]

    def ask(call, name=""):
        return given[name] if call == "getParam" else [[], [], services]

    client = ShellClient("/r2/dyknow_manager")
    monkeypatch.setattr(client._master, "ask", ask)
    assert client.black_boxes() == ["/r2/box", "/r2/default", "/r2/relative"]


@pytest.mark.parametrize("command", ["record", "why"])
def test_without_a_black_box_the_way_to_one_is_named(client, command):
    told = run(client, command)
    assert told.code == 1
    assert "no black box runs; start one: dyknow record --black-box '/camera/*'" in told.err


@pytest.mark.parametrize("command", ["holds p.data --bag", "why --bag"])
def test_a_bag_that_is_not_there_is_named_once(client, command):
    told = "dyknow: bag 'no.bag' cannot be read: No such file or directory\n"
    assert run(client, f"{command} no.bag") == Outcome(1, "", told)


def test_holds_says_that_a_topic_of_a_known_type_is_not_published(client):
    told = run(client, "holds 'rosout.level > 1' --for 0.01")
    assert (told.code, told.out) == (1, "")
    last = told.err.splitlines()[-1]
    assert last == "dyknow: the topic /rosout of the port 'rosout' is not published"


@pytest.mark.parametrize(
    ("options", "late"), [("", 2), ("--json", 2), ("--delay 0.1", 3), ("--delay 0.8", 0)]
)
def test_holds_says_how_many_messages_came_too_late(client, tmp_path, options, late):
    """Verdicts, which come after their states, have 0.5 s by default, as in the nodelet."""
    path = str(tmp_path / "late.bag")
    delays = {10.0: 0.0, 11.0: 0.0, 11.4: 0.6, 11.8: 0.7, 12.2: 0.4}
    messages = [
        KeptMessage("/f", Verdict(header=Header(stamp=Time(stamp))), stamp + delay, 0)
        for stamp, delay in delays.items()
    ]
    write_bag(path, messages)
    answer = run(client, f"holds 'f.value == 0' --bag {path} {options}")
    assert answer.code == 0
    told = f"{late} messages came too late for their states (--delay)"
    assert (told in answer.err) is (late > 0)


def test_holds_checks_a_bag_with_the_types_that_it_defines(client, tmp_path):
    fields = "float64 x\nfloat64 y\nfloat64 quality\n"
    earlier = generate_dynamic("geometry_msgs/Point", fields)["geometry_msgs/Point"]
    path = str(tmp_path / "earlier.bag")
    with rosbag.Bag(path, "w") as bag:
        bag.write("/p", earlier(1.0, 2.0, 0.5), Time(10))
    assert run(client, f"holds 'p.quality < 1' --bag {path}").code == 0
    told = run(client, f"holds 'p.z < 1' --bag {path}")
    assert (told.code, "geometry_msgs/Point has no field 'z'" in told.err) == (1, True)
