# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What threads have freed goes back to the system, in processes that are nodes of ours."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import threading
from dyknow.nodelet.memory import return_free_memory
from dyknow.ros.node_process import NodeProcess

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096

def work():
    for _ in range(3):
        block = b"x" * 20_000_000
        together.wait()

NodeProcess("test", ["test"], lambda: None)
before = resident()
together = threading.Barrier(4)
threads = [threading.Thread(target=work) for _ in range(4)]
for each in threads:
    each.start()
for each in threads:
    each.join()
return_free_memory()
print(resident() - before)
"""


def test_nothing_stays_with_the_process() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE], stdout=subprocess.PIPE, check=True, timeout=120
    )
    assert int(done.stdout) < 10_000_000
