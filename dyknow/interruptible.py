# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Imported first by each program: from then on SIGINT ends the process.

It does until the program's own way with signals takes over. Python would raise KeyboardInterrupt
instead, and modules are loaded with callbacks that print an exception and drop it: the process
would go on. A process that ignores SIGINT, as a shell starts those in the background, goes on
ignoring it.
"""

from __future__ import annotations

import signal

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
