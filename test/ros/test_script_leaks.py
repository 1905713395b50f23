#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Scripts that are loaded and unloaded over and over leave nothing in their process."""

from __future__ import annotations

import os

import graph  # first: it makes the test package known
import rospy
import rostest
from graph import NodeletManagerCase
from processes import eventually

SCRIPTS = {
    "/talker": ["talker.py", "--word", "w"],
    "/both": ["both_ways.py"],
    "/server": ["libraries.py"],
    "/client": ["libraries.py", "/server/count"],
    "/reconfigured": ["reconfigured.py"],
    "/endless": ["endless.py", "sleepy", "waiting", "working"],
}
#: Threads, descriptors and functions that may come and go.
SPARE = 6
PAGE = os.sysconf("SC_PAGE_SIZE") // 1024


class ScriptLeakTest(NodeletManagerCase):
    def test_nothing_is_left(self):
        # Until caches are full, pools of threads are as large as they become, and the heap has
        # holes for all that comes and goes: it grows by 18 MB in 60 cycles, and by 2 MB from the
        # 300th to the 600th.
        for _ in range(rospy.get_param("~warm")):
            self.cycle()
        eventually(lambda: not self.foreign(), 5.0, "only the manager's own is left", self.foreign)
        registered = graph.registrations("/manager")
        before = self.holdings()
        cycles = rospy.get_param("~cycles")
        for _ in range(cycles):
            self.cycle()
        eventually(
            lambda: graph.registrations("/manager") == registered,
            5.0,
            "registrations",
            lambda: graph.registrations("/manager"),
        )
        most = {
            "descriptors": SPARE,
            "threads": SPARE,
            "modules": 0,
            "functions": SPARE,  # of these threads; a leak goes beyond
            "memory": rospy.get_param("~memory"),
        }

        def grown():
            after = self.holdings()
            return {key: after[key] - before[key] for key in most}

        def is_settled():
            if all(value <= most[key] for key, value in grown().items()):
                return True
            # A class that all scripts share may keep the last script's copies of a library, as
            # actionlib's does, until another script has used it. A leak grows by this.
            self.cycle()
            return False

        print(f"after {cycles} cycles: {grown()}")
        eventually(is_settled, 5.0, f"no more than {most} is left of {cycles} cycles", grown)

    def cycle(self) -> None:
        for name, (script, *arguments) in SCRIPTS.items():
            self.manager.load("dyknow/Script", name, {}, [f"dyknow_test/{script}", *arguments])
        for name in reversed(SCRIPTS):
            self.manager.unload(name)

    @staticmethod
    def foreign() -> list[str]:
        """Registrations of the process other than the manager's own."""
        registered = graph.registrations("/manager").values()
        every = [name for kind in registered for name in kind]
        return [name for name in every if not name.startswith(("/manager/", "/rosout"))]

    def holdings(self) -> dict[str, float]:
        self.manager.load("dyknow/Script", "/census", {}, ["dyknow_test/census.py"])
        eventually(lambda: not self.manager.list(), 5.0, "the census has ended")
        with open(f"/proc/{self.manager.pid}/statm") as file:
            memory = int(file.read().split()[1]) * PAGE
        return {
            **rospy.get_param("/census"),
            "descriptors": self.manager.descriptors(),
            "threads": self.manager.threads(),
            "memory": memory,
        }


if __name__ == "__main__":
    rospy.init_node("script_leaks")
    rostest.rosrun("dyknow", "script_leaks", "__main__")
