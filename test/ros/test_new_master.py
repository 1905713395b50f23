#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A roscore that is killed and comes back: all nodes are registered again, none is touched."""

from __future__ import annotations

import contextlib
import re
import time
from pathlib import Path
from typing import Any

import rospy
from graph import peer
from manager_suite import MANAGER, MasterCase, answers, children_in, contents, gaps
from processes import DYKNOW, NODELET, Running, becomes, eventually, nodes, run
from roslib.packages import find_node
from stream_suite import GOAL, LIBRARY
from topic_tools.srv import MuxList

from dyknow.errors import Refused
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.nodelets.announcements import TOPIC as NODES_TOPIC
from dyknow.ros.wire.master import Master

FAR = "/far"


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
            (name, those - side.get(name, set()))
            for old, side in zip(sides, now)
            for name, those in old.items()
            if those - side.get(name, set())
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
        self.run_process(*find_node("topic_tools", "relay"), *topics, "__name:=relay")
        self.run_process(*find_node("topic_tools", "mux"), "/muxed", *topics, "mux:=mux")
        self.run_process(*find_node("rosout", "rosout"))
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
        self.assertLess({"/talker", "/listener", "/relay", "/rosout", MANAGER}, nodes())
        self.assertEqual(rospy.get_param("/robot/name"), "arm")
        self.assertIn("/plain", rospy.ServiceProxy("/mux/list", MuxList)().topics)

    def always_active(self, holder: Running) -> None:
        """The stream that a program holds flows, and has always been active."""
        said = lambda: re.findall(r"^([A-Z]+) \S* (flows|still)", holder.output, re.M)  # noqa: E731
        eventually(lambda: said()[-1][1] == "flows", 5.0, "it flows", lambda: holder.output)
        self.assertEqual({state for state, _ in said()}, {"ACTIVE"}, said())

    def test_every_node_is_registered_again(self):
        core = self.roscore()
        manager = self.start(f"_nodelet_managers:=['{FAR}']", "_denied_topics:=['/secret']")
        self.run_process(*NODELET, "manager", f"__name:={FAR[1:]}")
        listener = self.ordinary_nodes()
        self.run_process(*DYKNOW, "run", "topic_tools", "relay", "/plain", "/x", "__name:=copier")
        self.client.add_transformation(LIBRARY)
        eventually(self.is_spawned, 20.0, "it is used", lambda: manager.output)
        claim = self.client.acquire_stream(StreamRequest(GOAL, lease=600.0))
        holder = self.run_process(*peer("claim", GOAL, "10"))
        holder.wait_for("flows")
        flow = self.run_process(*peer("listen", claim.topic), "__name:=flow")
        goes_on(flow, claim.topic)
        second = self.manager("__name:=second")
        wanted = ("/mux/select", "/copier/get_config", f"{FAR}/list", "/second/get_model")
        before, children = self.mirrored(*wanted), children_in(self.state)
        nodelets = {each.name for each in self.client.get_model().nodelets}
        manager.forget_output()

        # Without a master, streams flow on, and their claims are still renewed.
        self.kill(core)
        goes_on(listener, "/plain", "/copied")
        late = self.run_process(*peer("talk", "50", "/late"), "__name:=late")
        time.sleep(13.0)  # longer than the lease
        self.always_active(holder)
        self.assertNotIn("EXPIRED", manager.output)
        self.assertFalse(answers(self.client))  # nothing can be looked up or requested
        core = self.roscore()
        print(f"registered again after {self.all_is_back(before):.1f} s")
        self.is_seen_from_outside("/plain", "/copied", "/late", claim.topic)
        late.stop()
        late.exit_code(10.0)
        becomes(contents, before)
        goes_on(listener, "/plain", "/copied")
        with self.assertRaises(Refused):
            self.client.spawn("camera", "/guarded", {"out": "/secret"})
        with self.run_process(*peer("claim", GOAL)) as another:
            another.wait_for("flows")

        # No manager is there meanwhile.
        self.kill(manager, second, core)
        for each in Path(self.state).glob("*second*.master"):
            each.unlink()
        core = self.roscore()
        self.assertEqual(contents()[0], {})
        self.start(f"_nodelet_managers:=['{FAR}']", "_denied_topics:=['/secret']")
        self.is_seen_from_outside("/plain", "/copied", claim.topic)
        goes_on(listener, "/plain", "/copied")
        goes_on(flow, claim.topic)
        self.all_is_kept(claim, children, nodelets)
        self.assertIn(NODES_TOPIC, before[0])

        # A roscore sets parameters of its own, and takes the place of the node rosout.
        before = self.mirrored(*wanted[:-1])
        self.kill(core)
        core = self.run_process("roscore", "-p", self.port)
        self.all_is_back(before)
        eventually(lambda: "run_id" in contents()[3], 10.0, "it has its id", lambda: core.output)
        self.is_seen_from_outside("/plain", "/copied", claim.topic)
        goes_on(listener, "/plain", "/copied")
        self.assertFalse(core.has_ended, core.output)
        self.all_is_kept(claim, children, nodelets)

    def is_spawned(self) -> bool:
        with contextlib.suppress(Refused):  # it is not known yet
            self.client.spawn("camera", "/by_hand", {"out": "/by_hand/out"}, manager=FAR)
            return True
        return False

    def all_is_kept(self, claim: Any, children: Any, nodelets: Any) -> None:
        """No process and no nodelet is another one, and no claim has changed."""
        self.assertEqual(children_in(self.state), children)
        becomes(lambda: {each.name for each in self.client.get_model().nodelets}, nodelets)
        topics = {each.claim_id: each.topic for each in self.living()}
        self.assertEqual(topics[claim.claim_id], claim.topic)
        becomes(lambda: {each.state for each in self.living()}, {ClaimState.ACTIVE})

    def living(self) -> Any:
        """The claims that have not ended."""
        return [each for each in self.client.list_streams() if not each.state.ended]


if __name__ == "__main__":
    run()
