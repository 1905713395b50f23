# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``python3 -m dyknow_benchmark``."""

import sys

import dyknow.interruptible  # noqa: F401
from dyknow_benchmark.main import main

sys.exit(main())
