# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Where real camera frames may lie."""

from __future__ import annotations

from pathlib import Path

#: Beside the checkout.
SHARED_FRAMES = Path(__file__).resolve().parents[2] / "shared" / "data" / "robocup_msl"
