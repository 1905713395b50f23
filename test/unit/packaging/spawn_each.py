# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Spawns every transformation of my_nodelets, shared and isolated: ``spawn_each.py HOME``.

Writes the outcome of each spawn into ``HOME/outcomes.json``. The DyKnow manager and the ROS master
are its own.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import rosmaster.master
from rospkg import RosPack

#: Seconds that a command, or the start of the manager, may take on a busy machine.
PATIENCE = 120
#: How a spawn ends whose process needs longer than the manager waits: on a busy machine.
LATE = "it does not come up\n"


def dyknow(*words: str) -> str:
    """Run a command of dyknow; returns "", or its output when it failed."""
    command = ("dyknow", *words, "--timeout", str(PATIENCE))
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stdout + done.stderr


def main(home: str) -> None:
    os.environ.update(ROS_HOSTNAME="localhost", ROS_HOME=home)
    master = rosmaster.master.Master(port=0)
    master.start()
    os.environ["ROS_MASTER_URI"] = master.uri
    Path(home).mkdir(exist_ok=True)
    files = sorted(Path(RosPack().get_path("my_nodelets"), "transformations").glob("*_*.xml"))
    with open(Path(home, "manager.txt"), "w") as log:
        manager = subprocess.Popen(["rosrun", "dyknow", "manager"], stdout=log, stderr=log)
    outcomes = {}
    try:
        end = time.monotonic() + 5 * PATIENCE
        while said := dyknow("import", *map(str, files)):
            assert time.monotonic() < end, said
        for label in (file.stem for file in files):
            for how in ([], ["isolated"]):
                name, flags = "_".join([label, *how]), [f"--{each}" for each in how]
                while (said := dyknow("spawn", label, name, *flags)).endswith(LATE):
                    assert time.monotonic() < end, said
                outcomes[" ".join([label, *how])] = said or "runs"
    finally:
        manager.send_signal(signal.SIGINT)
        manager.wait()
        master.stop()
    Path(home, "outcomes.json").write_text(json.dumps(outcomes))


if __name__ == "__main__":
    main(sys.argv[1])
