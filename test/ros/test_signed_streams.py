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
from manager_suite import ManagerCase, eventually
from signed_suite import (
    HEADER,
    RandomLife,
    Reader,
    SignedLibrary,
    SignedPort,
    SignedTransformation,
    random_library,
)

from dyknow.model.streams import StreamRequest

RECTIFIER = SignedTransformation(
    "rectifier",
    (
        SignedPort("image", "in", ("Raw(?x)",)),
        SignedPort("info", "in", ("Info(?x)",)),
        SignedPort("out", "out", ("Rect(?x)",)),
    ),
)


def camera(name: str) -> SignedTransformation:
    """A camera that sends images, and information on them."""
    image, info = SignedPort("image", "out", (f"Raw({name})",)), f"Info({name})"
    ports = (image, SignedPort("info", "out", (info,)))
    return SignedTransformation(f"camera {name}", ports, rate=500)


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

    def test_one_camera_takes_the_place_of_another(self):
        """A subscriber of a claim's topic is reconfigured before it hears another camera."""
        manager = self.make(linger=1.0)
        manager.start()
        report = Path(manager.state) / "report.txt"
        cameras = {each: camera(each).xml({}, str(report)) for each in ("left", "right")}
        for text in (*cameras.values(), RECTIFIER.xml({}, str(report))):
            manager.client.add_transformation(text)
        manager.client.acquire_stream(StreamRequest("Raw(?x)", client_id="signed"))
        answer = manager.client.acquire_stream(StreamRequest("Rect(?x)", client_id="signed"))
        reader = Reader(answer.topic, HEADER, "Rect(?x)", {})
        self.addCleanup(reader.close)

        def is_seen(name: str) -> None:
            eventually(lambda: f"Rect({name})" in reader.last, 30.0, f"{name} is seen")

        for lost, other in (("left", "right"), ("right", "left"), ("left", "right")):
            is_seen(lost)
            manager.client.remove_transformation(f"camera {lost}")
            for each in manager.client.get_model().nodelets:
                if each.transformation == f"camera {lost}":
                    manager.client.destroy(each.name)
            is_seen(other)
            manager.client.add_transformation(cameras[lost])
        self.assertEqual(reader.wrong, [])
        mixed = Path(f"{report}.mixed")
        self.assertEqual(mixed.read_text() if mixed.exists() else "", "")

    def seeds(self) -> range:
        first = rospy.get_param("~first_seed", 1)
        return range(first, first + rospy.get_param("~seeds", 1))

    def test_random_libraries(self):
        for seed in self.seeds():
            with self.subTest(seed=seed):
                self.live(random_library(seed), seed)


if __name__ == "__main__":
    rospy.init_node("signed_streams_test")
    rostest.rosrun("dyknow", "signed_streams", "__main__")
