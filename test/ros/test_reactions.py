#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts that re-wire: parts that require them, and streams of which a formula is required."""

from __future__ import annotations

import json
from pathlib import Path

from dyknow_msgs.msg import Verdict
from graph import Battery, Heard
from manager_suite import ManagerProcess
from processes import DYKNOW, eventually, finished, run
from std_msgs.msg import Header
from stream_suite import CAMERA, GOAL, SPARE_FILTER, StreamCase

import dyknow
from dyknow.errors import StreamRefused
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter

SHIPPED = Path(__file__).resolve().parents[2] / "examples" / "transformations" / "relay.xml"
CHARGED = "Holds(charged, nao)"
FORMULAS = """
<transformations>
  <transformation type="topic"><label>battery</label><source>/battery</source>
    <ports><port type="out" datatype="sensor_msgs/BatteryState">out</port></ports>
    <tags><tag port="out">Battery(nao)</tag></tags></transformation>
  <transformation type="formula"><label>charged</label>
    <ports><port type="in" datatype="sensor_msgs/BatteryState">battery</port>
    <port type="out">holds</port></ports>
    <tags><tag port="battery">Battery(?robot)</tag>
    <tag port="holds">Holds(charged, ?robot)</tag></tags>
    <formula>battery.percentage &gt; 0.2</formula></transformation>
</transformations>
"""


ALL_CHARGED = """
<transformation type="formula"><label>all charged</label>
  <ports><port type="in" datatype="sensor_msgs/BatteryState">b</port>
  <port type="out">holds</port></ports>
  <tags><tag port="b">Battery(?r)</tag><tag port="holds">AllCharged</tag></tags>
  <formula>every ?r (b.percentage &gt; 0.2)</formula></transformation>
"""


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
        code, story = finished([*DYKNOW, "why", got.claim_id])
        self.assertEqual(code, 0, story)
        self.assertRegex(story, r"verdict false: battery\.percentage = 0\.19 at ")
        self.assertRegex(story, rf"{got.claim_id} .* active → recovering: /camera_1 is not")
        self.assertRegex(story, rf"{got.claim_id} .*: mended: /camera_1 is not available")
        self.assertRegex(story, r"/ceiling_1 +is running")
        bags = sorted(folder.glob("box_*.bag"))
        self.assertIn(str(bags[-1]), story)
        code, output = finished(["rosbag", "info", "-y", "-k", "topics", str(bags[0])])
        self.assertIn(got.topic, output)
        self.assertIn("topic: /battery", output)

    def test_a_manager_that_is_killed_goes_on_with_the_verdicts(self):
        manager, source = self.guarded(), self.enter(Battery(0.5))
        got = manager.client.acquire_stream(StreamRequest(GOAL))
        heard = self.enter(Heard(got.topic))
        heard.flows()
        manager.kill()
        source.percentage = 0.19
        manager.start()
        self.events().mended("/camera_1 is not available")
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
        code, output = finished([*DYKNOW, "holds", "every ?r (b.percentage > 0.2)", *options])
        self.assertEqual(code, 1, output)
        lines = [json.loads(line) for line in output.splitlines() if line[:1] == "{"]
        values = {line["value"] for line in lines}
        self.assertTrue("FALSE" in values and "TRUE" not in values, output)
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

    def test_what_is_wrong_with_a_formula_is_said(self):
        manager = self.tracking()
        for require, text in (
            ("it.seq <", "line 1, column 9: expected"),
            ("it.sec < 1", "has no field 'sec'; did you mean seq?"),
            ("that.seq < 1", "a formula that reads 'it' alone"),
        ):
            code, output = finished([*DYKNOW, "acquire", GOAL, "--require", require])
            self.assertNotEqual(code, 0)
            self.assertIn(text, output)
        self.assertEqual(manager.claims(), [])


if __name__ == "__main__":
    run()
