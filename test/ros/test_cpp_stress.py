#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Random moves, loads and unloads of C++ nodelets; in the long run also with sanitizers."""

from __future__ import annotations

import os
import random
import re
import threading
import time
import traceback
from pathlib import Path

import rospy
from cpp_suite import CppManager, start
from dyknow_msgs.srv import SetConfigResponse
from graph import nodes_on, set_config
from processes import BUSY, TellingCase, becomes, run

SECONDS = float(os.environ.get("DYKNOW_TEST_SECONDS", 2.5))
#: Workspaces in build/ whose nodelet managers are tried.
WORKSPACES = os.environ.get("DYKNOW_TEST_WORKSPACES", "ws").split()
ROOT = Path(__file__).resolve().parents[2]
SUPPRESSIONS = ROOT / "test" / "sanitizers"
TSAN = (
    f"suppressions={SUPPRESSIONS}/thread.txt",
    "exitcode=66",
    "history_size=7",
    "detect_deadlocks=0",  # roscpp takes its own locks in more than one order
    "report_thread_leaks=0",  # threads of ROS run until the end of the process
)
MANAGER = "/stressed"
TOPICS = ("", "/a", "/b", "/c", "~own", "not a topic")
#: Why a move may be refused.
REFUSALS = re.compile("not a topic|was unloaded during|is held up by another registration")
EITHER = (False, True)
#: Port and parameters of each nodelet type, with the values among which one is chosen.
TYPES = {
    "Source": (
        "out",
        {
            "count": [100000],
            "rate": [500.0],
            "latch": EITHER,
            "by_value": EITHER,
            "watched": EITHER,
        },
    ),
    "Sink": ("in", {"mt": EITHER, "second": EITHER, "delay": [0.001], "queue_size": [1, 5]}),
}


def command(workspace: str) -> tuple[str, ...]:
    """The nodelet manager of a workspace, with the exceptions of its sanitizer."""
    devel = ROOT / "build" / workspace / "devel"
    environment = {
        "CMAKE_PREFIX_PATH": f"{devel}:{os.environ['CMAKE_PREFIX_PATH']}",
        "LD_LIBRARY_PATH": f"{devel}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}",
        # Threads of ROS run until the end of the process, and our globals are leaked.
        "ASAN_OPTIONS": "detect_leaks=0:exitcode=66",
        "TSAN_OPTIONS": ":".join(TSAN),
    }
    words = [f"{key}={value}" for key, value in environment.items()]
    # Without a fixed layout of the memory the thread sanitizer may not find room for its own.
    return ("env", *words, "setarch", "-R", f"{devel}/lib/dyknow/cpp_nodelet_manager")


class Stress(threading.Thread):
    """Does random things with one nodelet until the time is over."""

    def __init__(self, manager: CppManager, name: str, seed: int, until: float) -> None:
        super().__init__()
        self._manager = manager
        self._name = name
        self._random = random.Random(seed)
        self._until = until
        self.moves = 0
        self.refused = 0
        self.trouble = ""

    def run(self) -> None:
        try:
            while not self._manager.has_ended:
                self._live()
                if time.monotonic() > self._until and self.moves > 2:
                    return
        except Exception:
            self.trouble = f"{self._name}: {traceback.format_exc()}"

    def _live(self) -> None:
        kind = self._random.choice(sorted(TYPES))
        port, parameters = TYPES[kind]
        chosen = {key: self._random.choice(values) for key, values in parameters.items()}
        self._manager.load(kind, self._name, {f"/{port}": "/a"}, **chosen)
        if kind == "Source":
            start(self._name)
        for _ in range(self._random.randrange(20)):
            answer = self._set({port: self._random.choice(TOPICS)})
            self.moves += answer.success
            self.refused += not answer.success
            time.sleep(self._random.choice((0.0, 0.0, 0.002, 0.05)))  # not a wait
        if self._random.random() < 0.5:
            mover = threading.Thread(target=self._move_on, args=(port,))
            mover.start()
            self._manager.unload(self._name)
            mover.join()
        else:
            self._manager.unload(self._name)

    def _set(self, config: dict[str, str]) -> SetConfigResponse:
        answer = set_config(self._name, **config)
        if not answer.success and not REFUSALS.search(answer.message):
            self.trouble = f"{self._name}: {answer.message}"
        return answer

    def _move_on(self, port: str) -> None:
        """Move a port of a nodelet that is being unloaded."""
        for topic in TOPICS:
            try:
                self._set({port: topic})
            except (rospy.ServiceException, rospy.ROSException):
                return  # it is gone


class StressTest(TellingCase):
    def test_random_moves_loads_and_unloads(self):
        for workspace in WORKSPACES:
            with self.subTest(workspace=workspace):
                self.stress(workspace)

    def stress(self, workspace: str) -> None:
        seed = random.randrange(10**6)
        print(f"{workspace}: seed {seed}")
        with CppManager(MANAGER, *command(workspace)) as manager:
            until = time.monotonic() + SECONDS
            threads = [Stress(manager, f"/n{i}", seed + i, until) for i in range(5)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(SECONDS + 20.0 * BUSY)
                self.assertFalse(thread.is_alive(), manager.output)
            moves = sum(thread.moves for thread in threads)
            print(f"{workspace}: {moves} moves, {sum(each.refused for each in threads)} refused")
            self.assertFalse(manager.has_ended, manager.output)
            self.assertEqual([each.trouble for each in threads if each.trouble], [])
            self.assertEqual(manager.list(), [])
            for topic in TOPICS[1:4]:
                becomes(lambda topic=topic: nodes_on(topic), (set(), set()))
            manager.stop()
            self.assertEqual(manager.exit_code(10.0), 0, manager.output)
            self.assertNotIn("Sanitizer", manager.output)


if __name__ == "__main__":
    run()
