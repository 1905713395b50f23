#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A roscore that is killed and started again: all nodes are registered again, none is touched."""

from __future__ import annotations

import re
from typing import Any

import rospy
from graph import peer
from manager_suite import MANAGER, MasterCase, answers, children_in, contents, gaps
from processes import DYKNOW, NODELET, Running, becomes, eventually, finished, run
from stream_suite import GOAL, LIBRARY

from dyknow.errors import Refused
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.nodelets.announcements import TOPIC as NODES_TOPIC
from dyknow.ros.wire.master import Master

FAR = "/far"
#: How often the master dies.
ROUNDS = 3


def heard(listener: Running, topic: str) -> list[int]:
    """The numbers that a listener printed of a topic."""
    return [int(each) for each in re.findall(rf"^{topic} (\d+)$", listener.output, re.MULTILINE)]


def goes_on(listener: Running, *topics: str) -> None:
    """Wait until more has come on each topic; nothing was doubled, and nothing lost.

    Nodes with short queues may drop messages on a busy machine; that of `/plain` has none.
    """
    for topic in topics:
        count = len(heard(listener, topic))
        eventually(lambda: len(heard(listener, topic)) > count + 5, 10.0, f"{topic} flows")  # noqa: B023
        numbers = heard(listener, topic)
        assert numbers == sorted({*numbers}), (topic, gaps(numbers))
        assert topic != "/plain" or gaps(numbers) == [], gaps(numbers)


def lacking(before: Any) -> Any:
    """Registrations and parameters that are not there."""
    now = contents()
    if now is None:
        return "everything"
    *sides, parameters = before
    return [
        *(
            (name, nodes - side.get(name, set()))
            for old, side in zip(sides, now)
            for name, nodes in old.items()
            if nodes - side.get(name, set())
        ),
        *(each for each in parameters if now[3].get(each) != parameters[each]),
    ]


class NewMasterTest(MasterCase):
    def start(self, *settings: str) -> Any:
        manager = self.manager("_orphan_timeout:=60", *settings)
        eventually(lambda: answers(self.client), 20.0, "it is up", lambda: manager.output)
        return manager

    def ordinary_nodes(self) -> Running:
        """Nodes of rospy and roscpp that know nothing of DyKnow; returns the one that listens."""
        topics = ("/plain", "/copied")
        self.run_process(*peer("talk", "50", "/plain"), "__name:=talker")
        self.run_process("rosrun", "topic_tools", "relay", *topics, "__name:=relay")
        self.run_process("rosrun", "topic_tools", "mux", "/muxed", *topics, "mux:=mux")
        self.run_process("rosrun", "rosout", "rosout")
        listener = self.run_process(*peer("listen", *topics), "__name:=listener")
        goes_on(listener, *topics)
        Master(rospy.get_name()).ask("setParam", "/robot", {"name": "arm", "wheels": [1, 2.5]})
        return listener

    def all_is_back(self, before: Any) -> float:
        """Wait until all is registered again; returns how long (s) that took."""
        return eventually(lambda: not lacking(before), 5.0, "all is back", lambda: lacking(before))

    def is_seen_from_outside(self, *topics: str) -> None:
        with self.run_process(*peer("listen", *topics)) as fresh:
            goes_on(fresh, *topics)
            fresh.stop()
            fresh.exit_code(10.0)
        code, nodes = finished(["rosnode", "list"])
        self.assertLess({"/talker", "/listener", "/relay", "/rosout", MANAGER}, {*nodes.split()})
        self.assertEqual(finished(["rosparam", "get", "/robot/name"]), (0, "arm\n"))
        code, answer = finished(["rosservice", "call", "/mux/list"])
        self.assertEqual((code, "/plain" in answer), (0, True), answer)

    def test_every_node_is_registered_again(self):
        core = self.roscore()
        manager = self.start(f"_nodelet_managers:=['{FAR}']", "_denied_topics:=['/secret']")
        self.run_process(*NODELET, "manager", f"__name:={FAR[1:]}")
        listener = self.ordinary_nodes()
        self.run_process(*DYKNOW, "run", "topic_tools", "relay", "/plain", "/x", "__name:=copier")
        self.manager("__name:=second")
        self.client.add_transformation(LIBRARY)
        self.client.spawn("camera", "/by_hand", {"out": "/by_hand/out"}, manager=FAR)
        claim = self.client.acquire_stream(StreamRequest(GOAL))
        holder = self.run_process(*peer("claim", GOAL))
        holder.wait_for("ACTIVE")
        wanted = ("/mux/select", "/copier/get_config", f"{FAR}/list", "/second/get_model")
        before, children = self.mirrored(*wanted), children_in(self.state)
        nodelets = {each.name for each in self.client.get_model().nodelets}
        manager.forget_output()
        for number in range(ROUNDS):
            self.kill(core)
            goes_on(listener, "/plain", "/copied")
            late = self.run_process(*peer("talk", "50", "/late"), "__name:=late")
            core = self.roscore()
            took = self.all_is_back(before)
            print(f"round {number}: registered again after {took:.1f} s")
            self.is_seen_from_outside("/plain", "/copied", "/late", claim.topic)
            late.stop()
            late.exit_code(10.0)
            becomes(contents, before)
            goes_on(listener, "/plain", "/copied")
            with self.assertRaises(Refused):
                self.client.spawn("camera", "/guarded", {"out": "/secret"})
        # A roscore sets parameters of its own, and takes the place of the node rosout.
        self.kill(core)
        core = self.run_process("roscore", "-p", self.port)
        self.all_is_back(before)
        self.is_seen_from_outside("/plain", "/copied", claim.topic)
        eventually(lambda: "run_id" in contents()[3], 10.0, "it has its id", lambda: core.output)
        goes_on(listener, "/plain", "/copied")
        self.assertFalse(core.has_ended, core.output)
        self.assertEqual(children_in(self.state), children)
        self.assertEqual({each.name for each in self.client.get_model().nodelets}, nodelets)
        states = set(re.findall(r"^([A-Z]+) ", holder.output, re.MULTILINE))
        self.assertEqual(states, {"ACTIVE"}, holder.output)
        for each in self.client.list_streams():
            self.assertEqual(each.state, ClaimState.ACTIVE)
        self.assertIn(NODES_TOPIC, before[0])

    def test_the_manager_is_dead_meanwhile(self):
        core = self.roscore()
        manager = self.start()
        listener = self.ordinary_nodes()
        self.client.add_transformation(LIBRARY)
        claim = self.client.acquire_stream(StreamRequest(GOAL, lease=600.0))
        children = children_in(self.state)
        flow = self.run_process(*peer("listen", claim.topic), "__name:=flow")
        goes_on(flow, claim.topic)
        self.mirrored("/mux/select")
        self.kill(manager, core)
        self.roscore()
        self.assertEqual(contents()[0], {})
        self.start()
        self.is_seen_from_outside("/plain", "/copied", claim.topic)
        goes_on(listener, "/plain", "/copied")
        goes_on(flow, claim.topic)
        self.assertEqual(children_in(self.state), children)
        (after,) = self.client.list_streams()
        self.assertEqual(
            (after.claim_id, after.topic, after.state.name),
            (claim.claim_id, claim.topic, "ACTIVE"),
        )


if __name__ == "__main__":
    run()
