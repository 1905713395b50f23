#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sources sign their messages, and no receiver gets a message that does not meet its demand.

The parameters ~seeds and ~steps say how often and how long (long/signed_streams.test).
"""

from __future__ import annotations

from pathlib import Path

import rospy
import rostest
from manager_suite import ManagerCase
from roslib.packages import get_pkg_dir
from signed_suite import RandomLife, SignedLibrary, random_library, soccer_library


class SignedTest(ManagerCase):
    """A client reads signatures while random things happen."""

    def live(self, library: SignedLibrary, seed: int) -> None:
        try:
            self._live(library, seed)
        finally:
            self.doCleanups()

    def _live(self, library: SignedLibrary, seed: int) -> None:
        steps = rospy.get_param("~steps", 15)
        manager = self.make(linger=1.0, orphan_timeout=30.0)
        folder = Path(manager.state)
        ontology = folder / "ontology.ttl"
        ontology.write_text(library.ontology)
        manager.parameters["ontologies"] = str(ontology)
        manager.start()
        life = RandomLife(manager, library, folder / "report.txt", seed)
        self.addCleanup(life.close)
        life.add_all()
        for _ in range(3):
            life.step(life.acquire)
        for _ in range(steps):
            life.step()
        life.make_whole()
        read = sum(reader.count for reader in life.readers.values())
        print(f"seed {seed}: {steps} steps, {read} messages read, {life.checked} looks at waiting")
        self.assertTrue(read or not life.readers)

    def seeds(self) -> range:
        first = rospy.get_param("~first_seed", 1)
        return range(first, first + rospy.get_param("~seeds", 1))

    def test_the_soccer_library(self):
        examples = Path(get_pkg_dir("dyknow")) / "examples"
        for seed in self.seeds():
            with self.subTest(seed=seed):
                self.live(soccer_library(examples), seed)

    def test_random_libraries(self):
        for seed in self.seeds():
            with self.subTest(seed=seed):
                self.live(random_library(seed), seed)


if __name__ == "__main__":
    rospy.init_node("signed_streams_test")
    rostest.rosrun("dyknow", "signed_streams", "__main__")
