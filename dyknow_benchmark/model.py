# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark model``: spawn many nodelets, request the model, and check that it is quiet."""

from __future__ import annotations

import argparse
import time
from typing import List

import rospy
from dyknow_msgs.msg import Model

from dyknow_benchmark import machine, options, progress, system
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.targets import Verdict

HEADER = ("what", "count", "min_ms", "median_ms", "max_ms")
#: Seconds in which nothing changes and so nothing may be published.
_QUIET = 5.0
_QUESTIONS = 50


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--nodelets", type=options.positive, default=500)


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    spawns: List[float] = []
    answers: List[float] = []
    heard: List[int] = []
    with Session() as session:
        client = system.start(session)
        load = machine.Load()
        numbers = range(arguments.nodelets)
        for number in progress.steps(numbers, "spawning", arguments.nodelets, "nodelet"):
            begin = time.monotonic()
            client.spawn("relay", f"/n{number}", {"in": f"/t{number}", "out": f"/t{number + 1}"})
            spawns.append(1e3 * (time.monotonic() - begin))
        get_model = system.model_service()
        for _ in range(_QUESTIONS):
            begin = time.monotonic()
            nodelets = len(get_model().model.nodelets)
            answers.append(1e3 * (time.monotonic() - begin))
        subscriber = rospy.Subscriber(
            f"{system.MANAGER}/model", Model, lambda model: heard.append(model.revision)
        )
        while not heard:  # the latched one
            session.check()
            time.sleep(0.01)
        heard.clear()
        progress.say(f"listening for {_QUIET:g} s while nothing changes")
        time.sleep(_QUIET)
        subscriber.unregister()
    results = Results(
        load.rows(),
        [
            Verdict("spawn, median in ms", system.spread(spawns)[1], 30.0),
            Verdict("GetModel, median in ms", system.spread(answers)[1], 50.0),
            Verdict("~model published while nothing changed", float(len(heard)), 0.0),
            Verdict("nodelets in the model", float(nodelets), arguments.nodelets, at_least=True),
        ],
    )
    rows = [
        ("spawn", len(spawns), *system.spread(spawns)),
        ("GetModel", len(answers), *system.spread(answers)),
    ]
    results.table("model", f"{arguments.nodelets} nodelets in one nodelet manager", HEADER, rows)
    return results
