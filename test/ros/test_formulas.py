#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas on real messages: the nodelet, bags, `dyknow holds`, and verdicts that re-wire."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, List

import graph  # first: it makes the test package known
import rosbag
import rospy
from charged_robot import CHARGED, FORMULAS
from dyknow_msgs.msg import Verdict
from graph import Battery, Heard, NodeletManagerCase, battery, is_linked, nodes_on
from manager_suite import ManagerProcess
from processes import DYKNOW, Done, TellingCase, eventually, run
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool, Header
from stream_suite import CAMERA, GOAL, SPARE_FILTER, StreamCase

import dyknow
from dyknow.errors import StreamRefused
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter

FORMULA = "historically[0 s, 1 s] battery.percentage > 0.2"
SHIPPED = Path(__file__).resolve().parents[2] / "examples" / "transformations" / "relay.xml"

ALL_CHARGED = """
<transformation type="formula"><label>all charged</label>
  <ports><port type="in" datatype="sensor_msgs/BatteryState">b</port>
  <port type="out">holds</port></ports>
  <tags><tag port="b">Battery(?r)</tag><tag port="holds">AllCharged</tag></tags>
  <formula>every ?r (b.percentage &gt; 0.2)</formula></transformation>
"""


def drained(begin: float) -> List[BatteryState]:
    """Ten seconds of a battery that is low twice."""
    return [battery(begin + each / 20, 0.2 + math.sin(each / 20)) for each in range(200)]


class NodeletTest(NodeletManagerCase):
    def load(self, name: str, formula: str, types: dict[str, str], **parameters: Any) -> None:
        remappings = {f"{name}/{port}": f"/{port}" for port in types}
        remappings[f"{name}/holds"] = f"{name}/verdicts"
        given = {"formula": formula, "datatypes": types, **parameters}
        self.manager.load("dyknow/Formula", name, {}, **given)
        graph.connect(name, holds=f"{name}/verdicts", **{port: f"/{port}" for port in types})

    def test_live_and_from_a_bag_the_verdicts_are_the_same(self):
        self.load("/charged", FORMULA, {"battery": "sensor_msgs/BatteryState"}, delay=1000.0)
        live = self.enter(Heard("/charged/verdicts", Verdict))
        publisher = self.publisher("/battery", BatteryState, queue_size=1000)
        eventually(lambda: is_linked("/battery"), 10.0, "the nodelet is connected")
        path = str(self.make_folder() / "run.bag")
        messages = drained(rospy.get_time() - 100.0)
        with rosbag.Bag(path, "w") as bag:
            for number, message in enumerate(messages):
                bag.write("/battery", message, message.header.stamp)
                publisher.publish(message)
                # Two messages a state, and no more than fit into the nodelet's queue at a time.
                wanted = number // 2 - 20
                eventually(lambda wanted=wanted: len(live) >= wanted, 10.0, "verdicts come")
        done = Done("holds", FORMULA, "--bag", path, "--all", "--json")
        of_bag = [json.loads(line) for line in done.lines]
        self.assertEqual(done.code, 1, done.err)
        eventually(
            lambda: len(live) >= len(of_bag) - 1,
            10.0,
            "all states are decided",
            lambda: f"{len(of_bag)} of the bag, {len(live)} live:\n{list(live)}\n"
            f"{messages[0].header}\n{graph.get_statistics('/charged')}",
        )
        names = {0: "FALSE", 1: "TRUE", 2: "UNKNOWN"}
        found = [
            {
                "stamp": each.header.stamp.to_nsec() / 1e9,
                "value": names[each.value],
                "since": each.since.to_nsec() / 1e9,
                "why": each.why,
            }
            for each in live
        ]
        # The end of a bag closes one state more than its last message.
        self.assertEqual(found, of_bag[: len(found)])
        self.assertEqual({each["value"] for each in found}, {"TRUE", "FALSE"})
        publisher.unregister()

    def test_states_close_without_messages(self):
        self.load("/alive", "age(beat) < 0.5 s", {"beat": "std_msgs/Bool"})
        verdicts = self.enter(Heard("/alive/verdicts", Verdict))
        with graph.Talker("/beat", Bool(True)):
            verdicts.has(lambda each: each.value == Verdict.TRUE)
        verdict = verdicts.has(lambda each: each.value == Verdict.FALSE)
        self.assertRegex(verdict.why, r"^age\(beat\) = 0\.[56]")

    def test_what_cannot_be_loaded_says_why(self):
        types = {"battery": "sensor_msgs/BatteryState"}
        for formula, given, text in (
            ("battery.percentage >", types, "line 1, column 21: expected a formula"),
            ("battery.percntage > 1", types, "did you mean percentage"),
            ("battery.percentage > 1", {"battery": "no_msgs/Such"}, "no_msgs/Such"),
            ("every ?c (battery.percentage > 1)", types, "expected its tag, such as Image"),
        ):
            with self.subTest(formula), self.assertRaisesRegex(rospy.ServiceException, text):
                self.load("/wrong", formula, given)


class HoldsTest(TellingCase):
    def holds(self, *words: str) -> Any:
        return self.run_process(*DYKNOW, "holds", *words)

    def test_an_ordinary_topic(self):
        source = self.enter(Battery(0.5))
        command = self.holds("battery.percentage > 0.2", "--topic", "battery=battery", "--why")
        command.wait_for_match(r"TRUE  battery\.percentage = 0\.5 at \d+")
        source.percentage = 0.19
        command.wait_for_match(r"\d+\.\d00 FALSE  battery\.percentage = 0\.19 at \d+(\.\d+)?\n")
        command.stop()
        self.assertEqual(command.exit_code(20.0), 1)
        command.wait_for_match(r"FALSE in \d+, UNKNOWN in 0 of \d+ states")

    def test_the_topic_of_its_name_for_some_time(self):
        self.enter(Battery(0.5))
        done = Done("holds", "battery.percentage > 0.2", "--for", "1", "--json")
        self.assertEqual(done.code, 0, done.err)
        self.assertEqual({json.loads(each)["value"] for each in done.lines}, {"TRUE"})
        self.assertEqual(nodes_on("/battery")[1], set())

    def test_a_topic_that_comes_later(self):
        command = self.holds("battery.percentage > 0.2", "--topic", "/battery")
        command.wait_for("the topic /battery of the port 'battery' is not published: waiting")
        with Battery(0.5):
            command.wait_for("TRUE")
        command.stop()
        self.assertEqual(command.exit_code(20.0), 0)

    def test_a_topic_that_does_not_come_in_time(self):
        done = Done("holds", "nothing.percentage > 0.2", "--for", "0.5")
        self.assertEqual(done.code, 1)
        self.assertIn("the topic /nothing of the port 'nothing' is not published\n", done.err)

    def test_what_is_wrong_is_said(self):
        self.enter(Battery(0.5))
        rospy.wait_for_message("/battery", BatteryState, 20.0)
        for words, text in (
            (
                ["battery.percntage > 0.2"],
                "has no field 'percntage'; did you mean percentage? its",
            ),
            (["battery.percentage > FULL"], "has no constant 'FULL'"),
            (["historicaly[0, 5] battery.percentage > 1"], "did you mean historically?"),
            (["battery.percentage > 1", "--bag", "/no/such.bag"], "No such file"),
            (["battery.percentage > 1", "--topic", "batery=/b"], "its ports are battery"),
            (["every ?c (battery.percentage > 1)"], "give its tag, as --port 'battery=Image(?c"),
            (
                ["every ?c (b.percentage > 1)", "--port", "b=Battery(?x)"],
                "has the variable ?x; expected the quantifier's, ?c",
            ),
        ):
            with self.subTest(words):
                done = Done("holds", *words)
                self.assertEqual((done.code, done.out), (1, ""))
                self.assertIn(text, done.err)

    def test_streams_without_a_manager(self):
        for formula, name in (("b.data > 1", "nao"), ("every ?c (b.data > 1)", "?c")):
            words = ("holds", formula, "--port", f"b=Battery({name})", "--manager-node", "/none")
            done = Done(*words)
            self.assertEqual((done.code, done.out), (3, ""), done.err)
            self.assertIn("DyKnow manager '/none' is not running", done.err)

    def test_what_a_bag_lacks_is_said(self):
        path = str(self.make_folder() / "run.bag")
        with rosbag.Bag(path, "w") as bag:
            bag.write("/battery", battery(1.0, 0.5), rospy.Time(1.0))
        done = Done("holds", "batery.percentage > 1", "--bag", path)
        self.assertEqual(done.code, 1)
        said = "has no topic '/batery' for the port 'batery'; did you mean /battery?"
        self.assertIn(said, done.err)
        done = Done("holds", "b.percentage > 0.1", "--bag", path, "--topic", "b=/battery")
        self.assertEqual(done.code, 0, done.err)
        done = Done("holds", "every ?c (battery.percentage > 1)", "--bag", path)
        self.assertEqual((done.code, done.out), (1, ""))
        self.assertIn("a bag has no individuals ?c", done.err)


class RequiresTest(StreamCase):
    def guarded(self) -> ManagerProcess:
        """A manager whose camera requires a charged battery."""
        manager = self.tracking(recover=0.5)
        manager.client.add_transformation(FORMULAS)
        requires = f"<requires>{CHARGED}</requires></transformation>"
        manager.client.add_transformation(CAMERA.replace("</transformation>", requires))
        return manager

    def test_a_flat_battery_moves_the_stream_to_another_camera_and_back(self):
        manager, source = self.guarded(), self.enter(Battery(0.5))
        events = self.events()
        got = manager.client.acquire_stream(StreamRequest(GOAL))
        heard = self.enter(Heard(got.topic))
        heard.flows()
        self.assertEqual(self.nodelet_of(manager, "camera"), "/camera_1")
        self.nodelet_of(manager, "charged")
        source.percentage = 0.19
        reason = events.mended("/camera_1 is not available").reason
        self.assertRegex(
            reason,
            r"^mended: /camera_1 is not available: Holds\(charged, nao\) is FALSE since "
            r"\d+\.\d{3} \(battery\.percentage = 0\.19 at [\d.]+\); /ceiling_1 is used now$",
        )
        heard.flows()
        manager.is_gone("/camera_1")
        self.settled(manager)
        with self.assertRaisesRegex(StreamRefused, "camera is not available: Holds"):
            manager.client.acquire_stream(StreamRequest("Raw(own)"), dry_run=True)

        source.percentage = 0.5
        eventually(
            lambda: any("a cheaper way has appeared, with camera" in e for e in events.reasons()),
            20.0,
            "the way back is offered",
            events.reasons,
        )
        manager.client.replan_stream(got.claim_id)
        heard.flows()
        self.nodelet_of(manager, "camera")
        for claim in manager.claims():
            if claim.client_id != "dyknow_manager":
                manager.client.release_stream(claim.claim_id)
        self.is_cleared(manager)
        self.assertEqual([each for each in manager.claims() if not each.state.ended], [])

    def test_a_black_box_has_what_happened_and_why(self):
        manager, source = self.guarded(), self.enter(Battery(0.5))
        folder = self.make_folder()
        manager.client.add_transformation(SHIPPED.read_text())
        given = {"topics": "['*']", "folder": str(folder), "after": "0.5"}
        parameters = tuple(Parameter(name, "", value) for name, value in given.items())
        manager.client.spawn("black box", "/box", parameters=parameters)
        got = manager.client.acquire_stream(StreamRequest(GOAL))
        heard = self.enter(Heard(got.topic))
        heard.flows()
        events = self.events()
        source.percentage = 0.19
        events.mended("/camera_1 is not available")
        eventually(lambda: list(folder.glob("box_*.bag")), 20.0, "a bag is written")
        story = ""

        def is_told() -> bool:
            nonlocal story
            story = Done("why", got.claim_id).out
            return "verdict false: battery.percentage = 0.19 at " in story

        eventually(is_told, 20.0, "the whole story is in a bag", lambda: story)
        self.assertRegex(story, rf"{got.claim_id} .* active → recovering: /camera_1 is not")
        self.assertRegex(story, rf"{got.claim_id} .*: mended: /camera_1 is not available")
        self.assertRegex(story, r"/ceiling_1 +is running")
        bags = sorted(folder.glob("box_*.bag"))
        self.assertIn(str(bags[-1]), story)
        with rosbag.Bag(str(bags[0])) as bag:
            self.assertLessEqual({got.topic, "/battery"}, {*bag.get_type_and_topic_info().topics})

    def test_a_manager_that_is_killed_goes_on_with_the_verdicts(self):
        manager, source = self.guarded(), self.enter(Battery(0.5))
        got = manager.client.acquire_stream(StreamRequest(GOAL))
        heard = self.enter(Heard(got.topic))
        heard.flows()
        manager.kill()
        source.percentage = 0.19
        manager.start()
        # Its event may come before a listener hears events again.
        used = lambda: next(each.nodelets for each in manager.claims() if each.tag == GOAL)  # noqa: E731
        eventually(lambda: "/ceiling_1" in used(), 20.0, "the other camera is used", used)
        heard.flows()
        self.settled(manager)


class EveryTest(StreamCase):
    def test_individuals_count_from_the_first_verdict_on(self):
        """Their streams are frequent: looks for individuals must not wait for a pause."""
        manager = self.running()
        for robot in ("nao", "pepper"):
            battery = FORMULAS.partition('<transformation type="formula">')[0]
            battery = battery.replace("<label>battery", f"<label>battery of {robot}")
            battery = battery.replace("/battery<", f"/{robot}/battery<")
            battery = battery.replace("Battery(nao)", f"Battery({robot})")
            manager.client.add_transformation(f"{battery}</transformations>")
        manager.client.add_transformation(ALL_CHARGED)
        full = self.enter(Battery(0.5, topic="/nao/battery"))
        flat = self.enter(Battery(0.1, topic="/pepper/battery"))
        names = ("?r=nao", "?r=pepper")
        eventually(lambda: manager.client.find_bindings("Battery(?r)") == names, 20.0, f"{names}")
        stream = manager.client.acquire_stream(StreamRequest("AllCharged"))
        verdicts = self.enter(Heard(stream.topic, Verdict))
        verdicts.has(lambda each: each.why.startswith("pepper: b.percentage = 0.1 at "))
        self.assertNotIn(Verdict.TRUE, {each.value for each in verdicts})
        options = ("--port", "b=Battery(?r)", "--for", "5", "--json")
        done = Done("holds", "every ?r (b.percentage > 0.2)", *options)
        self.assertEqual(done.code, 1, done.err)
        values = {json.loads(line)["value"] for line in done.lines if line[:1] == "{"}
        self.assertTrue("FALSE" in values and "TRUE" not in values, done.out)
        flat.percentage = 0.5
        verdicts.has(lambda each: each.value == Verdict.TRUE)
        full.percentage = 0.1
        verdicts.has(lambda each: each.why.startswith("nao: b.percentage = 0.1 at "))


class RequireTest(StreamCase):
    FORMULA = "age(it) < 0.5 s"

    def test_a_stream_of_which_the_formula_is_false_gets_another_part(self):
        manager = self.tracking()
        manager.client.add_transformation(SPARE_FILTER)
        events = self.events()
        with dyknow.acquire(GOAL, Header, require=self.FORMULA) as stream:
            heard = self.enter(Heard(stream.topic))
            heard.flows(20)
            self.tell("/filter_1", "silent")
            reason = events.mended("is FALSE since").reason
            self.assertIn(f"'{self.FORMULA}' is FALSE since", reason)
            self.assertIn("(age(it) = 0.5", reason)
            self.assertIn("/spare_filter_1", reason)
            heard.flows(20)
            self.delivers(manager, stream.claim_id)
            self.settled(manager)
        self.is_cleared(manager)

    def test_without_another_part_the_stream_is_degraded(self):
        manager = self.tracking()
        with dyknow.acquire("Raw(own)", Header, require="it.seq < 100") as stream:
            self.become(manager, stream.claim_id, ClaimState.DEGRADED)
            detail = self.claim(manager, stream.claim_id).detail
            self.assertIn("'it.seq < 100' is FALSE since", detail)
            self.assertIn("no part of it can be replaced", detail)
        self.is_cleared(manager)


if __name__ == "__main__":
    run()
