#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas on real messages: the nodelet, bags, and the command `dyknow holds`."""

from __future__ import annotations

import json
import math
from typing import Any, List

import graph  # first: it makes the test package known
import rosbag
import rospy
from dyknow_msgs.msg import Verdict
from graph import Battery, Heard, NodeletManagerCase, battery
from processes import DYKNOW, TellingCase, eventually, finished, run
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

FORMULA = "historically[0 s, 1 s] battery.percentage > 0.2"


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
        eventually(publisher.get_num_connections, 10.0, "the nodelet is connected")
        path = str(self.make_folder() / "run.bag")
        messages = drained(rospy.get_time() - 100.0)
        with rosbag.Bag(path, "w") as bag:
            for number, message in enumerate(messages):
                bag.write("/battery", message, message.header.stamp)
                publisher.publish(message)
                # Two messages a state, and no more than fit into the nodelet's queue at a time.
                wanted = number // 2 - 20
                eventually(lambda wanted=wanted: len(live) >= wanted, 10.0, "verdicts come")
        code, output = finished([*DYKNOW, "holds", FORMULA, "--bag", path, "--all", "--json"])
        of_bag = [json.loads(line) for line in output.splitlines()]
        self.assertEqual(code, 1, output)
        eventually(lambda: len(live) >= len(of_bag) - 1, 10.0, "all states are decided")
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
        ):
            with self.subTest(formula), self.assertRaisesRegex(rospy.ServiceException, text):
                self.load("/wrong", formula, given)


class HoldsTest(TellingCase):
    def holds(self, *words: str) -> Any:
        return self.run_process(*DYKNOW, "holds", *words)

    def test_an_ordinary_topic(self):
        source = self.enter(Battery(0.5))
        command = self.holds("battery.percentage > 0.2", "--topic", "battery=/battery", "--why")
        command.wait_for_match(r"TRUE  battery\.percentage = 0\.5 at \d+")
        source.percentage = 0.19
        command.wait_for_match(r"\d+\.\d00 FALSE  battery\.percentage = 0\.19 at \d+\.\d+\n")
        command.stop()
        self.assertEqual(command.exit_code(20.0), 1)
        command.wait_for_match(r"FALSE in \d+, UNKNOWN in 0 of \d+ states")

    def test_the_topic_of_its_name_for_some_time(self):
        self.enter(Battery(0.5))
        code, output = finished(
            [*DYKNOW, "holds", "battery.percentage > 0.2", "--for", "1", "--json"]
        )
        self.assertEqual(code, 0, output)
        self.assertEqual({json.loads(each)["value"] for each in output.splitlines()}, {"TRUE"})

    def test_a_topic_that_comes_later(self):
        command = self.holds("battery.percentage > 0.2", "--topic", "/battery")
        command.wait_for("the topic /battery of the port 'battery' is not published: waiting")
        with Battery(0.5):
            command.wait_for("TRUE")
        command.stop()
        self.assertEqual(command.exit_code(20.0), 0)

    def test_a_topic_that_does_not_come_in_time(self):
        code, output = finished([*DYKNOW, "holds", "nothing.percentage > 0.2", "--for", "0.5"])
        self.assertEqual(code, 1)
        self.assertIn("the topic /nothing of the port 'nothing' is not published\n", output)

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
        ):
            with self.subTest(words):
                code, output = finished([*DYKNOW, "holds", *words])
                self.assertEqual(code, 1, output)
                self.assertIn(text, output)

    def test_what_a_bag_lacks_is_said(self):
        path = str(self.make_folder() / "run.bag")
        with rosbag.Bag(path, "w") as bag:
            bag.write("/battery", battery(1.0, 0.5), rospy.Time(1.0))
        code, output = finished([*DYKNOW, "holds", "batery.percentage > 1", "--bag", path])
        self.assertEqual(code, 1)
        self.assertIn(
            "has no topic '/batery' for the port 'batery'; did you mean /battery?", output
        )
        code, output = finished(
            [*DYKNOW, "holds", "b.percentage > 0.1", "--bag", path, "--topic", "b=/battery"]
        )
        self.assertEqual(code, 0, output)


if __name__ == "__main__":
    run()
