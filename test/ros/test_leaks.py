#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Re-wiring and loading over and over: the process's resources do not grow."""

from __future__ import annotations

import os

import graph  # first: it makes the test package known
import rospy
import rostest
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from graph import Heard, NodeletManagerCase, call, peer
from processes import becomes, eventually

SCRIPTS = {
    "/talker": ["talker.py", "--word", "w"],
    "/both": ["both_ways.py"],
    "/server": ["libraries.py"],
    "/client": ["libraries.py", "/server/count"],
    "/reconfigured": ["reconfigured.py"],
    "/endless": ["endless.py", "sleepy", "waiting", "working"],
}
#: Allowance for connections that the master keeps, workers started while the machine was busy,
#: and functions of these threads. A leak goes beyond.
SPARE = 10
PAGE = os.sysconf("SC_PAGE_SIZE") // 1024


class LeakCase(NodeletManagerCase):
    def holdings(self) -> dict[str, float]:
        return {"descriptors": self.manager.descriptors(), "threads": self.manager.threads()}

    def leaves_nothing(self, action, warm, rounds, **most):
        """Repeat an action; wait until the process holds no more than after the first rounds."""
        for _ in range(warm):
            action()
        own = graph.registered("/manager")
        before = self.holdings()
        for _ in range(rounds):
            action()
        # A topic that was left just before they were read may have been among them still.
        becomes(lambda: graph.registered("/manager") - own, set())
        most = {**dict.fromkeys(before, SPARE), **most}

        def grown():
            after = self.holdings()
            return {key: after[key] - before[key] for key in most}

        def is_settled():
            if all(value <= most[key] for key, value in grown().items()):
                return True
            # A class that all scripts share may keep the last script's copies of a library, as
            # actionlib's does, until another script has used it. A leak grows by this.
            action()
            return False

        print(f"after {rounds} rounds: {grown()}")
        eventually(is_settled, 10.0, f"no more than {most} after {rounds} rounds", grown)


class LeakTest(LeakCase):
    def rewires(self, warm, rounds, *topics):
        """Move both ports of /n between pairs of topics, over one connection."""
        change = rospy.ServiceProxy("/n/set_config", SetConfig, persistent=True)
        self.addCleanup(change.close)

        def rewire():
            for source, target in topics:
                ports = [PortConfig("in", source), PortConfig("out", target)]
                self.assertTrue(change(ports).success)

        self.leaves_nothing(rewire, warm, rounds)

    def test_rewirings_inside(self):
        self.manager.load("Talker", "/talker", {"/out": "/a"})
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        self.rewires(10, 500, ("/c", "/d"), ("/a", "/b"))

    def test_rewirings_across_processes(self):
        self.run_process(*peer("talk", "200", "/a", "/c"))
        listener = self.run_process(*peer("listen", "/b", "/d"))
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        listener.wait_for("/b ")
        self.rewires(5, 50, ("/c", "/d"), ("/a", "/b"))

    def test_loads_and_unloads(self):
        self.enter(Heard("/b"))
        self.publisher("/a", graph.Header)
        topics = {"/in": "/a", "/out": "/b"}

        def load_and_unload():
            self.manager.load("Relay", "/n", topics)
            self.manager.load("Metronome", "/metronome")
            call("/metronome", "start", 0.01)
            self.manager.unload_all()
            with self.assertRaises(rospy.ServiceException):
                self.manager.load("FailsInInit", "/n", topics)
            self.nothing_is_left()

        self.leaves_nothing(load_and_unload, 5, 100)


class ScriptLeakTest(LeakCase):
    def test_scripts(self):
        # Until caches are full, pools of threads are as large as they become, and the heap has
        # holes for all that comes and goes: it grows by 18 MB in 60 cycles, and by 2 MB from the
        # 300th to the 600th.
        warm, cycles, memory = (rospy.get_param(f"~{n}") for n in ("warm", "cycles", "memory"))
        self.leaves_nothing(self.cycle, warm, cycles, modules=0, memory=memory)

    def cycle(self) -> None:
        for name, (script, *arguments) in SCRIPTS.items():
            self.manager.load("dyknow/Script", name, {}, [f"dyknow_test/{script}", *arguments])
        for name in reversed(SCRIPTS):
            self.manager.unload(name)
        self.nothing_is_left()

    def holdings(self) -> dict[str, float]:
        self.manager.load("dyknow/Script", "/census", {}, ["dyknow_test/census.py"])
        becomes(self.manager.list, [])  # the census has ended
        with open(f"/proc/{self.manager.pid}/statm") as file:
            memory = int(file.read().split()[1]) * PAGE
        return {**super().holdings(), **rospy.get_param("/census"), "memory": memory}


if __name__ == "__main__":
    rospy.init_node("leaks")
    rostest.rosrun("dyknow", "leaks", ScriptLeakTest if rospy.has_param("~cycles") else LeakTest)
