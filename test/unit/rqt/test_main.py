# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window as a program."""

from __future__ import annotations

import os
import subprocess
import sys


def test_without_a_screen_it_says_so() -> None:
    hidden = ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")
    environment = {name: text for name, text in os.environ.items() if name not in hidden}
    start = "import sys; from dyknow_rqt.main import main; sys.exit(main(['dyknow_rqt']))"
    done = subprocess.run(
        [sys.executable, "-c", start], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("dyknow_rqt: there is no screen: set DISPLAY")
